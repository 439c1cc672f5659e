"""The node that talks to a testing machine."""
