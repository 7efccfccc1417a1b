#!/usr/bin/env bash
# One long run in as many stretches of wall time as it takes; the job puts itself back into the queue until the run is done.
#
#   sbatch --ntasks=64 --time=24:00:00 jobs/long_run.sh SCENE DIR [more options of pmpm run]
#
# The command is the same at every start: it begins the run, or goes on from its newest good checkpoint, or finds it finished.
# `scancel JOB` ends it for good, with a checkpoint; submitting the same line again goes on from there.
#SBATCH --job-name=pmpm
#SBATCH --ntasks=2
#SBATCH --time=01:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%j.log
# pmpm knows when the job ends and stops by itself in time; this is for where Slurm cannot be asked from a compute node.
# B: the signal comes to this script, see below. Give it the time of two checkpoints and a minute.
#SBATCH --signal=B:USR1@180

set -uo pipefail
scene=${1:?SCENE}
out=${2:?DIR}
shift 2

# Adapt to the machine:
# module load ...
# source .venv/bin/activate
launch=${LAUNCH:-mpirun -n ${SLURM_NTASKS:?to be started with sbatch}}

newest_step() {  # at which the newest checkpoint was written
    local manifests=("$out"/checkpoints/[0-9]*.json)
    sed -n 's/^ *"step": \([0-9]*\),.*/\1/p' "${manifests[-1]}" 2>/dev/null | head -n 1
}

# Signals for the job reach this script, but srun kills its ranks at a SIGTERM, and a script that dies of one takes mpirun
# with it. SIGUSR1 is handed on to the ranks by srun and by the mpirun of MPICH alike, and pmpm answers it as it does SIGTERM.
heard=0 warned=0 run=
hand_on() {
    heard=1 warned=1
    kill -USR1 "$run" 2>/dev/null
}
trap hand_on USR1 TERM

# Of a task of an array: SLURM_JOB_ID of one of them is the number of the whole array.
job=$SLURM_JOB_ID
[ -z "${SLURM_ARRAY_TASK_ID:-}" ] || job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID

before=$(newest_step)
$launch pmpm run "$scene" --out "$out" --restart "$out" "$@" &
run=$!
[ "$heard" = 0 ] || hand_on  # one that came before there was anybody to hand it to
while heard=0; wait "$run"; status=$?; [ "$heard" = 1 ]; do :; done  # a signal ends `wait`, not the run

# 3: stopped with a checkpoint; more than 3: the signal came when the run did not listen yet, or no longer. If Slurm has
# stopped the job (scancel, preemption, requeue) it knows what comes next, and the job no longer counts as running. A run
# that has got no further would do so for ever.
if { [ "$status" = 3 ] || [ "$status" -gt 3 -a "$warned" = 1 ]; } && [ "$(squeue --noheader --jobs="$job" --format=%T)" = RUNNING ]; then
    if [ "$(newest_step)" = "$before" ]; then
        echo "$out: no step beyond ${before:-0} in this stretch: more time (--time) is needed; not queued again" >&2
    else
        echo "$out: stands at step $(newest_step), queued again"
        scontrol requeue "$job"
    fi
fi
exit "$status"
