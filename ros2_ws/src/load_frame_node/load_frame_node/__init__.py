"""Talks to testing machines; a simulated load frame is included."""

import fringedic_ros  # noqa: F401  (first: it sets the threads of linear algebra before NumPy is loaded)
