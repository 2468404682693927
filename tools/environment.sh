# Sourced by ./demo and ./check: find_python VERSION..., and the arguments that both take. POSIX sh.

SUPPORTED_PYTHONS="3.13 3.11"

say() { printf '%s\n' "$*" >&2; }

# Does the command $1 run, and is it Python $2? A pyenv shim exists for versions that are not selected, so it must be run.
is_python() {
    "$1" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$2')" >/dev/null 2>&1
}

# Prints the first interpreter of version $1: $PYTHON, the PATH's, an installed one of pyenv (whose folder a shim tells).
find_python() {
    shim=$(command -v "python$1" 2>/dev/null || true)
    case "$shim" in
    */shims/*) pyenv=${shim%/shims/*} ;;
    *) pyenv=${PYENV_ROOT:-${HOME:-}/.pyenv} ;;
    esac
    for candidate in "${PYTHON:-}" "python$1" python3 "$pyenv/versions/$1".*/bin/python; do
        if [ -n "$candidate" ] && is_python "$candidate" "$1"; then
            command -v "$candidate"
            return 0
        fi
    done
    return 1
}

refuse_python() {
    found=$(python3 --version 2>/dev/null || echo "no Python 3")
    say "RTGI needs Python 3.13 (for Blender 5.2) or 3.11 (for Blender 4.5), and this machine has ${found}: install one of" \
        "them (Debian 12: apt-get install python3.11 python3.11-venv; Debian 13: python3.13 python3.13-venv), or name it" \
        "in PYTHON=/path/to/python"
}

# Prints the first supported version that is installed, or refuses. $PYTHON, where set, decides alone.
choose_version() {
    for version in $SUPPORTED_PYTHONS; do
        if [ -n "${PYTHON:-}" ]; then
            is_python "$PYTHON" "$version" && { echo "$version"; return 0; }
        elif find_python "$version" >/dev/null; then
            echo "$version"
            return 0
        fi
    done
    if [ -n "${PYTHON:-}" ]; then
        say "PYTHON=$PYTHON is not Python 3.13 or 3.11; RTGI needs one of them, because the bpy module exists for no other"
    else
        refuse_python
    fi
    return 1
}

# set_up VERSION run|test [--install-system-packages]: prints the path of the environment's Python.
set_up() {
    if ! interpreter=$(find_python "$1"); then
        say "Python $1 is not installed, or not on the PATH; name it in PYTHON=/path/to/python$1"
        return 1
    fi
    shift
    "$interpreter" tools/set_up.py "$@"
}
