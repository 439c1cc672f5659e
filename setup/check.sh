#!/usr/bin/env bash
# Checks the project in the environment that set-up has made.
#   check.sh library   style, types, import contracts, and the unit tests of the library with their coverage
#   check.sh           the same, then tests of the nodes, of the running system, of the pages and notebooks
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST OPENBLAS_NUM_THREADS=1
unset PYTHONDONTWRITEBYTECODE # pytest keeps the tests that it has rewritten
ruff check .
ruff format --check .
lint-imports --no-logo
# Types are checked beside the tests of the library; the report comes after theirs.
types=$(mktemp)
trap 'rm -f "$types"' EXIT
mypy >"$types" 2>&1 &
# Two processes, each file in one of them: most tests of nodes wait more than they compute.
pytest=(python -m pytest -n 2 --dist loadfile)
library=passed
"${pytest[@]}" --doctest-modules --cov --cov-report=term:skip-covered ros2_ws/src/fringedic || library=failed
wait $! || library=failed
cat "$types"
[ $library = passed ]
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
