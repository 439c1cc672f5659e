"""Shape and 3D displacement of a surface with one camera and one fringe projector."""
