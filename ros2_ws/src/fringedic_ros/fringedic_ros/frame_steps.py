"""Camera frames of one kind, collected to whole steps."""

from __future__ import annotations

from collections.abc import Callable

from sensor_msgs.msg import Image

from fringedic.sequence import PHASE_KINDS, FrameCollector, PatternKind, Stack, frame_record
from fringedic_msgs.msg import Exposure
from fringedic_ros.images import image_array
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.processing import JOINED_STEPS, ProcessingNode
from fringedic_ros.stamps import to_nanoseconds


class FrameSteps:
    """Subscribes to the camera and hands on the stack of every complete step; what is wrong with a frame ends its step.

    Parameters
    ----------
    node
        Answers the steps that fail.
    kind
        What the frames have to show, FRINGES with the Gray code and grey light that belong to them; others are passed
        over.
    on_stack
        Called with each complete step.
    on_other
        Called with the record of each frame of another kind.
    """

    def __init__(
        self,
        node: ProcessingNode,
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
        """Images and records that lost their partner."""
        return self._pairs.unpaired

    def abandon(self, experiment: str, step: int) -> str:
        """Forget the frames of a step, and say which have not arrived; empty when none has."""
        missing = self._collector.abandon(experiment, step)
        return str(missing) if missing else ""

    def _take(self, image: Image, exposure: Exposure) -> None:
        experiment, step, stamp = exposure.experiment, exposure.step, to_nanoseconds(exposure.header.stamp)
        if exposure.kind not in self._kinds:
            self._on_other(exposure)
            return
        if self._node.answered(experiment, step):
            self._node.diagnostics.drop()
            return
        try:
            stack = self._collector.add(frame_record(exposure), image_array(image))
        except Exception as error:
            self.abandon(experiment, step)
            self._node.fail(experiment, step, stamp, error)
            return
        if stack is not None:
            self._on_stack(stack)
        for old_experiment, old_step in self._collector.open_steps[:-JOINED_STEPS]:
            missing = self._collector.abandon(old_experiment, old_step)
            if missing is not None:
                self._node.fail(old_experiment, old_step, stamp, missing)
