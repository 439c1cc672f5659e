"""Shared parts of all nodes: QoS profiles, image and cloud conversion, typed parameters, waiting, diagnostics.

The import restricts linear algebra to one thread, so that results do not depend on the load of the computer. The
setting has an effect only before NumPy is loaded: each node package imports this one first.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
