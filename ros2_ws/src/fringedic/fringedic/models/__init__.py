"""Comparison of a measurement with a finite-element model or with a nominal shape.

`model` reads a mesh with the displacement of its nodes at each load, `placement` aligns it with the measured surface,
`sampling` interpolates it at the measured points, `levelling` filters it as the measurement does (`rendering` measures
it), `comparison` returns the differences in units of their uncertainty, `on_mesh` at the nodes of the mesh, and `shape`
those of the shape alone. A model is in metres, and in its own frame until it is placed.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
