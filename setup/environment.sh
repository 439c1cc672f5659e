# Source this to use the project by hand:  . setup/environment.sh
# It puts the environment's Python, ROS 2 and the built workspace on the paths of this shell.

_fringedic_root=$(cd "$(dirname "${BASH_SOURCE[0]:-${(%):-%x}}")/.." && pwd)
_fringedic_venv=$_fringedic_root/.venv
_fringedic_install=$_fringedic_root/ros2_ws/install
_fringedic_distribution=$(cat "$_fringedic_venv/stamps/distribution" 2>/dev/null)
if [ -n "${ROS_DISTRO:-}" ] && [ "$ROS_DISTRO" != "$_fringedic_distribution" ]; then
    echo "fringedic was built for ROS 2 ${_fringedic_distribution:-(not yet)} and ROS 2 $ROS_DISTRO is sourced:" \
        "run \`make setup\` in this shell, or open a new shell" >&2
    return 1 2>/dev/null || exit 1
fi
_fringedic_site=$(echo "$_fringedic_venv"/lib/python3.*/site-packages)

if [ -d "$_fringedic_site/rclpy" ]; then
    # ROS 2 from PyPI: the environment is the ROS prefix
    AMENT_PREFIX_PATH=$_fringedic_install:$_fringedic_venv
    CMAKE_PREFIX_PATH=$AMENT_PREFIX_PATH
    LD_LIBRARY_PATH=$_fringedic_install/lib:$_fringedic_venv/lib$(find "$_fringedic_site" -maxdepth 1 -name 'ros_*.libs' -printf ':%p')
    export ROS_DISTRO=$_fringedic_distribution # recordings state it
    export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 # the paths are set: Python need not start a second time to set them
else
    AMENT_PREFIX_PATH=$_fringedic_install${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}
    CMAKE_PREFIX_PATH=$_fringedic_install${CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}
    LD_LIBRARY_PATH=$_fringedic_install/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
fi
# libraries that correct Fast DDS; they are loaded before the C library
for _fringedic_library in "$_fringedic_venv/lib/unlimited_wait.so" "$_fringedic_venv/lib/private_memory.so"; do
    case ${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp}:${LD_PRELOAD:-}: in
    *:$_fringedic_library:*) ;;
    rmw_fastrtps*) [ ! -f "$_fringedic_library" ] || export LD_PRELOAD=$_fringedic_library${LD_PRELOAD:+:$LD_PRELOAD} ;;
    esac
done
PATH=$_fringedic_venv/bin:$_fringedic_install/bin:$PATH
export PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH
unset PYTHONDONTWRITEBYTECODE # containers set it; each node would compile all libraries again at every start
export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
unset _fringedic_library _fringedic_root _fringedic_venv _fringedic_install _fringedic_site _fringedic_distribution
