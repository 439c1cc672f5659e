#!/usr/bin/env bash
# Builds everything that `make demo` and `make test` need, inside the checkout, without root: the Python environment from
# the lock file, ROS 2 from PyPI (unless a ROS 2 installation is sourced), the workspace, the compiled kernels.
# What has not changed since the last time is not done again. Details go to setup.log.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"
venv=$root/.venv
stamps=$venv/stamps
log=$root/setup.log
needed_mib=4500 # environment, build and compiled kernels, with what pip needs meanwhile

stop() {
    printf 'set-up: %s\n' "$1" >&2
    exit 1
}

# Runs one long command quietly; its output goes to the log, a failure is told in one sentence.
run() {
    local what=$1 started=$SECONDS
    shift
    printf 'set-up: %s ... ' "$what"
    printf '\n== %s: %s\n' "$what" "$*" >>"$log"
    local from
    from=$(wc -l <"$log")
    if "$@" >>"$log" 2>&1 </dev/null; then
        printf '%s s\n' "$((SECONDS - started))"
        return
    fi
    printf 'failed\n'
    local said
    said=$(tail -n +"$from" "$log")
    case $said in
    *"No space left on device"* | *"Disk quota exceeded"*)
        stop "the disk is full; free $((needed_mib / 1000)) GB where the checkout and $TMPDIR lie and start again" ;;
    *"Temporary failure in name resolution"* | *"Failed to establish a new connection"* | *"Network is unreachable"* | \
        *"Connection refused"* | *"Read timed out"* | *"ProxyError"* | *"Max retries exceeded"*)
        stop "PyPI cannot be reached; connect this computer to the network (or set PIP_INDEX_URL to a mirror) and start again" ;;
    *"Python.h"*)
        stop "the headers of Python are missing; install them (Debian, Ubuntu: apt install python3-dev) and start again" ;;
    esac
    stop "$what failed; the reason stands at the end of $log"
}

suits() {
    "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null
}

find_python() {
    local candidate
    if [ -n "${PYTHON:-}" ]; then
        suits "$PYTHON" || stop "PYTHON=$PYTHON is not Python 3.11, 3.12 or 3.13; name one that is, or unset PYTHON"
        printf '%s' "$PYTHON"
        return
    fi
    for candidate in python3 python3.13 python3.12 python3.11; do
        if suits "$candidate"; then
            printf '%s' "$candidate"
            return
        fi
    done
    stop "Python 3.11, 3.12 or 3.13 is needed and $(python3 --version 2>/dev/null || echo 'no Python') was found; install one (Debian, Ubuntu: apt install python3 python3-venv) or name it with PYTHON=..."
}

# One number for the contents of the named files.
fingerprint() {
    sort -z | xargs -0 sha256sum | sha256sum | cut -d' ' -f1
}

current() { # stamp, value: whether this was done for the same value before
    [ -f "$stamps/$1" ] && [ "$(cat "$stamps/$1")" = "$2" ]
}

done_for() {
    printf '%s' "$2" >"$stamps/$1"
}

: "${TMPDIR:=/tmp}"
python=$(find_python)
command -v g++ >/dev/null || stop "the C++ compiler g++ is missing; install it (Debian, Ubuntu: apt install g++) and start again"
"$python" -c 'import venv, ensurepip' 2>/dev/null ||
    stop "Python has no venv module; install it (Debian, Ubuntu: apt install python3-venv) and start again"

# A sourced ROS 2 installation is used as it is; its compiled messages need NumPy 1.
if [ -n "${ROS_DISTRO:-}" ] && [[ :${AMENT_PREFIX_PATH:-}: != *":$venv:"* ]]; then
    lock=$root/setup/requirements-stock.lock
    venv_options=(--system-site-packages)
    ros="ROS 2 $ROS_DISTRO as sourced"
else
    lock=$root/setup/requirements-ros.lock
    venv_options=()
    ros="ROS 2 Jazzy from PyPI"
fi

exec 9>"$root/.setup.lock"
flock 9 # two makes at once: the second waits

environment="$(sha256sum <"$lock") $("$python" -c 'import sys; print(sys.version)') ${venv_options[*]:-}"
if ! current environment "$environment"; then
    free_mib=$(df -Pm "$root" | awk 'NR == 2 { print $4 }')
    [ "$free_mib" -ge "$needed_mib" ] ||
        stop "the disk has $free_mib MB free and $needed_mib MB are needed; free some where the checkout lies and start again"
    : >"$log"
    rm -rf "$venv" "$root/ros2_ws/build" "$root/ros2_ws/install" "$root/ros2_ws/log"
    run "Python environment" "$python" -m venv "${venv_options[@]}" "$venv"
    mkdir -p "$stamps"
    run "$ros and the Python packages" "$venv/bin/python" -m pip install --disable-pip-version-check \
        --no-input --require-hashes --no-deps -r "$lock"
    run "paths inside the ROS packages" "$venv/bin/python" "$root/setup/relocate_ros.py"
    done_for environment "$environment"
fi

# Python sources are linked, so that only what colcon copies or generates needs another build.
workspace="$root $(find ros2_ws/src \( -name 'setup.py' -o -name 'setup.cfg' -o -name package.xml -o -name CMakeLists.txt \
    -o -path '*/fringedic_msgs/*' \) -type f -print0 | fingerprint) $(find ros2_ws/src -path '*/config/*' -o -path '*/launch/*' | sort | sha256sum)"
if ! current workspace "$workspace"; then
    # shellcheck source=/dev/null
    . "$root/setup/environment.sh" --without-workspace
    run "workspace" "$venv/bin/python" -m colcon --log-base ros2_ws/log build --base-paths ros2_ws/src \
        --build-base ros2_ws/build --install-base ros2_ws/install --merge-install --symlink-install \
        --event-handlers console_direct+ \
        --cmake-args -DPython3_EXECUTABLE="$venv/bin/python" -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release
    built=$(find ros2_ws/build -name colcon_build.rc -newer "$stamps/environment" | wc -l)
    packages=$(find ros2_ws/src -name package.xml | wc -l)
    [ "$built" -ge "$packages" ] || stop "only $built of $packages packages were built; the reason stands in $log"
    done_for workspace "$workspace"
fi

kernels="$root $(find ros2_ws/src/fringedic/fringedic -name '*.py' -print0 | fingerprint)"
if ! current kernels "$kernels"; then
    set +u # colcon's files read variables that need not be there
    # shellcheck source=/dev/null
    . "$root/setup/environment.sh"
    set -u
    run "compiled kernels" "$venv/bin/python" -m fringedic.warm_up
    done_for kernels "$kernels"
fi
