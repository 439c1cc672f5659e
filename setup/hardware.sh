#!/usr/bin/env bash
# Makes the environment ready for real devices, or says which system packages are missing (exit code 3).
#   hardware.sh            bindings of Aravis, from system packages that are there
#   hardware.sh --install  installs missing system packages first, where this user may
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

packages=(gir1.2-aravis-0.8 aravis-tools libgirepository1.0-dev libcairo2-dev pkg-config gcc xvfb x11-xserver-utils chromium firefox-esr)

missing() {
    for package in "${packages[@]}"; do
        dpkg-query --show --showformat='${Status}\n' "$package" 2>/dev/null | grep -q 'ok installed' || echo "$package"
    done
}

mapfile -t absent < <(missing)
if [ ${#absent[@]} -gt 0 ] && [ "${1:-}" = --install ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    export DEBIAN_FRONTEND=noninteractive
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends "${absent[@]}"; } >/dev/null 2>&1 || true
    mapfile -t absent < <(missing)
fi
if [ ${#absent[@]} -gt 0 ]; then
    echo "missing for real devices: ${absent[*]}" >&2
    echo "install them with: sudo apt-get install ${absent[*]}" >&2
    exit 3
fi
if ! .venv/bin/python -c 'import gi; gi.require_version("Aravis", "0.8")' 2>/dev/null; then
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes \
        --requirement setup/requirements-hardware.lock
fi
