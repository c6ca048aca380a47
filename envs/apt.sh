# Sourced: leave_what_is_linked FILE ends the script where FILE is there and its folder is a link: such an environment
# belongs to another checkout, and what it says holds for this machine here, too.
leave_what_is_linked() {
    if [ -L "$(dirname "$1")" ] && [ -s "$1" ]; then exit 0; fi
}

# Sourced: apt_install PACKAGE…, as root or with passwordless sudo, else an error that says what to do.
apt_install() {
    local sudo=""
    if [ "$(id -u)" != 0 ]; then
        sudo="sudo -n"
        if ! command -v sudo >/dev/null || ! sudo -n true 2>/dev/null; then
            echo "error: system packages needed, and no right to install them: apt-get install $*" >&2
            return 2
        fi
    fi
    command -v apt-get >/dev/null || { echo "error: no apt-get here; install by hand: $*" >&2; return 2; }
    echo "installing system packages: $*"
    # Another program may hold apt's lock for a while.
    local apt="$sudo env DEBIAN_FRONTEND=noninteractive apt-get -y -qq -o DPkg::Lock::Timeout=600"
    $apt install --no-install-recommends "$@" >/dev/null 2>&1 && return
    $apt update >/dev/null
    $apt install --no-install-recommends "$@" >/dev/null
}
