# Source this to use the project by hand:  . setup/environment.sh
# It puts the environment's Python, ROS 2 and the built workspace on the paths of this shell.

_fringedic_root=$(cd "$(dirname "${BASH_SOURCE[0]:-${(%):-%x}}")/.." && pwd)
_fringedic_venv=$_fringedic_root/.venv
_fringedic_site=$(echo "$_fringedic_venv"/lib/python3.*/site-packages)

PATH=$_fringedic_venv/bin:$PATH
if [ -d "$_fringedic_site/rclpy" ]; then
    # ROS 2 from PyPI: the environment is the ROS prefix
    AMENT_PREFIX_PATH=$_fringedic_venv
    CMAKE_PREFIX_PATH=$_fringedic_venv
    LD_LIBRARY_PATH=$_fringedic_venv/lib$(find "$_fringedic_site" -maxdepth 1 -name 'ros_*.libs' -printf ':%p')
    export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 # the paths are set: Python need not start a second time to set them
else
    PYTHONPATH=$_fringedic_site${PYTHONPATH:+:$PYTHONPATH}
    export PYTHONPATH
fi
export PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH
export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}

if [ "${1:-}" != --without-workspace ]; then
    COLCON_CURRENT_PREFIX=$_fringedic_root/ros2_ws/install
    . "$COLCON_CURRENT_PREFIX/local_setup.sh"
    unset COLCON_CURRENT_PREFIX
fi
unset _fringedic_root _fringedic_venv _fringedic_site
