# Sourced: leave_what_is_linked FILE ends the script if FILE exists and its folder is a link: the environment then
# belongs to another checkout on this machine, and what FILE says is valid here, too.
leave_what_is_linked() {
    if [ -L "$(dirname "$1")" ] && [ -s "$1" ]; then exit 0; fi
}

# Sourced: apt_install PACKAGE…, as root or with passwordless sudo; otherwise an error that says what to do.
apt_install() {
    local sudo=""
    if [ "$(id -u)" != 0 ]; then
        sudo="sudo -n"
        if ! command -v sudo >/dev/null || ! sudo -n true 2>/dev/null; then
            echo "error: system packages are missing, and only root or sudo without a password can install them; run: apt-get install $*" >&2
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
