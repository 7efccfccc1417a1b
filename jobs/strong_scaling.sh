#!/usr/bin/env bash
# Strong scaling: one scene of one size on 1, 2, 4, ... ranks, one run after the other in one allocation; then a table.
#
#   sbatch --ntasks=64 --exclusive jobs/strong_scaling.sh SCENE DIR [more options of benchmarks/scaling.py strong]
#   RANKS=8,64 STEPS=2000 ROUNDS=5 sbatch ...     other numbers of ranks, steps (500) and rounds (3)
#
# A run is DIR/<ranks>, the table DIR/table.md. Start it in the root of the repository, or say where the benchmark is: SCALING.
#SBATCH --job-name=pmpm-strong
#SBATCH --ntasks=2
#SBATCH --time=01:00:00
#SBATCH --output=%x-%j.log

set -euo pipefail
scene=${1:?SCENE}
out=${2:?DIR}
shift 2

# Adapt to the machine:
# module load ...
# source .venv/bin/activate
# export LAUNCH="srun --mpi=pmi2 --exact"   # if not mpirun; it is given -n RANKS

: "${SLURM_NTASKS:?to be started with sbatch}"
exec python "${SCALING:-benchmarks/scaling.py}" strong "$scene" --out "$out" ${RANKS:+--ranks "$RANKS"} \
    --steps "${STEPS:-500}" --rounds "${ROUNDS:-3}" "$@"
