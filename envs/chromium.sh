#!/usr/bin/env bash
# Find or install Chromium and its driver, for the tests of pages; write `found` or `none` to the file given.
# Usage: envs/chromium.sh FILE
set -euo pipefail
file=$1
cd "$(dirname "$0")/.."
. envs/apt.sh
leave_what_is_linked "$file"

chromium_is_here() { command -v chromium && command -v chromedriver; }

chromium_is_here >/dev/null || apt_install chromium chromium-driver || true
if chromium_is_here >/dev/null; then
    echo found >"$file"
else
    echo "Chromium is not here and could not be installed; tests of pages in a browser are skipped."
    echo none >"$file"
fi
