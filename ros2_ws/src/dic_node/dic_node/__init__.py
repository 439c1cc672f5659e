"""The node that turns textures into in-plane displacement."""
