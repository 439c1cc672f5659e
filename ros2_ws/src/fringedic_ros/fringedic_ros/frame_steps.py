"""Collects camera frames of one kind into whole steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fringedic.errors import ErrorCode, StepError
from fringedic.frames.collector import FrameCollector, Stack
from fringedic.frames.records import StepKey, frame_record
from fringedic.patterns.pattern import PHASE_KINDS, PatternKind
from fringedic_msgs.msg import Exposure
from fringedic_ros.images import image_array
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.processing import JOINED_STEPS, ProcessingNode, StepId
from fringedic_ros.serialized import image_view
from fringedic_ros.stamps import to_nanoseconds


class FrameSteps:
    """Subscribes to the camera and passes on the stack of every complete step; a faulty frame ends its step.

    Parameters
    ----------
    node
        Publishes the status of steps that fail.
    kind
        Kind of the frames; FRINGES includes the Gray code and grey light that belong to them. Other frames are ignored.
    on_stack
        Called with each complete step.
    on_other
        Called with the record of each frame of another kind.
    """

    def __init__(
        self,
        node: ProcessingNode[Any],
        kind: PatternKind,
        on_stack: Callable[[Stack], None],
        on_other: Callable[[Exposure], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._kinds = PHASE_KINDS if kind == PatternKind.FRINGES else {kind}
        self._on_stack = on_stack
        self._on_other = on_other
        self._collector = FrameCollector()
        self._pairs = ImageExposurePairs(node, self._take)

    @property
    def unpaired(self) -> int:
        """Images and records that were dropped without a partner."""
        return self._pairs.unpaired

    def abandon(self, experiment: str, step: int) -> str:
        """Drop the frames of a step, and return which are missing; empty when none had arrived."""
        missing = self._collector.abandon(StepKey(experiment, step, self._node.sensor))
        return str(missing) if missing else ""

    def _take(self, image: bytes, exposure: Exposure) -> None:
        if exposure.kind not in self._kinds:
            self._on_other(exposure)
            return
        if self._node.answered(exposure.experiment, exposure.step):
            self._node.diagnostics.drop()
            return
        try:
            record = frame_record(exposure)
            if record.sensor != self._node.sensor:
                raise StepError(
                    f"frame {record.index} is of the sensor '{record.sensor}', this node is of '{self._node.sensor}': "
                    "start both in the namespace of their sensor, and with its parameter sensor",
                    code=ErrorCode.FRAME_MISMATCH,
                )
            stack = self._collector.add(record, image_array(image_view(image)))
        except Exception as error:
            self.abandon(exposure.experiment, exposure.step)
            self._node.fail(StepId.of(exposure), error)
            return
        if stack is not None:
            self._on_stack(stack)
        for key in self._collector.open_steps[:-JOINED_STEPS]:
            missing = self._collector.abandon(key)
            if missing is not None:
                self._node.fail(StepId(key.experiment, key.step, to_nanoseconds(exposure.header.stamp)), missing)
