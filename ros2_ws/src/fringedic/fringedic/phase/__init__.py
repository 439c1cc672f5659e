"""From fringe frames to the phase: demodulation, fringe orders, one image, response, exposures, faults of a stack."""

from fringedic.phase.blur import correct_lens_blur
from fringedic.phase.exposures import merge_exposures
from fringedic.phase.faults import check_stack
from fringedic.phase.measure import measure_phase
from fringedic.phase.noise import CameraNoise, estimate_noise
from fringedic.phase.one_image import one_image_phase
from fringedic.phase.order import assign_orders, unwrap_hierarchical, unwrap_spatial
from fringedic.phase.steps import absolute_phase, demodulate

__all__ = [
    "CameraNoise",
    "absolute_phase",
    "assign_orders",
    "check_stack",
    "correct_lens_blur",
    "demodulate",
    "estimate_noise",
    "measure_phase",
    "merge_exposures",
    "one_image_phase",
    "unwrap_hierarchical",
    "unwrap_spatial",
]
