"""Every QoS profile of the system, by what it is for.

A lost frame ruins a step, so all of them are reliable; the depths say how far a reader may fall behind.
"""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


IMAGES = _reliable(64)
"""Camera frames and their exposure records: more than twice the longest sequence."""

EVENTS = _reliable(100)
"""Step stages and node statuses: few, small, none may be lost."""

LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""What holds until it changes: calibration, reference, the pattern on the screen, a node's parameters."""

LATCHED_BY_MANY = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)
"""For reading a latched topic that several nodes write, such as `node_parameters`."""

DERIVED = _reliable(2)
"""Maps and clouds computed from a step: large, published once per step."""

SAMPLES = _reliable(10_000)
"""Samples of the load frame as they are published and recorded: ten seconds at 1 kHz, all of them count."""

STATE = _reliable(1000)
"""For who acts on samples of the load frame, and for the strain of the extensometer."""

LATEST = _reliable(1)
"""For who looks at the newest sample of the load frame alone."""

DIAGNOSTICS = _reliable(10)
"""`/diagnostics`."""

OVERRIDABLE = QoSOverridingOptions.with_default_policies()
"""Pass as `qos_overriding_options` on image topics: history, depth and reliability become parameters."""
