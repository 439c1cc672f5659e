#!/usr/bin/env bash
# Writes the lock files anew from requirements*.in: exact versions with the hashes of PyPI's files, for Python 3.11 to 3.14.
# A distribution of ROS 2 has a lock file of its own packages only, beside requirements.lock, so that everything else is the same
# with every distribution. It needs uv, which set-up leaves in the environment; what is installed comes from these files alone.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
PATH=$PWD/../.venv/bin:$PATH

compile() { # input, output, further options
    local input=$1 output=$2
    shift 2
    uv pip compile --no-config --default-index https://pypi.org/simple --no-emit-index-url --no-header --no-annotate --quiet \
        --universal --python-version 3.11 --fork-strategy fewest --generate-hashes "$input" --output-file "$output" "$@"
}

names() { # of the packages in a lock file
    sed -n 's/^\([a-z0-9._-]*\)==.*/\1/p' "$1" | sort --unique
}

compile requirements-installer.in requirements-installer.lock "$@"
compile requirements-hardware.in requirements-hardware.lock "$@"
compile requirements-stock.in requirements-stock.lock --no-emit-package numpy "$@"
compile requirements.in requirements.lock "$@"
mapfile -t common < <(names requirements.lock)
for distribution in jazzy kilted; do
    compile "requirements-$distribution.in" "requirements-$distribution.lock" --constraint requirements.lock \
        "${common[@]/#/--no-emit-package=}" "$@"
done
