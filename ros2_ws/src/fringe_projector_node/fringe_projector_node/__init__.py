"""Shows patterns on the projector and publishes them."""

import fringedic_ros  # noqa: F401  (first: it sets the threads of linear algebra before NumPy is loaded)
