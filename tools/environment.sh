#!/bin/sh
# Checks what this machine must have, and makes a virtual environment with the third-party packages.
#
#   tools/environment.sh FOLDER                      pins of constraints.txt
#   tools/environment.sh FOLDER constraints-X.txt    the same, except for what the second file pins
#   MORE=yes tools/environment.sh FOLDER             what tests and studies need besides
#   CORE=yes tools/environment.sh FOLDER ...         the core and its tests, without ROS; the core
#                                                    runs wherever its packages do
#
# PYTHON names the interpreter; without it the first suitable one on the PATH is taken, else one that
# pyenv has (its command on the PATH does not run where that version is not selected).
# VERSIONS are the Python versions that will do.
set -eu
folder=$1
other_pins=${2-}
versions=${VERSIONS:-3.10 3.11 3.12 3.13}

stop() {
    echo "$*" >&2
    exit 1
}

# Source distributions are built with the pinned setuptools, so that nothing unpinned is fetched.
pip="$folder/bin/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --constraint $folder/constraints.txt"
why="The packages could not be installed: pip says why above (the first set-up needs the network)."
if [ -n "${MORE-}" ]; then
    echo "Set-up: the packages of tests and studies go into $folder (once; about 250 MB)."
    $pip --requirement requirements-test.txt || stop "$why"
    exit
fi

check_platform() {
    [ "$(uname -s) $(uname -m)" = "Linux x86_64" ] ||
        stop "This needs Linux on x86-64, and this is $(uname -s) on $(uname -m): the ROS 2 wheels exist for nothing else. The core alone: make test-core."
    glibc=$(getconf GNU_LIBC_VERSION 2>/dev/null) ||
        stop "This needs glibc 2.28 or newer, and this system has another C library: the ROS 2 wheels do not run on it."
    [ "$(printf '2.28\n%s\n' "${glibc#glibc }" | sort -V | head -n 1)" = 2.28 ] ||
        stop "This needs glibc 2.28 or newer, and this system has $glibc."
}
[ -n "${CORE-}" ] || check_platform

# One line about an interpreter: "ok", or what is wrong with it.
judge() {
    VERSIONS=$versions "$1" -S - 2>/dev/null <<'PYTHON' || echo "does not run"
import importlib.util
import os
import struct
import sys
import sysconfig

version = "%d.%d" % sys.version_info[:2]
if version not in os.environ["VERSIONS"].split():
    print("is Python " + version)
elif sys.implementation.name != "cpython" or struct.calcsize("P") != 8:
    print("is not a 64-bit CPython")
elif sysconfig.get_config_var("Py_GIL_DISABLED"):
    print("is a free-threaded build")
elif not all(importlib.util.find_spec(name) for name in ("venv", "ensurepip")):
    print("has no venv (on Debian and Ubuntu: apt install python%s-venv)" % version)
else:
    print("ok")
PYTHON
}

pyenv=
for version in $versions; do
    for candidate in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$version".*/bin/python3; do
        [ -x "$candidate" ] && pyenv="$pyenv $candidate"
    done
done

python=
seen=
for candidate in ${PYTHON:-python3 python3.12 python3.11 python3.13 python3.10 $pyenv}; do
    command -v "$candidate" >/dev/null || continue
    verdict=$(judge "$candidate")
    if [ "$verdict" = ok ]; then
        python=$candidate
        break
    fi
    seen="${seen:+$seen, }$candidate ${verdict:-is not a Python}"
done
[ -n "$python" ] ||
    stop "This needs Python with venv, of version $versions, on the PATH or named by PYTHON=...; found: ${seen:-no Python}."

pins=$folder/constraints.txt
if [ -n "${CORE-}" ]; then
    # By its own setup.py: what it declares is what it needs.
    what="./src[bags,dask,jobs,onnx,plot,report,test,train] pytest-xdist"
    size="the core with its packages go into $folder (once; about 700 MB"
else
    what="--requirement requirements.txt"
    size="the ROS 2 wheels go into $folder (once; about 850 MB"
fi
echo "Set-up: $("$python" --version) ($python) and $size, a few minutes)."
rm -rf "$folder"
"$python" -m venv "$folder"
if [ -n "$other_pins" ]; then
    awk -F '[=;]' 'FNR == NR { other[$1] = 1; next } !($1 in other)' "$other_pins" constraints.txt >"$pins"
    cat "$other_pins" >>"$pins"
else
    cp constraints.txt "$pins"
fi
# shellcheck disable=SC2086
{ $pip setuptools wheel && $pip $what; } || stop "$why"
