#!/usr/bin/env bash
# Make the project's virtual environment from exact versions. Usage: envs/venv.sh STAMP
set -euo pipefail
stamp=$1
venv=$(dirname "$stamp")
# A linked environment belongs to another checkout, and its editable install must keep pointing there.
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
# Running pip as root and programs outside of PATH are intended here: no warnings.
export PIP_ROOT_USER_ACTION=ignore PIP_NO_WARN_SCRIPT_LOCATION=1 PIP_DISABLE_PIP_VERSION_CHECK=1
# Settings of the user for pip, in the environment or in pip.conf, such as `user`, do not belong into a virtual environment.
unset PIP_USER PIP_TARGET PIP_PREFIX PYTHONHOME
export PIP_USER=0
# Debian has ensurepip in a separate package.
"$python" -c 'import ensurepip' 2>/dev/null || apt_install python3-venv
# An environment whose creation was interrupted has a Python but no pip.
"$venv/bin/python" -m pip --version >/dev/null 2>&1 || "$python" -m venv --clear "$venv"
"$venv/bin/python" -m pip install --quiet --quiet -r envs/requirements.lock
"$venv/bin/python" -m pip install --quiet --quiet --no-deps -e .
# Mesh and image libraries load these at import; a minimal system lacks them.
if ! "$venv/bin/python" -c 'import pymeshlab, vtkmodules.vtkRenderingOpenGL2' 2>/dev/null; then
    apt_install libgl1 libopengl0 libegl1 libglu1-mesa libxrender1 libgomp1
    "$venv/bin/python" -c 'import pymeshlab, vtkmodules.vtkRenderingOpenGL2'
fi
touch "$stamp"
