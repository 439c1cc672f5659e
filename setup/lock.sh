#!/usr/bin/env bash
# Writes the lock files anew from requirements*.in: exact versions with the hashes of PyPI's files, for Python 3.11 to 3.13.
# It needs uv (pip install uv); what is installed comes from these files alone.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

for kind in ros stock hardware; do
    uv pip compile --no-config --default-index https://pypi.org/simple --no-emit-index-url --no-header --no-annotate --quiet \
        --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
        "requirements-$kind.in" --output-file "requirements-$kind.lock" "$@"
done
