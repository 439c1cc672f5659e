"""The ``fringedic`` command, one module per group of subcommands; `fringedic.command.main` is the entry point."""

import os

# linear algebra on one thread, as in the nodes: the desk's numbers are theirs, bit by bit. Set before NumPy is loaded.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
