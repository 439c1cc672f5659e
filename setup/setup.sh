#!/usr/bin/env bash
# Builds everything that `make demo` and `make test` need, inside the checkout, without root: the Python environment from
# the lock files, ROS 2 from PyPI (unless a ROS 2 installation is sourced), the workspace, the compiled kernels.
# ROS=kilted selects another distribution from PyPI than Jazzy, which is supported longest of those that PyPI has.
# KERNELS=no leaves the kernels to be compiled when they are used; those that are there are kept.
# What has not changed since the last time is not done again. Details go to setup.log.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"
venv=$root/.venv
stamps=$venv/stamps
log=$root/setup.log
needed_mb=4000 # 2.3 GB stay; built distributions and the workspace come on top
pythons="3.11, 3.12, 3.13 or 3.14"
without="; PyPy and free-threaded builds have no packages of ROS 2"

stop() {
    printf 'set-up: %s\n' "$1" >&2
    exit 1
}

# Runs one long command quietly; its output goes to the log, a failure is told in one sentence.
run() {
    local what=$1 started=$SECONDS from said
    shift
    printf 'set-up: %s ... ' "$what"
    [ -n "${logging:-}" ] || : >"$log"
    logging=yes
    from=$(($(wc -l <"$log") + 1))
    printf '== %s: %s\n' "$what" "$*" >>"$log"
    if "$@" >>"$log" 2>&1 </dev/null; then
        printf '%s s\n' "$((SECONDS - started))"
        return
    fi
    printf 'failed\n'
    said=$(tail -n +"$from" "$log")
    case $said in
    *"No space left on device"* | *"Disk quota exceeded"*)
        stop "the disk is full: free $needed_mb MB where $root and ${TMPDIR:-/tmp} lie and start again (details: $log)" ;;
    *"Hash mismatch"* | *"DO NOT MATCH THE HASHES"*) # uv calls this a failed download, too
        stop "the package index has another file than the lock names: unset PIP_INDEX_URL or set it to another mirror, and start again (details: $log)" ;;
    *"connection broken by"* | *"(from versions: none)"* | *"Read timed out"* | *"IncompleteRead"* | *"Connection reset"* | \
        *"Failed to fetch"* | *"Failed to download"* | *"not found in the package registry"*)
        stop "the Python package index cannot be reached: connect this computer to the network, or set PIP_INDEX_URL to a mirror, and start again (details: $log)" ;;
    esac
    stop "$what failed: read the reason at the end of $log, mend it and start again"
}

# What set-up must know of a Python: version, executable (of an environment: the one beneath), include folder, and whether
# it can make environments.
describe() {
    "$1" - <<'QUESTION' 2>/dev/null
import importlib.util, os, sys, sysconfig
if not (3, 11) <= sys.version_info[:2] <= (3, 14):
    sys.exit(1)
if sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
    sys.exit(1)  # ROS 2 and others have no packages for PyPy and for Python without its lock
executable = os.path.realpath(sys._base_executable)
venv = all(importlib.util.find_spec(module) for module in ("venv", "ensurepip"))
print("python%d.%d" % sys.version_info[:2], executable, sysconfig.get_path("include"), venv, sep="|")
QUESTION
}

# The Python that was used before stays the one in use, whatever is active in this shell.
find_python() {
    local candidate
    if [ -n "${PYTHON:-}" ]; then
        describe "$PYTHON" || stop "PYTHON=$PYTHON is not Python $pythons: name one that is, or unset PYTHON$without"
        return
    fi
    for candidate in "$@" python3 python3.12 python3.13 python3.14 python3.11; do
        describe "$candidate" && return
    done
    stop "Python $pythons is needed and $(python3 --version 2>/dev/null || echo 'no Python') was found: install one (Debian, Ubuntu: sudo apt install python3 python3-venv) or name it with PYTHON=...$without"
}

# Debian keeps the headers of Python in a package of their own; unpacked inside the environment they need no root.
unpack_headers() {
    mkdir -p "$venv/headers"
    cd "$venv/headers"
    apt-get download "lib$version-dev"
    dpkg-deb --extract "lib$version"-dev_*.deb .
    rm "lib$version"-dev_*.deb
    [ -f "usr/include/$version/Python.h" ]
}

# The value of one of pip's options, from its variables and files, which uv does not read; the last place has priority.
configured() {
    local options level value=
    options=$("$venv/bin/python" -m pip config list 2>/dev/null) || return 0
    for level in global install :env:; do
        [[ $options =~ (^|$'\n')"$level.$1='"([^\']*)\' ]] && value=${BASH_REMATCH[2]}
    done
    printf '%s' "$value"
}

# Downloads and unpacks the locked packages in parallel, six times faster than pip. Its cache lies inside the environment,
# from where files are linked instead of copied.
install_packages() {
    local index certificate
    index=$(configured index-url) certificate=$(configured cert)
    [ -z "$index" ] || export UV_DEFAULT_INDEX=$index
    [ -z "$certificate" ] || export SSL_CERT_FILE=$certificate
    "$venv/bin/uv" pip install --no-config --no-progress --python "$venv/bin/python" --cache-dir "$venv/cache" \
        --require-hashes --no-deps "${@/#/--requirement=}" || return
    rm -rf "$venv/cache"
}

# One number for the contents of the files whose names come in.
fingerprint() {
    sort -z | xargs -0 sha256sum | sha256sum | cut -d' ' -f1
}

current() { # stamp, value: whether this was done for the same value before
    [ -f "$stamps/$1" ] && [ "$(cat "$stamps/$1")" = "$2" ]
}

done_for() {
    printf '%s' "$2" >"$stamps/$1"
}

# The prefixes of the ROS 2 installations that are sourced: each has its own rclpy.
sourced=()
IFS=: read -ra prefixes <<<"${AMENT_PREFIX_PATH:-}"
for prefix in "${prefixes[@]}"; do
    if [ "$prefix" != "$venv" ] && [ -f "$prefix/share/rclpy/package.xml" ]; then
        sourced+=("$prefix")
    fi
done
[ ${#sourced[@]} -le 1 ] ||
    stop "several ROS 2 installations are sourced (${sourced[*]}): open a new shell and source one"

# A sourced ROS 2 installation is used as it is, with the NumPy that its messages are compiled for.
if [ -n "${ROS_DISTRO:-}" ] && [[ :${AMENT_PREFIX_PATH:-}: != *":$venv:"* ]]; then
    case $ROS_DISTRO in
    jazzy | kilted | lyrical) ;;
    *) stop "ROS 2 $ROS_DISTRO is sourced, and fringedic runs on jazzy, kilted and lyrical: source one of these, or start from a shell without ROS 2" ;;
    esac
    [ "${ROS:-$ROS_DISTRO}" = "$ROS_DISTRO" ] ||
        stop "ROS=$ROS was requested and ROS 2 $ROS_DISTRO is sourced: unset ROS, or start from a shell without ROS 2"
    distribution=$ROS_DISTRO
    interpreter=$(find_python)
    locks=("$root/setup/requirements-stock.lock")
    venv_options=(--system-site-packages)
    message_options=() # C++ programs of this installation read the messages
    ros="Python packages beside ROS 2 $distribution"
else
    # The distribution that was used before stays the one in use.
    distribution=${ROS:-$(cat "$stamps/distribution" 2>/dev/null || echo jazzy)}
    case $distribution in
    jazzy | kilted) ;;
    *) stop "ROS=$distribution is not on the Python package index: select jazzy or kilted, or source ROS 2 $distribution and unset ROS" ;;
    esac
    [ "$(uname -sm)" = "Linux x86_64" ] ||
        stop "ROS 2 comes from PyPI for Linux on x86-64 only: install ROS 2 (Jazzy, Kilted or Lyrical), source its setup.bash and start again"
    interpreter=$(find_python "$venv/bin/python3")
    locks=("$root/setup/requirements.lock" "$root/setup/requirements-$distribution.lock")
    venv_options=()
    # messages without C++, and less optimisation: conversions of small messages never return the time of the compiler
    message_options=(-DPYTHON_ONLY=ON -DCMAKE_C_FLAGS_RELEASE=-O1 -DCMAKE_CXX_FLAGS_RELEASE=-O1)
    ros="Python packages and ROS 2 $distribution"
fi
IFS='|' read -r version python python_include has_venv <<<"$interpreter"
[ "$has_venv" = True ] ||
    stop "Python has no venv module: install it (Debian, Ubuntu: sudo apt install $version-venv) and start again"
for compiler in gcc g++; do
    command -v "$compiler" >/dev/null ||
        stop "the compiler $compiler is missing: install it (Debian, Ubuntu: sudo apt install g++) and start again"
done
if [ -n "${venv_options[*]}" ]; then
    "$python" -c 'import rclpy' 2>/dev/null ||
        stop "ROS 2 $distribution is sourced and $python cannot import its rclpy: name the Python it was built for with PYTHON=..., or start from a shell without ROS 2"
    "$python" -c 'from sensor_msgs.msg import CameraInfo; CameraInfo.__import_type_support__()' 2>/dev/null ||
        stop "the messages of ROS 2 $distribution do not load with the NumPy of $python ($("$python" -c 'import numpy; print(numpy.__version__, numpy.__file__)' 2>/dev/null || echo none)): remove that NumPy and use the one that ROS 2 installs (Debian, Ubuntu: sudo apt install python3-numpy)"
fi

exec 9>"$root/.setup.lock"
flock 9 # two makes at once: the second waits

if [ ! -f "$python_include/Python.h" ]; then
    python_include=$venv/headers/usr/include/$version
    export CPATH=$venv/headers/usr/include
fi

environment="$root $distribution $interpreter $(cat "${locks[@]}" | sha256sum) ${venv_options[*]:-}"
if ! current environment "$environment"; then
    free_mb=$(df -Pm "$root" | awk 'NR == 2 { print $4 }')
    [ "$free_mb" -ge "$needed_mb" ] ||
        stop "the disk is full: $needed_mb MB are needed where $root lies and $free_mb MB are free; free some and start again"
    rm -rf "$venv" "$root/ros2_ws/build" "$root/ros2_ws/install" "$root/ros2_ws/log"
    mkdir -p "$stamps"
    [ -f "$python_include/Python.h" ] || (run "headers of Python" unpack_headers) 2>/dev/null ||
        stop "the header files of Python are missing: install them (Debian, Ubuntu: sudo apt install $version-dev) and start again (details: $log)"
    run "Python environment" "$python" -m venv "${venv_options[@]}" "$venv"
    run "installer of the packages" "$venv/bin/python" -m pip install --no-compile --disable-pip-version-check --no-input \
        --require-hashes --no-deps --requirement "$root/setup/requirements-installer.lock"
    run "$ros" install_packages "${locks[@]}"
    [ -n "${venv_options[*]}" ] || run "paths inside the ROS packages" "$venv/bin/python" "$root/setup/relocate_ros.py" "$python_include"
    done_for distribution "$distribution"
    done_for environment "$environment"
fi

# Compiles a library that corrects the middleware, if its source has changed; setup/environment.sh loads it.
compile_library() { # stamp, source without suffix
    local source
    source=$(sha256sum <"setup/$2.c")
    if ! current "$1" "$source"; then
        run "$1 of the middleware" gcc -shared -fPIC -O2 -o "$venv/lib/$2.so" "setup/$2.c" -ldl
        done_for "$1" "$source"
    fi
}

[ -n "${venv_options[*]}" ] || compile_library waits unlimited_wait # an installed ROS 2 waits on the steady clock
compile_library memory private_memory

[ -n "${venv_options[*]}" ] || unset ROS_DISTRO # of the distribution that this environment had before
# shellcheck source=/dev/null
. "$root/setup/environment.sh"

# The kernels are compiled beside the workspace, which they do not need. The load that this makes is no reason for make to
# wait (colcon's own -l option).
kernels=$(find ros2_ws/src/fringedic/fringedic -name '*.py' -print0 | fingerprint)
if [ "${KERNELS:-yes}" != no ] && ! current kernels "$kernels"; then
    # Numba compares a kernel's own file only, not those of the functions that it calls. An interrupted set-up ends the
    # compiling processes, which form a session.
    rm -f "$stamps/kernels" # an interrupted set-up leaves none
    find ros2_ws/src -name '*.nb[ic]' -delete
    PYTHONPATH=$root/ros2_ws/src/fringedic setsid "$venv/bin/python" -m fringedic.warm_up >"$log.kernels" 2>&1 </dev/null 9>&- &
    compiling=$!
    trap 'kill -- -$compiling 2>/dev/null || true' EXIT
fi

# Python sources are linked, so that only what colcon copies or generates needs another build.
workspace="$(find ros2_ws/src \( -name setup.py -o -name setup.cfg -o -name package.xml -o -name CMakeLists.txt \
    -o -path '*/fringedic_msgs/*/*' \) -type f -print0 | fingerprint) $(find ros2_ws/src/*/{config,launch,rviz,scripts} -type f | sort | sha256sum)"
if ! current workspace "$workspace"; then
    export MAKEFLAGS=-j$(nproc)
    run "workspace" "$venv/bin/python" -m colcon --log-base ros2_ws/log build --base-paths ros2_ws/src \
        --build-base ros2_ws/build --install-base ros2_ws/install --merge-install --symlink-install \
        --event-handlers console_direct+ --cmake-args -DPython3_EXECUTABLE="$venv/bin/python" \
        -DPython3_INCLUDE_DIR="$python_include" -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release "${message_options[@]}"
    packages=$(find ros2_ws/src -name package.xml | wc -l)
    built=$(find ros2_ws/install/share/ament_index/resource_index/packages -type f -o -type l | wc -l)
    [ "$built" -ge "$packages" ] || stop "only $built of $packages packages were built: read the reason in $log"
    # this Python finds the workspace by itself: compiled messages and linked packages
    {
        printf '%s\n' "$root/ros2_ws/install/lib/$version/site-packages"
        find "$root/ros2_ws/build" -mindepth 2 -maxdepth 2 -name '*.egg-info' -printf '%h\n' | sort
    } >"$venv/lib/$version/site-packages/fringedic_workspace.pth"
    printf '#!/usr/bin/env bash\n. "%s/setup/environment.sh"\nexec "%s/ros2_ws/install/bin/fringedic" "$@"\n' "$root" "$root" \
        >"$venv/bin/fringedic"
    chmod +x "$venv/bin/fringedic"
    done_for workspace "$workspace"
fi

# The end of a process in the background, with what it wrote.
compiled() {
    wait "$compiling" && status=0 || status=$?
    cat "$log.kernels" && rm "$log.kernels"
    return "$status"
}

if [ -n "${compiling:-}" ]; then
    run "compiled kernels, begun beside the workspace" compiled
    trap - EXIT
    done_for kernels "$kernels"
fi
