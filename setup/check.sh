#!/usr/bin/env bash
# What `make test` runs in the environment that set-up has made: style, types, then every test.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST OPENBLAS_NUM_THREADS=1
ruff check .
ruff format --check .
mypy
python -m pytest "$@"
