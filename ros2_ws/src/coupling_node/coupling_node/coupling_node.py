"""Couples phase and in-plane displacement into point clouds of the shape and of the 3D displacement."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import xarray as xr
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from coupling_node.arrow_markers import ArrowMarkers
from fringedic.patterns.pattern import PHASE_KINDS, Orientation, PatternKind
from fringedic.rig.compatibility import RigSetup, check_calibration
from fringedic.rig.model import RigModel
from fringedic.steps.parameters import CouplingParameters
from fringedic.steps.rehearsal import rehearse_coupling
from fringedic.steps.remarks import HEIGHTS_RELATIVE, Correction, Remark
from fringedic.steps.shape_tracker import ShapeTracker, StepSurface
from fringedic.steps.step_results import CouplingResult, DicResult, PhaseResult, displacement_field
from fringedic_msgs.msg import Exposure, NodeStatus, RigCalibration
from fringedic_ros.clouds import cloud_message
from fringedic_ros.exchange import Exchange
from fringedic_ros.images import image_array
from fringedic_ros.main import run
from fringedic_ros.processing import Outcome, ProcessingNode, StampJoin, StepId
from fringedic_ros.qos import DERIVED, EVENTS, IMAGES, LATCHED
from fringedic_ros.rig_node import RIG_FRAME, frame_id
from fringedic_ros.stamps import to_nanoseconds

# variable of a `PhaseResult` -> topic of the phase node
PHASE_MAPS = {"phase": "map", "sigma": "sigma", "texture": "texture"}
MAPS = (*(f"phase/{topic}" for topic in PHASE_MAPS.values()), "dic/displacement", "dic/sigma")
INPUTS = (*MAPS, "dic/camera_info", "camera/exposure", "phase/status", "dic/status")  # joined by the step's stamp
# inputs of the surface of a step
SURFACE = ("phase/map", "phase/sigma", "phase/texture", "camera/exposure", "phase/status")
# the same from nodes in this process: "phase" and "dic" are their results
WHOLE_INPUTS = ("phase", "dic", "phase/status", "dic/status")
WHOLE_SURFACE = ("phase", "phase/status")


class CouplingNode(ProcessingNode[CouplingParameters]):
    """Joins the messages, or the whole results, with a step's stamp and passes them to a `ShapeTracker`.

    The surface is made as soon as the phase has arrived, while the dic node still measures.
    """

    def __init__(self, exchange: Exchange | None = None) -> None:
        super().__init__("coupling", CouplingParameters, rehearse_coupling, exchange)
        self._shape = self.create_publisher(PointCloud2, "coupling/shape", DERIVED)
        self._displacement = self.create_publisher(PointCloud2, "coupling/displacement", DERIVED)
        self._strain = self.create_publisher(PointCloud2, "coupling/strain", DERIVED)
        self._arrows = ArrowMarkers(self)
        self._frame = frame_id(self, RIG_FRAME)
        self._tracker = ShapeTracker(self.parameters.value)
        self._parts = StampJoin(INPUTS if exchange is None else WHOLE_INPUTS)
        self._surface_inputs = SURFACE if exchange is None else WHOLE_SURFACE
        self._begun = 0  # stamp of the latest surface in the queue
        self._surface: tuple[int, StepSurface | None] = (0, None)  # latest surface, made in the worker's thread
        self.create_subscription(RigCalibration, "calibration", self._take_calibration, LATCHED)
        self.subscribe_to_steps()
        self.create_subscription(Exposure, "camera/exposure", self._take_exposure, IMAGES)
        for name in ("phase", "dic"):
            self.create_subscription(NodeStatus, f"{name}/status", partial(self._take_status, name), EVENTS)
        if exchange is None:
            for topic in MAPS:
                self.create_subscription(Image, topic, partial(self._join, topic), DERIVED)
            self.create_subscription(CameraInfo, "dic/camera_info", partial(self._join, "dic/camera_info"), DERIVED)
        else:
            for name in ("phase", "dic"):
                exchange.take(self, name, partial(self._join_result, name))

    def _take_calibration(self, message: RigCalibration) -> None:
        try:
            rig = RigModel.from_message(message)
            check_calibration(rig, RigSetup(sensor=self.sensor))
        except Exception as error:
            self.get_logger().error(f"calibration '{message.identifier}' refused: {error}")
            self.diagnostics.failure(str(error))
            self.worker.submit(self._tracker.refuse_calibration, str(error))
            return
        # through the queue, so that it does not apply to steps that arrived before it
        self.worker.submit(self._tracker.set_calibration, rig)

    def _take_exposure(self, message: Exposure) -> None:
        if message.index != message.count - 1:
            return
        if message.kind in PHASE_KINDS:  # the last exposure has the step's stamp and the finest pitch
            if self.exchange is None:
                self._join("camera/exposure", message)
        elif message.kind == PatternKind.WHITE:
            self.skip(StepId.of(message))

    def _take_status(self, name: str, message: NodeStatus) -> None:
        if message.error_code != NodeStatus.NONE:
            self._parts.discard(to_nanoseconds(message.header.stamp))
            self.refuse_input(name, message)
        elif not self.answered(message.experiment, message.step):
            self._join(f"{name}/status", message)

    def abandon(self, step: StepId) -> str:
        """Drop the messages of a step."""
        return self._parts.discard(step.stamp)

    def _join(self, topic: str, message: Any) -> None:
        self._add(topic, to_nanoseconds(message.header.stamp), message)

    def _join_result(self, name: str, result: PhaseResult | DicResult) -> None:
        step = StepId(result.experiment, result.step, result.stamp)
        if not self.answered(step.experiment, step.step):
            self._add(name, step.stamp, result)

    def _add(self, topic: str, stamp: int, part: Any) -> None:
        parts = self._parts.add(topic, stamp, part)
        self.report_unjoined(self._parts.unjoined)
        if parts is not None:
            status: NodeStatus = parts["phase/status"]
            self.measure(StepId.of(status), partial(self._couple, parts, self.parameters.value))
        elif stamp != self._begun and (begun := self._parts.waiting(stamp, self._surface_inputs)):
            self._begun = stamp
            self.worker.submit(self._make_surface, stamp, begun, self.parameters.value)

    def _make_surface(self, stamp: int, parts: dict[str, Any], parameters: CouplingParameters) -> None:
        self._tracker.parameters = parameters
        self._surface = (stamp, self._tracker.surface(_phase_result(parts)))

    def _couple(self, parts: dict[str, Any], parameters: CouplingParameters) -> Outcome:
        phase, displacement = _phase_result(parts), _dic_result(parts)
        (made, surface), self._surface = self._surface, (0, None)
        self._tracker.parameters = parameters
        result = self._tracker.step(phase, displacement, surface=surface if made == phase.stamp else None)
        # displacement first: clients wait for it; the shape, at every pixel, is larger
        self._publish_cloud(self._displacement, lambda: result.displacement, result.stamp)
        self._publish_cloud(self._shape, lambda: result.shape, result.stamp)
        self._publish_cloud(self._strain, result.strain, result.stamp)
        self._arrows.publish(result, self._frame)
        return Outcome(
            result.valid_fraction,
            parts["phase/status"].frames,
            rms_displacement=result.rms,
            remarks=tuple(_remarks(result, phase.relative)),
            relative=phase.relative,
            reference_step=result.reference_step,
            correlated_step=displacement.correlated_step,
        )

    def _publish_cloud(self, publisher: Publisher, make: Callable[[], xr.Dataset | None], stamp_ns: int) -> None:
        if publisher.get_subscription_count() and (fields := make()) is not None:
            images = {str(name): array.values for name, array in fields.items()}
            publisher.publish(cloud_message(images, stamp_ns=stamp_ns, frame_id=self._frame))


def _phase_result(parts: dict[str, Any]) -> PhaseResult:
    """Return the phase of a step, as a whole or from the messages that carry its stamp."""
    if "phase" in parts:
        whole: PhaseResult = parts["phase"]
        return whole
    status: NodeStatus = parts["phase/status"]
    exposure: Exposure = parts["camera/exposure"]
    maps = {name: (("row", "column"), image_array(parts[f"phase/{topic}"])) for name, topic in PHASE_MAPS.items()}
    return PhaseResult(
        experiment=status.experiment,
        step=status.step,
        stamp=to_nanoseconds(status.header.stamp),
        maps=xr.Dataset(maps),
        pitch=exposure.pitch,
        orientation=Orientation(exposure.orientation),
        valid_fraction=status.valid_fraction,
        rms=status.phase_sigma,
        relative=status.relative,
        corrections=tuple(map(Correction.of_message, status.corrections)),
    )


def _dic_result(parts: dict[str, Any]) -> DicResult:
    """Return the in-plane displacement of a step, as a whole or from the messages that carry its stamp."""
    if "dic" in parts:
        whole: DicResult = parts["dic"]
        return whole
    status: NodeStatus = parts["dic/status"]
    grid: CameraInfo = parts["dic/camera_info"]
    return DicResult(
        experiment=status.experiment,
        step=status.step,
        stamp=to_nanoseconds(status.header.stamp),
        reference_step=status.reference_step,
        correlated_step=status.correlated_step,
        field=displacement_field(
            image_array(parts["dic/displacement"]),
            image_array(parts["dic/sigma"]),
            origin=(grid.roi.x_offset, grid.roi.y_offset),
            spacing=grid.binning_x,
            window=status.window,
            method=status.method,
        ),
        valid_fraction=status.valid_fraction,
        rms=status.rms_displacement_px,
    )


def _remarks(result: CouplingResult, relative: bool) -> Iterator[Remark]:
    if relative:
        yield Remark(HEIGHTS_RELATIVE)
    if result.drift is not None and (result.drift.moved or result.drift.lost):
        yield Remark.of_marker(result.drift)


def main() -> int:
    """Run the coupling node."""
    return run(CouplingNode)
