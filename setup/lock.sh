#!/usr/bin/env bash
# Writes the lock files anew from requirements*.in: exact versions with the hashes of PyPI's files, for Python 3.11 to 3.13.
# It needs uv, which set-up leaves in the environment; what is installed comes from these files alone.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
PATH=$PWD/../.venv/bin:$PATH

for kind in installer ros stock hardware; do
    uv pip compile --no-config --default-index https://pypi.org/simple --no-emit-index-url --no-header --no-annotate --quiet \
        --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
        "requirements-$kind.in" --output-file "requirements-$kind.lock" "$@"
done
