#!/usr/bin/env bash
# A parameter study: one scene with other values, a job of an array for each line of a list.
#
#   sbatch --array=1-12 --ntasks=4 jobs/parameter_study.sh SCENE DIR LIST [more options of pmpm run]
#   sbatch --array=1-12%3 ...                              at most three at once
#
# A line of LIST holds settings as --set takes them, with blanks between them and none within them:
#   materials.sand.friction_angle=25 domain.gravity=[0.5,-9.8]
# Task n runs line n into DIR/n, as a long run does: it may be stopped, and goes on. Lines that are empty or begin with # do
# not count. Start it in the root of the repository, or say where the long run is: LONG_RUN.
#SBATCH --job-name=pmpm-study
#SBATCH --ntasks=2
#SBATCH --time=01:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%A_%a.log
#SBATCH --signal=B:USR1@180

set -euo pipefail
scene=${1:?SCENE}
out=${2:?DIR}
list=${3:?LIST}
shift 3
task=${SLURM_ARRAY_TASK_ID:?to be started with sbatch --array=1-N}

# Adapt to the machine:
# module load ...
# source .venv/bin/activate

line=$(grep -Ev '^[[:space:]]*(#|$)' "$list" | sed -n "${task}p")
if [ -z "$line" ]; then
    echo "$list has no line $task: --array=1-$(grep -Evc '^[[:space:]]*(#|$)' "$list")" >&2
    exit 2
fi
read -ra settings <<<"$line"
options=()
for setting in "${settings[@]}"; do options+=(--set "$setting"); done

mkdir -p "$out"
echo "task $task: $line"
exec bash "${LONG_RUN:-jobs/long_run.sh}" "$scene" "$out/$task" "${options[@]}" "$@"
