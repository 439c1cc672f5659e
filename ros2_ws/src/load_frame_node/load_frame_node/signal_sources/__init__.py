"""Sources of further signals of a rig: each is read in a thread of its own."""
