#!/usr/bin/env bash
# Sets up .venv from environment.yml and runs the tests: pytest, then every committed notebook against its own outputs
# (nbval, strict). Arguments go to pytest and leave the notebooks out: bash test.sh -k fetch
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/.ci/bootstrap.sh"
cd "$repository"
status=0
if [ "$#" -gt 0 ]; then
    "$python" -m pytest "$@" || status=$?
    exit "$status"
fi
"$python" -m pytest tests || status=$?
"$python" -m pytest --nbval --nbval-current-env notebooks || status=$?
exit "$status"
