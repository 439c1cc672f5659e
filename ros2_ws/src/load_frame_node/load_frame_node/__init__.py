"""Interface to testing machines, with a simulated load frame."""

import fringedic_ros  # noqa: F401  (first: it sets the threads of linear algebra before NumPy is loaded)
