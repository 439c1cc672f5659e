"""What depends on the middleware, in one place: everything else uses ROS 2 alone.

====================  ===============================  ====================  ==================
function              Fast DDS                         other DDS (Cyclone)   others (Zenoh)
====================  ===============================  ====================  ==================
`settings`            profile, size of shared memory,  none                  none
                      address
`enter`               ports that no process has used   nothing               nothing
`remove_leftovers`    shared memory of killed nodes    nothing               nothing
`process_of`          from the GID                     from the GID          name of the node
`servers_of`          GIDs of the response topic       the same              services of the graph
`OtherUsers`          ports without shared memory      all ports             cannot be seen
====================  ===============================  ====================  ==================

`fringedic_ros.rmw` finds out which one is used. ``setup/environment.sh`` loads the two libraries that correct Fast DDS
with it alone. The page "Middleware" of the documentation states what was measured.
"""

from fringedic_ros.middleware.endpoints import Endpoint, process_of, servers_of
from fringedic_ros.middleware.other_users import OtherUsers
from fringedic_ros.middleware.processes import enter, remove_leftovers, settings

__all__ = [
    "Endpoint",
    "OtherUsers",
    "enter",
    "process_of",
    "remove_leftovers",
    "servers_of",
    "settings",
]
