"""Material points of a surface: 3D displacement, its local components, strain.

The shape is known at every pixel of each step; the in-plane displacement gives the pixel to which a material point has
moved. All lengths are in metre in the rig frame; NaN is "not measured".

`coupling` computes the 3D displacement of prepared shapes (`prepared`), `shading` takes the motion that turning flanks
of a relief imitate out of the in-plane displacement, `local_frame` and `strain` evaluate planes that `planes` fits in
moving windows, on one side of `discontinuities` only (`masked_fit`); `curvature` corrects the strain for the curvature
within a window, from second derivatives at the points of a `coarse_grid`. A new strain measure is an entry of
`strain_measures`. `specimen_frames` are frames chosen by the user.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
