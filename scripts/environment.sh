#!/bin/sh
# Finds a Python that Blender has a wheel for, and runs environment.py, which makes the virtual environment.
# Usage: scripts/environment.sh VENV GROUP… [--bpy REQUIREMENT]
# PYTHON=… uses that interpreter; WANTED="3.13" requires a version; on Debian and Ubuntu missing packages are installed
# if that needs no password.
set -eu
here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
wanted=${WANTED:-3.11 3.13}

fits() {
    "$1" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] not in '$wanted'.split())" >/dev/null 2>&1
}

find_python() {
    if [ -n "${PYTHON:-}" ]; then
        if fits "$PYTHON"; then echo "$PYTHON"; fi
        return
    fi
    for candidate in python3.11 python3.13 python3 \
        "${HOME:-}"/.pyenv/versions/3.11.*/bin/python3 "${HOME:-}"/.pyenv/versions/3.13.*/bin/python3; do
        if fits "$candidate"; then
            echo "$candidate"
            return
        fi
    done
}

apt_install() {
    command="apt-get update && apt-get install -y --no-install-recommends $*"
    if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
        root=""
    elif command -v apt-get >/dev/null && command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        root="sudo -n"
    else
        echo "Missing: $*. Install it; on Debian or Ubuntu, as root:" >&2
        echo "    $command" >&2
        exit 2
    fi
    echo "installing $*" >&2
    # One failed source must not block the others; apt-get install then reports what it could not find.
    $root apt-get -qq update >/dev/null || echo "apt-get update had errors; going on" >&2
    $root env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "$@" >/dev/null
}

python=$(find_python)
if [ -z "$python" ] && [ -z "${PYTHON:-}" ] && ! command -v python3 >/dev/null; then
    apt_install python3 python3-venv
    python=$(find_python)
fi
if [ -z "$python" ]; then
    if [ -n "${PYTHON:-}" ]; then echo "PYTHON=$PYTHON does not serve." >&2; fi
    echo "No Python $(echo "$wanted" | sed 's/ / or /') was found, and Blender has no wheel for another." >&2
    echo "Install one and name it: make … PYTHON=/path/to/python3.11" >&2
    exit 2
fi

if ! "$python" -c "import ensurepip, venv" 2>/dev/null; then
    apt_install "python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
fi

missing=$("$python" "$here/libraries.py")
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086 # a list of package names
    apt_install $missing
fi

exec "$python" "$here/environment.py" "$@"
