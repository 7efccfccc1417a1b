#!/usr/bin/env bash
# Weak scaling: the same piece of a scene for every rank, on 1, 2, 4, ... ranks in one allocation; then a table.
#
#   sbatch --ntasks=64 --exclusive jobs/weak_scaling.sh DIR [more options of benchmarks/scaling.py weak]
#   RANKS=8,64 STEPS=2000 ROUNDS=5 sbatch ...     other numbers of ranks, steps (200) and rounds (3)
#   sbatch ... jobs/weak_scaling.sh DIR --length 2    a piece of twice the length per rank
#
# The scene is a layer of water that glides (SCENE, jobs/weak_scaling.toml); its length along x grows with the ranks.
# A run is DIR/<ranks>, the table DIR/table.md. Start it in the root of the repository, or say where things are: SCENE, SCALING.
#SBATCH --job-name=pmpm-weak
#SBATCH --ntasks=2
#SBATCH --time=01:00:00
#SBATCH --output=%x-%j.log

set -euo pipefail
out=${1:?DIR}
shift

# Adapt to the machine:
# module load ...
# source .venv/bin/activate
# export LAUNCH="srun --mpi=pmi2 --exact"   # if not mpirun; it is given -n RANKS

: "${SLURM_NTASKS:?to be started with sbatch}"
exec python "${SCALING:-benchmarks/scaling.py}" weak "${SCENE:-jobs/weak_scaling.toml}" --out "$out" ${RANKS:+--ranks "$RANKS"} \
    --steps "${STEPS:-200}" --rounds "${ROUNDS:-3}" "$@"
