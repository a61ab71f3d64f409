#!/usr/bin/env bash
# Sets up .venv from environment.yml and executes every notebook in order.
#   bash reproduce.sh                    from the committed records (minutes)
#   bash reproduce.sh --profile full     trains everything again (hours)
#   bash reproduce.sh --only NAME        one notebook; further options: python -m paper_artifact run-all --help
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/.ci/bootstrap.sh"
cd "$repository"
exec "$python" -m paper_artifact run-all "$@"
