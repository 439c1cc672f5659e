"""The node that shows patterns on the projector."""
