"""From fringe frames to the phase: demodulation, fringe orders, one image, response, exposures, faults of a stack."""

from fringedic.phase.noise import CameraNoise, estimate_noise
from fringedic.phase.order import assign_orders, unwrap_hierarchical, unwrap_spatial
from fringedic.phase.steps import absolute_phase, demodulate

__all__ = [
    "CameraNoise",
    "absolute_phase",
    "assign_orders",
    "demodulate",
    "estimate_noise",
    "unwrap_hierarchical",
    "unwrap_spatial",
]
