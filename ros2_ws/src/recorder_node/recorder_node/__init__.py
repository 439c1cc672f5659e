"""The node that records the topics of a rig and confirms what it has written."""
