"""In-plane displacement of a textured surface between images (Molimard et al., section 2).

`measure` is the public function. `dense` and `zoi` are the two methods, `transfer` their transfer function, `agreement`
the validity and the uncertainty of the dense one, `start` its global search. `points` measures all that an image
contains with the dense one: periodic textures (`lattice`, `periodic_start`), `other_motions`, and faint textures
(`texture_noise`). `increments` composes displacements, `closure` checks them, and `extensometer` follows two gauge
subsets. Modules named `*_kernels` contain the compiled loops.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
