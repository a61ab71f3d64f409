#!/usr/bin/env bash
# Sets up .venv from environment.yml and runs the checks: ruff and mypy (seconds), pytest, then every committed notebook
# against its own outputs (nbval, strict). Arguments go to pytest, which then runs alone: bash test.sh -k fetch
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/.ci/bootstrap.sh"
cd "$repository"
status=0
if [ "$#" -gt 0 ]; then
    "$python" -m pytest "$@" || status=$?
    exit "$status"
fi
"$python" -m ruff check . || status=$?
"$python" -m mypy || status=$?
"$python" -m pytest tests || status=$?
"$python" -m pytest --nbval --nbval-current-env notebooks || status=$?
exit "$status"
