"""One particle of a material, driven along a path of strains and stresses: no grid, no MPI, nothing compiled."""
