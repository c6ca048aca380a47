#!/usr/bin/env bash
# Find or install Slurm and munge, for the one-machine cluster of the tests; write `found` or `none` to the file given.
# Usage: envs/slurm.sh FILE
set -euo pipefail
file=$1
cd "$(dirname "$0")/.."
. envs/apt.sh
leave_what_is_linked "$file"
PATH=$PATH:/usr/sbin:/sbin

slurm_is_here() { for program in munged slurmctld slurmd sbatch squeue scontrol scancel; do command -v "$program" || return; done; }

slurm_is_here >/dev/null || apt_install slurm-wlm munge || true
if slurm_is_here >/dev/null; then
    echo found >"$file"
else
    echo "Slurm and munge are not here and could not be installed; tests of EXECUTOR=slurm are skipped."
    echo none >"$file"
fi
