"""The cases of benchmarks/stability.py: one file for each family, and how they are run and judged."""
