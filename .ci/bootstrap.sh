# Sourced by reproduce.sh and test.sh: makes .venv from environment.yml and leaves $python pointing into it.
#
# environment.yml is the only place with versions; its python= line and its pip section are read here. The second run
# compares a stamp and returns at once. pip's own settings (PIP_INDEX_URL, PIP_FIND_LINKS, pip.conf …) apply.
# PAPER_ARTIFACT_VENV puts the environment elsewhere; PYTHON names the interpreter to build it from.

repository="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"
venv="${PAPER_ARTIFACT_VENV:-$repository/.venv}"
python="$venv/bin/python"
unset PYTHONHOME PYTHONPATH        # another environment's packages must not show through
export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1

say() { printf '[setup] %s\n' "$*" >&2; }
fail() { printf '[setup] error: %s\n' "$1" >&2; shift; for hint in "$@"; do printf '[setup]   %s\n' "$hint" >&2; done; exit 1; }

wanted_python() { sed -n 's/^ *- *python *= *\([0-9.]*\) *$/\1/p' "$repository/environment.yml"; }

# The pip section, one requirement per line, without "-e ." (installed apart, below).
pip_section() {
    awk '/^ *- *pip: *$/ { inside = 1; next }
         inside && /^ *- / { sub(/^ *- */, ""); sub(/ *#.*$/, ""); if ($0 !~ /^-e /) print; next }
         inside && !/^ *(#.*)?$/ { inside = 0 }' "$repository/environment.yml"
}

is_wanted() { "$1" -c "import sys; raise SystemExit('%d.%d' % sys.version_info[:2] != '$version')" >/dev/null 2>&1; }

# Prints an interpreter of the wanted version that this host has, or nothing.
host_python() {
    local candidate
    for candidate in ${PYTHON:+"$PYTHON"} "python$version" python3 python; do
        if command -v "$candidate" >/dev/null 2>&1 && is_wanted "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
}

# Prints an interpreter of the wanted version that uv brings. uv is taken from PATH, or from PyPI into a side folder.
uv_python() {
    local tools="$repository/.python" uv any
    uv="$(command -v uv || true)"
    if [ -z "$uv" ]; then
        any="$(command -v python3 || command -v python || true)"
        [ -n "$any" ] || fail "no Python on this machine" \
            "install Python $version (python.org, apt, dnf, brew), or conda: conda env create -f environment.yml"
        if [ ! -x "$tools/uv/bin/uv" ]; then
            say "no Python $version here; taking uv from the package index to bring one"
            rm -rf "$tools/uv"
            "$any" -m venv "$tools/uv" >/dev/null 2>&1 || fail "$any cannot make a virtual environment" \
                "Debian, Ubuntu: sudo apt install python3-venv   (or python$version and python$version-venv)" \
                "or use conda: conda env create -f environment.yml && conda activate paper_artifact"
            "$tools/uv/bin/python" -m pip install --quiet uv >&2 || fail "uv could not be installed from the package index" \
                "check the network, or set PIP_INDEX_URL / PIP_FIND_LINKS to a mirror" \
                "or install Python $version yourself and run this again"
        fi
        uv="$tools/uv/bin/uv"
    fi
    export UV_PYTHON_INSTALL_DIR="$tools/versions"
    "$uv" python install --quiet "$version" >&2 || fail "uv could not bring Python $version" \
        "check the network, or set UV_PYTHON_INSTALL_MIRROR to a mirror" \
        "or install Python $version yourself (sudo apt install python$version python$version-venv) and run this again"
    "$uv" python find --managed-python "$version"
}

make_venv() {
    local base
    base="$(host_python)"
    [ -n "$base" ] || base="$(uv_python)" || exit 1
    say "making $venv with $base"
    rm -rf "$venv"
    if ! "$base" -m venv "$venv" >/dev/null 2>&1; then
        rm -rf "$venv"
        fail "$base cannot make a virtual environment (its venv or ensurepip module is missing, or the folder is not writable)" \
            "Debian, Ubuntu: sudo apt install python$version-venv" \
            "or use conda: conda env create -f environment.yml && conda activate paper_artifact"
    fi
}

bootstrap() {
    local stamp="$venv/paper_artifact.stamp" now
    version="$(wanted_python)"
    [ -n "$version" ] || fail "environment.yml has no 'python=X.Y' line" "restore it: git checkout environment.yml"
    # What the environment depends on: the pins, the package's metadata, and where the checkout is (it is linked in).
    now="$(cat "$repository/environment.yml" "$repository/pyproject.toml" | cksum) $repository"
    if [ -x "$python" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$now" ] && is_wanted "$python"; then
        return
    fi
    if ! { [ -x "$python" ] && is_wanted "$python" && "$python" -m pip --version >/dev/null 2>&1; }; then
        make_venv
    fi
    rm -f "$stamp"
    pip_section > "$venv/requirements.txt"
    say "installing the packages of environment.yml (the first time takes minutes; log: $venv/install.log)"
    if ! { "$python" -m pip install -r "$venv/requirements.txt" &&
           "$python" -m pip install --no-deps --no-build-isolation -e "$repository"; } > "$venv/install.log" 2>&1; then
        grep -E '^(ERROR|WARNING|error)' "$venv/install.log" | tail -n 5 >&2
        fail "the packages could not be installed; the full log is $venv/install.log" \
            "no network? set PIP_INDEX_URL or PIP_FIND_LINKS to a mirror (or in pip.conf)" \
            "disk full? torch alone needs about 1 GB; running the same command again continues"
    fi
    printf '%s\n' "$now" > "$stamp.partial" && mv "$stamp.partial" "$stamp"
    say "ready"
}

bootstrap
export PATH="$venv/bin:$PATH"
