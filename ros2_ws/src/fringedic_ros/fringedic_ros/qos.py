"""All QoS profiles of the system, by their purpose.

A lost frame ruins a step: all profiles of the measurement are reliable. The depth is the number of messages that a
reader may fall behind.
"""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


IMAGES = _reliable(64)
"""Camera frames and their exposure records: more than twice the longest sequence."""

EVENTS = _reliable(100)
"""Step stages and node statuses: few, small, none may be lost."""

LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""State that is valid until it changes: calibration, reference, pattern on the screen, parameters of a node."""

LATCHED_BY_MANY = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)
"""Latched topics with several messages, such as `node_parameters` of all nodes."""

DERIVED = _reliable(2)
"""Maps and clouds computed from a step: large, published once per step."""

SAMPLES = _reliable(10_000)
"""Samples of the load frame, published and recorded: ten seconds at 1 kHz without loss."""

STATE = _reliable(1000)
"""Samples of the load frame for nodes that act on them, and the strain of the extensometer."""

LATEST = _reliable(1)
"""The newest sample of the load frame only."""

CLOCK = _reliable(10)
"""`/clock` of a replay."""

PREVIEWS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""The newest frame or sample for people who watch: a reader that is slow, or ends, has no effect on the publisher."""

SIGNAL_PREVIEWS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""As `PREVIEWS`, for a topic on which many sensors publish."""

DIAGNOSTICS = _reliable(10)
"""`/diagnostics`."""
