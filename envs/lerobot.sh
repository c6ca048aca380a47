#!/usr/bin/env bash
# Make the environment in which a test opens an export with LeRobot, whose package needs other versions than the
# project. Usage: envs/lerobot.sh STAMP
set -euo pipefail
stamp=$1
venv=$(dirname "$stamp")
cd "$(dirname "$0")/.."
echo "setting up $venv: downloads $(grep -c '==' envs/lerobot.lock) Python packages of the versions in envs/lerobot.lock," \
    "400 MB on disk; torch and numpy are those of .venv"
.venv/bin/python -m venv --clear "$venv"
# without their dependencies, so that no torch for graphics cards is installed
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps -r envs/lerobot.lock
# the packages of .venv come second on the path, after this environment's own
.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' >"$(echo "$venv"/lib/python*/site-packages)/zz-beside.pth"
touch "$stamp"
