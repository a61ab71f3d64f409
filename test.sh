#!/usr/bin/env bash
# Sets up .venv and runs the checks: ruff and mypy (seconds), pytest, then every committed notebook against its own outputs
# (nbval, strict), both on all cores. Arguments go to pytest, which then runs alone: bash test.sh -k fetch
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/.ci/bootstrap.sh"
cd "$repository"
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"  # a process per core, a thread each; results do not depend on it
status=0
if [ "$#" -gt 0 ]; then
    "$python" -m pytest "$@" || status=$?
    exit "$status"
fi
workers=(-n auto --maxprocesses 8 --dist loadfile)
"$python" -m ruff check . || status=$?
"$python" -m mypy || status=$?
"$python" -m pytest tests "${workers[@]}" || status=$?
"$python" -m pytest --nbval --nbval-current-env notebooks "${workers[@]}" || status=$?
exit "$status"
