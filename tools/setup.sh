#!/usr/bin/env bash
# `make setup`, from the source folder: setup.sh VENV PYTHON TORCH. System libraries, a virtual environment, and its
# packages: on the platform of requirements.lock exactly what stands there, or nothing; elsewhere the newest that
# pyproject.toml allows.
set -eu
venv=$1 python=$2 torch=$3

if [ -x "$venv/bin/python" ]; then python="$venv/bin/python"; fi
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])') || {
    echo "error: $python does not run. make needs Python 3.11: make PYTHON=/path/to/python3.11" >&2
    exit 1
}
if [ "$version" != 3.11 ]; then
    echo "error: $python is Python $version. make needs 3.11, which Blender 4.5 LTS as a module (bpy) is for:" >&2
    echo "       make PYTHON=python3.11, after removing $venv if it is there. docs/install.md has the ways without." >&2
    exit 1
fi
PYTHON="$python" bash tools/system_packages.sh
[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
pip=("$venv/bin/python" -m pip install)
here=$("$venv/bin/python" -c 'import platform, sys; print(sys.platform, platform.machine(), platform.libc_ver()[0])')

isolation=()
if [ "$here" = "linux x86_64 glibc" ]; then
    "${pip[@]}" --quiet --no-deps --require-hashes -r requirements.lock || {
        echo "error: requirements.lock cannot be installed as it stands; pip says why above. If hashes do not match," >&2
        echo "       a package is not the one that was tested: do not install it another way. Otherwise run make again." >&2
        exit 1
    }
    isolation=(--no-build-isolation) # it would fetch another setuptools, without a hash
else
    echo "requirements.lock is for Linux x86-64 with glibc, this is $here: taking the newest packages that are allowed"
    "${pip[@]}" --quiet --upgrade "pip>=24" "setuptools>=77"
fi
"$venv/bin/python" -c "import torch" 2>/dev/null || "${pip[@]}" "$torch"
"${pip[@]}" ${isolation[@]+"${isolation[@]}"} -e ".[blender,torch,dev,fast]"
rm -rf ./*.egg-info # older setuptools leave one here; it would hide what is installed
