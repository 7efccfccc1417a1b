#!/usr/bin/env bash
# Weak scaling: the same piece of a scene for every rank, on 1, 2, 4, ... ranks in one allocation; then a table.
#
#   sbatch --ntasks=64 --exclusive jobs/weak_scaling.sh DIR [more options of pmpm run]
#   RANKS="8 64" STEPS=2000 LENGTH=1.28 sbatch ...     other numbers of ranks and steps (200), another length per rank (0.64 m)
#
# The scene is a layer of water that glides (SCENE, jobs/weak_scaling.toml); its length along x grows with the ranks.
# A run is DIR/<ranks>, the table DIR/table.md. Start it in the root of the repository, or say where things are: SCENE, TABLE.
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
launch=${LAUNCH:-mpirun}   # or: srun --mpi=pmi2 --exact; it is given -n RANKS

most=${SLURM_NTASKS:?to be started with sbatch}
ranks=${RANKS:-$(for ((n = 1; n < most; n *= 2)); do echo "$n"; done; echo "$most")}

for n in $ranks; do
    length=$(awk "BEGIN {printf \"%.9g\", ${LENGTH:-0.64} * $n}")
    status=0
    $launch -n "$n" pmpm run "${SCENE:-jobs/weak_scaling.toml}" --out "$out/$n" --overwrite --quiet --walltime none \
        --steps "${STEPS:-200}" --set "domain.size=[$length, 0.48, 0.48]" \
        --set "bodies.0.shape.max=[$length, 0.32, 0.48]" "$@" || status=$?
    [ "$status" = 0 ] || { echo "$n ranks ended with status $status" >&2; exit "$status"; }
done

python "${TABLE:-jobs/scaling_table.py}" $(for n in $ranks; do echo "$out/$n"; done) | tee "$out/table.md"
