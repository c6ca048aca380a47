#!/usr/bin/env bash
# Install exact versions of Python packages into the project's virtual environment, which is made first if there is none.
# Usage: envs/venv.sh STAMP LOCK
set -euo pipefail
stamp=$1 lock=$2
venv=$(dirname "$stamp")
# A linked environment belongs to another checkout, and its editable install must keep pointing there.
[ ! -L "$venv" ] || exit 0
cd "$(dirname "$0")/.."
. envs/apt.sh

# Settings of the user for pip, in the environment or in pip.conf, such as `user`, do not belong into a virtual environment;
# and running pip as root and programs outside of PATH are intended here: no warnings.
unset PIP_TARGET PIP_PREFIX PYTHONHOME
export PIP_USER=0 PIP_ROOT_USER_ACTION=ignore PIP_NO_WARN_SCRIPT_LOCATION=1 PIP_DISABLE_PIP_VERSION_CHECK=1

# An environment whose creation was interrupted has a Python but no pip.
if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    python=""
    for name in python3 python3.11 python3.12 python3.13; do
        if command -v "$name" >/dev/null && "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
            python=$name
            break
        fi
    done
    [ -n "$python" ] || { echo "error: no Python 3.11 or newer on PATH; install one and run make again" >&2; exit 2; }
    # Debian has ensurepip in a separate package.
    "$python" -c 'import ensurepip' 2>/dev/null || apt_install python3-venv
    rm -rf "$venv"/{bin,lib,lib64,include,pyvenv.cfg}
    "$python" -m venv "$venv"
fi

# What an interrupted pip left half installed has no RECORD, and pip would take it for installed.
find "$venv"/lib/python3*/site-packages -maxdepth 1 -name '*.dist-info' -exec test ! -e '{}/RECORD' \; -exec rm -rf '{}' +
here() { find "$venv"/lib/python3*/site-packages -maxdepth 1 -name '*.dist-info' | wc -l; }

# Three pips at a time: each second package of the lock, and this project. Nothing is compiled to byte code here: Python
# does it for the modules that are imported. The lock holds all dependencies.
all=$(grep -c '==' "$lock") before=$(here)
echo "installing $all Python packages of $lock into $venv"
install() {
    local log="$venv/pip-$1.log"
    shift
    "$venv/bin/python" -m pip install --no-compile --no-deps --progress-bar off "$@" >"$log" 2>&1 && rm "$log"
}
trap 'kill $(jobs -p) 2>/dev/null; exit 130' INT TERM
for half in 0 1; do
    awk -v half=$half 'NR % 2 == half' "$lock" >"$venv/half-$half.lock"
    install half-$half -r "$venv/half-$half.lock" &
done
[ "$lock" != envs/requirements.lock ] || { all=$((all + 1)); install gelforge -e . & }
for ((second = 1; ; second++)); do
    [ -n "$(jobs -rp)" ] || break
    sleep 1
    ((second % 10)) || echo "  $(here) of $((all + before)) packages installed after $second s"
done
if ls "$venv"/pip-*.log >/dev/null 2>&1; then
    echo "error: pip failed: $(grep -hm1 '^ERROR' "$venv"/pip-*.log || tail -qn1 "$venv"/pip-*.log)" >&2
    echo "see $(ls "$venv"/pip-*.log | tr '\n' ' '); run make again to go on" >&2
    exit 2
fi
# Mesh and image libraries load these at import; a minimal system lacks them.
if ! "$venv/bin/python" -c 'import pymeshlab, vtkmodules.vtkRenderingOpenGL2' 2>/dev/null; then
    apt_install libgl1 libopengl0 libegl1 libglu1-mesa libxrender1 libgomp1
    "$venv/bin/python" -c 'import pymeshlab, vtkmodules.vtkRenderingOpenGL2'
fi
touch "$stamp"
