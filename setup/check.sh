#!/usr/bin/env bash
# What `make test` runs in the environment that set-up has made: style, types, then every test. The tests that need
# system packages run where these are; `make test-hardware` asks for them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST OPENBLAS_NUM_THREADS=1
ruff check .
ruff format --check .
mypy
# Two processes, each file in one of them: most tests of nodes wait more than they compute.
pytest=(python -m pytest -n 2 --dist loadfile)
if setup/hardware.sh; then
    "${pytest[@]}" "$@"
else
    echo "without these the tests of real devices are left out; make test-hardware runs them alone" >&2
    "${pytest[@]}" -m "not hardware" "$@"
fi
