#!/usr/bin/env bash
# Make the project's virtual environment from exact versions. Usage: envs/venv.sh STAMP
set -euo pipefail
stamp=$1
venv=$(dirname "$stamp")
# A linked environment belongs to another checkout, which its editable install must go on pointing at.
[ ! -L "$venv" ] || exit 0
cd "$(dirname "$0")/.."
. envs/apt.sh

python=""
for name in python3 python3.11 python3.12 python3.13; do
    if command -v "$name" >/dev/null && "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
        python=$name
        break
    fi
done
[ -n "$python" ] || { echo "error: no Python 3.11 or newer on PATH; install one and run make again" >&2; exit 2; }

echo "setting up $venv: downloads $(grep -c '==' envs/requirements.lock) Python packages of the versions in" \
    "envs/requirements.lock, 4.5 GB on disk; some minutes the first time"
# What pip would warn of, the user it runs as and programs beside PATH, is meant so here.
export PIP_ROOT_USER_ACTION=ignore PIP_NO_WARN_SCRIPT_LOCATION=1 PIP_DISABLE_PIP_VERSION_CHECK=1
# Debian keeps ensurepip in a package of its own.
"$python" -c 'import ensurepip' 2>/dev/null || apt_install python3-venv
# One that was interrupted while it was made has a Python and no pip.
"$venv/bin/python" -m pip --version >/dev/null 2>&1 || "$python" -m venv --clear "$venv"
"$venv/bin/python" -m pip install --quiet --quiet -r envs/requirements.lock
"$venv/bin/python" -m pip install --quiet --quiet --no-deps -e .
# Mesh and picture libraries load these at import; a minimal system lacks them.
if ! "$venv/bin/python" -c 'import pymeshlab, vtkmodules.vtkRenderingOpenGL2' 2>/dev/null; then
    apt_install libgl1 libopengl0 libegl1 libglu1-mesa libxrender1 libgomp1
    "$venv/bin/python" -c 'import pymeshlab, vtkmodules.vtkRenderingOpenGL2'
fi
touch "$stamp"
