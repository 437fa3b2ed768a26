#!/usr/bin/env bash
# System libraries that the bpy, Mitsuba and Dr.Jit wheels link, and the venv module. Installs what is missing when it
# may (root, or sudo without a password); otherwise says exactly what to install.
set -eu

have_library() { ldconfig -p 2>/dev/null | grep -q "$1"; }

missing=()
need() { have_library "$1" || missing+=("$2"); }
need libGL.so.1 libgl1
need libSM.so.6 libsm6
need libICE.so.6 libice6
need libX11.so.6 libx11-6
need libXext.so.6 libxext6
need libXi.so.6 libxi6
need libXrender.so.1 libxrender1
need libXfixes.so.3 libxfixes3
need libxkbcommon.so.0 libxkbcommon0
need libatomic.so.1 libatomic1
"${PYTHON:-python3.11}" -c "import ensurepip, venv" 2>/dev/null || missing+=(python3.11-venv)

# Dr.Jit compiles its CPU kernels with libLLVM. Versions up to 15 abort on CPUs with AVX-512.
if ! ldconfig -p | grep -oE 'libLLVM[.-](so\.)?[0-9]+' | grep -oE '[0-9]+$' | awk '$1 >= 16 {ok = 1} END {exit !ok}'; then
    missing+=(libllvm19)
fi

[ ${#missing[@]} -eq 0 ] && exit 0

if ! command -v apt-get >/dev/null; then
    echo "error: these libraries are missing (Debian's names): ${missing[*]}. Install them with your system's package manager, then run make again." >&2
    exit 1
fi
run=()
if [ "$(id -u)" -ne 0 ]; then
    if sudo -n true 2>/dev/null; then run=(sudo -n); else
        echo "error: missing system packages. Run once as root:  apt-get install ${missing[*]}" >&2
        exit 1
    fi
fi
echo "installing system packages: ${missing[*]}"
"${run[@]}" apt-get update -qq
for i in "${!missing[@]}"; do
    # Newer Ubuntu releases carry a newer LLVM only.
    if [ "${missing[$i]}" = libllvm19 ] && ! apt-cache show libllvm19 >/dev/null 2>&1; then
        missing[$i]=$(apt-cache search --names-only '^libllvm[0-9]+$' | awk '{print $1}' | sort -V | tail -1)
    fi
done
DEBIAN_FRONTEND=noninteractive "${run[@]}" apt-get install -y -qq "${missing[@]}" >/dev/null
