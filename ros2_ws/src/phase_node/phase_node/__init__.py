"""The node that turns fringe frames into phase, modulation and texture."""
