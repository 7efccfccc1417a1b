#!/usr/bin/env bash
# Install Slurm and munge where apt-get can, so that tests/slurm runs the job scripts for real. Those tests start the daemons
# themselves, on the loopback and in their own folders, and are skipped where this has not worked: it never fails.
set -uo pipefail
began=$SECONDS

have_slurm() {
    local name
    for name in slurmctld slurmd munged srun; do
        PATH=$PATH:/usr/sbin:/sbin command -v "$name" >/dev/null || return 1
    done
}

if ! have_slurm; then
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq && apt-get install -y -qq --no-install-recommends slurm-wlm munge >/dev/null
fi
if have_slurm; then
    echo "Slurm: ready after $((SECONDS - began)) s"
else
    echo "Slurm: cannot be installed here; the tests that need it are skipped"
fi
exit 0
