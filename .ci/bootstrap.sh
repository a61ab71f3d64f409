# Sourced by reproduce.sh and test.sh: makes .venv from requirements/*.lock and leaves $python pointing into it.
#
# Versions are written in environment.yml; its python= line is read here. The locks have its pip section and all that this
# needs, with hashes (.ci/lock.py makes them). The second run compares a stamp and returns at once. pip's own settings
# (PIP_INDEX_URL, PIP_FIND_LINKS, pip.conf …) apply.
# PAPER_ARTIFACT_VENV puts the environment elsewhere; PYTHON names the interpreter to build it from.

repository="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"
venv="${PAPER_ARTIFACT_VENV:-$repository/.venv}"
case "$venv" in /*) ;; *) venv="$PWD/$venv" ;; esac
python="$venv/bin/python"
locks="$repository/requirements"
unset PYTHONHOME PYTHONPATH        # another environment's packages must not show through
export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1

say() { printf '[setup] %s\n' "$*" >&2; }
fail() { printf '[setup] error: %s\n' "$1" >&2; shift; for hint in "$@"; do printf '[setup]   %s\n' "$hint" >&2; done; exit 1; }

wanted_python() { sed -n 's/^ *- *python *= *\([0-9.]*\) *$/\1/p' "$repository/environment.yml"; }

# The pins of environment.yml that no lock has: somebody changed one without the other.
unlocked() {
    cat "$locks/packages.lock" "$locks/torch-cuda.lock" | awk 'FNR == NR { if ($1 ~ /==/) locked[$1] = 1; next }
         /^ *- [A-Za-z0-9_.-]+==/ { sub(/;.*/, "", $2); if (!($2 in locked)) print $2 }' - "$repository/environment.yml"
}

# Installs exactly the files that a lock names. --no-deps: together the locks are complete, as `pip check` finds.
install_locked() { "$1" -m pip install --no-deps --require-hashes -r "$2"; }

# The CPU build of torch where the settings of pip lead to one, else what PyPI has; then everything else.
install_all() {
    { install_locked "$python" "$locks/torch-cpu.lock" || install_locked "$python" "$locks/torch-cuda.lock"; } &&
        install_locked "$python" "$locks/packages.lock" &&
        "$python" -m pip install --no-deps --no-build-isolation -e "$repository" &&
        "$python" -m pip check
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
            sed -n '/^uv==/,/[^\\]$/p' "$locks/packages.lock" > "$tools/uv.lock"
            install_locked "$tools/uv/bin/python" "$tools/uv.lock" >&2 || fail \
                "uv could not be installed from the package index" \
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

# Makes the environment anew; what lies in its place goes only where this script made it.
make_venv() {
    local base
    rmdir "$venv" 2>/dev/null || true
    if { [ -e "$venv" ] || [ -L "$venv" ]; } && [ ! -e "$venv/paper_artifact.made" ] && [ ! -e "$venv/paper_artifact.stamp" ]; then
        fail "$venv is in the way: this command did not make it, and it has no Python $version with pip" \
            "move it elsewhere, or name another folder: PAPER_ARTIFACT_VENV=FOLDER"
    fi
    base="$(host_python)"
    [ -n "$base" ] || base="$(uv_python)" || exit 1
    say "making $venv with $base"
    rm -rf "$venv"
    mkdir -p "$venv" && : > "$venv/paper_artifact.made"
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
    now="$(cat "$repository/environment.yml" "$repository/pyproject.toml" "$locks"/*.lock | cksum) $repository"
    if [ -x "$python" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$now" ] && is_wanted "$python"; then
        return
    fi
    [ -z "$(unlocked)" ] || fail "requirements/ lacks what environment.yml names: $(unlocked | tr '\n' ' ')" \
        "make it again: .venv/bin/python .ci/lock.py"
    if ! { [ -x "$python" ] && is_wanted "$python" && "$python" -m pip --version >/dev/null 2>&1; }; then
        make_venv
    fi
    rm -f "$stamp"
    say "installing the packages of requirements/ (the first time takes minutes; log: $venv/install.log)"
    if ! install_all > "$venv/install.log" 2>&1; then
        grep -E '^(ERROR|WARNING|error|THESE PACKAGES)| requires .* not installed' "$venv/install.log" | tail -n 5 >&2
        fail "the packages could not be installed; the full log is $venv/install.log" \
            "no network? set PIP_INDEX_URL or PIP_FIND_LINKS to a mirror (or in pip.conf)" \
            "disk full? torch alone needs about 1 GB; running the same command again continues" \
            "an old environment in the way? remove it: rm -r $venv"
    fi
    printf '%s\n' "$now" > "$stamp.partial" && mv "$stamp.partial" "$stamp"
    say "ready"
}

bootstrap
export PATH="$venv/bin:$PATH"
# Where the meshes lie beside the repository, they are the mirror: nothing is downloaded, no test is skipped.
if [ -z "${PAPER_ARTIFACT_MIRROR:-}" ] && [ -d "$repository/../shared/meshes" ]; then
    PAPER_ARTIFACT_MIRROR="$(cd "$repository/../shared/meshes" && pwd -P)"
    export PAPER_ARTIFACT_MIRROR
fi
