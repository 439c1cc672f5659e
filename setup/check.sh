#!/usr/bin/env bash
# Checks the project in the environment that set-up has made.
#   check.sh library   style, types, import contracts, and the unit tests of the library with their coverage
#   check.sh           the same, then tests of the nodes, of the running system, of the pages and notebooks
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST OPENBLAS_NUM_THREADS=1
ruff check .
ruff format --check .
mypy
lint-imports --no-logo
# Two processes, each file in one of them: most tests of nodes wait more than they compute.
pytest=(python -m pytest -n 2 --dist loadfile)
"${pytest[@]}" --doctest-modules --cov --cov-report=term:skip-covered ros2_ws/src/fringedic
if [ "${1:-}" = library ]; then
    exit
fi
rest=(tests)
for package in ros2_ws/src/*/test; do
    [ "$package" = ros2_ws/src/fringedic/test ] || rest+=("$package")
done
if setup/hardware.sh; then
    "${pytest[@]}" "${rest[@]}"
else
    echo "without these packages the tests of real devices are left out; make test-hardware runs them alone" >&2
    "${pytest[@]}" -m "not hardware" "${rest[@]}"
fi
