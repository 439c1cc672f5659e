#!/usr/bin/env bash
# Checks the project in the environment that set-up has made.
#   check.sh library   style, types, import contracts, and the unit tests of the library
#   check.sh           the same, then tests of the nodes, of the running system, of the pages and notebooks
# With COVERAGE=yes the coverage of the library by its unit tests is measured, which costs a third of their time.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST OPENBLAS_NUM_THREADS=1
ruff check .
ruff format --check .
lint-imports --no-logo
# Types are checked beside the tests of the library; the report comes after theirs.
types=$(mktemp)
trap 'rm -f "$types"' EXIT
mypy >"$types" 2>&1 &
# Files go to the workers in the order of the folders; in that of the number of tests, files of a few long ones would be left for the end.
# A worker that has crashed is not replaced: its test would be repeated up to 16 times, and then waited for without end.
# Tests press Ctrl-C and close terminals, which processes ignore that were started in the background or by nohup.
pytest=(env --default-signal=INT,HUP python -m pytest --dist loadfile --no-loadscope-reorder --max-worker-restart 0)
coverage=(${COVERAGE:+--cov --cov-report=term:skip-covered})
library=passed
"${pytest[@]}" -n "$(nproc)" --doctest-modules "${coverage[@]}" ros2_ws/src/fringedic || library=failed
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
chosen=(-m "not operate") # which take minutes: make test-hardware runs them
if ! setup/hardware.sh; then
    echo "without these packages the tests of real devices are left out; make test-hardware runs them alone" >&2
    chosen=(-m "not hardware and not operate")
fi
files=$(git status --porcelain || true)
# Most tests of nodes start ten processes and then wait; more of them at a time than these only take time from each other.
"${pytest[@]}" -n $(($(nproc) < 4 ? 3 : 4)) "${chosen[@]}" "${rest[@]}"
if [ "$files" != "$(git status --porcelain || true)" ]; then
    echo "the tests have left files in the checkout:" >&2
    git status --porcelain >&2
    exit 1
fi
