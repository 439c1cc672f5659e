"""Grabs frames and publishes the images with their exposure records."""

import fringedic_ros  # noqa: F401  (first: it sets the threads of linear algebra before NumPy is loaded)
