"""Error codes of a step whose processing failed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import NodeStatus

Result = MeasureStep.Result
FAILED_NODE = {
    "phase": Result.PHASE_FAILED,
    "dic": Result.DIC_FAILED,
    "coupling": Result.COUPLING_FAILED,
}
FAILED_STATUS = {NodeStatus.PATTERN_NOT_SEEN: Result.PATTERN_NOT_SEEN}  # of every node; other codes name the node


def failed_node(nodes: Iterable[str], statuses: Mapping[str, NodeStatus]) -> str | None:
    """Return the first of the nodes, in the order of processing, whose status is an error; None without errors."""
    failed = (name for name in nodes if name in statuses and statuses[name].error_code != NodeStatus.NONE)
    return next(failed, None)


def failure_of(node: str, status: NodeStatus) -> tuple[int, str]:
    """Return the error code and message of a step for the status of the node that failed."""
    return FAILED_STATUS.get(status.error_code, FAILED_NODE[node]), f"{node}: {status.error_message}"
