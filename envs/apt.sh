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
    DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends "$@" >/dev/null 2>&1 && return
    $sudo apt-get update -qq >/dev/null
    DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}
