"""What every fringedic node shares: QoS profiles, image and cloud conversion, typed parameters, waiting, diagnostics.

Importing it keeps linear algebra on one thread, so that results do not depend on the machine's load. The setting only
counts before NumPy is loaded: each node package imports this one first.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
