"""Starting the node processes of a rig: the graph, which nodes run with which parameters, and its processes."""
