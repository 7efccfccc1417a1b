#!/usr/bin/env bash
# Strong scaling: one scene of one size on 1, 2, 4, ... ranks, one run after the other in one allocation; then a table.
#
#   sbatch --ntasks=64 --exclusive jobs/strong_scaling.sh SCENE DIR [more options of pmpm run]
#   RANKS="8 64" STEPS=2000 sbatch ...          other numbers of ranks, another number of steps (500)
#
# A run is DIR/<ranks>, the table DIR/table.md. Start it in the root of the repository, or say where the table is made: TABLE.
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
launch=${LAUNCH:-mpirun}   # or: srun --mpi=pmi2 --exact; it is given -n RANKS

most=${SLURM_NTASKS:?to be started with sbatch}
ranks=${RANKS:-$(for ((n = 1; n < most; n *= 2)); do echo "$n"; done; echo "$most")}

for n in $ranks; do
    status=0
    $launch -n "$n" pmpm run "$scene" --out "$out/$n" --overwrite --quiet --walltime none --steps "${STEPS:-500}" "$@" || status=$?
    [ "$status" = 0 ] || { echo "$n ranks ended with status $status" >&2; exit "$status"; }
done

python "${TABLE:-jobs/scaling_table.py}" $(for n in $ranks; do echo "$out/$n"; done) | tee "$out/table.md"
