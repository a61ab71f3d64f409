#!/usr/bin/env bash
# Sets up .venv from environment.yml, executes every notebook in order and makes the book of them,
# results/book/index.html.
#   bash reproduce.sh                    from the committed records (minutes)
#   bash reproduce.sh --profile full     trains everything again (hours)
#   bash reproduce.sh --only NAME        one notebook; further options: python -m paper_artifact run-all --help
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/.ci/bootstrap.sh"
cd "$repository"
status=0
"$python" -m paper_artifact run-all "$@" || status=$?
case " $* " in *" -h "* | *" --help "*) exit "$status" ;; esac
"$python" -m paper_artifact book || status=$?  # of what did run, too
exit "$status"
