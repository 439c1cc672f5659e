"""Shape and 3D displacement of a surface with one camera and one fringe projector."""

import os

os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")

__version__ = "0.1.0"
