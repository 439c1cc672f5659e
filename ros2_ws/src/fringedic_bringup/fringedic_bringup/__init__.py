"""The graph of a rig and the `fringedic` command."""
