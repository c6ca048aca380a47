#!/usr/bin/env bash
# Install what the one-machine Slurm cluster of the tests needs. Usage: envs/slurm-packages.sh
set -euo pipefail
cd "$(dirname "$0")/.."
. envs/apt.sh
PATH=$PATH:/usr/sbin:/sbin
for program in munged slurmctld slurmd sbatch squeue scontrol scancel; do
    command -v "$program" >/dev/null || { apt_install slurm-wlm munge; break; }
done
