#!/usr/bin/env bash
# Find or install CalculiX and write the path of `ccx` (or `none`) to the file given. Usage: envs/ccx.sh FILE
set -euo pipefail
file=$1
cd "$(dirname "$0")/.."
. envs/apt.sh
leave_what_is_linked "$file"
mkdir -p "$(dirname "$file")"
here=$PWD/$(dirname "$file")/conda

find_ccx() {
    command -v ccx || { [ -x "$here/bin/ccx" ] && echo "$here/bin/ccx"; }
}

if ! find_ccx >/dev/null; then
    apt_install calculix-ccx || true
fi
if ! find_ccx >/dev/null; then
    for conda in mamba conda micromamba; do
        if command -v "$conda" >/dev/null; then
            echo "installing CalculiX with $conda into $here"
            "$conda" create --yes --quiet --prefix "$here" --channel conda-forge calculix >/dev/null && break
        fi
    done || true
fi
found=$(find_ccx || echo none)
[ "$found" != none ] || echo "CalculiX (ccx) is not here and could not be installed; solves will use method label."
echo "$found" >"$file"
