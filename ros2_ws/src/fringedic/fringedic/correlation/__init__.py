"""In-plane displacement of a textured surface between two images (section 2 of the paper)."""

from fringedic.correlation.measure import Reference, measure_displacement

__all__ = ["Reference", "measure_displacement"]
