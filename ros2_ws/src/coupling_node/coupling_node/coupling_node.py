"""Phase, in-plane displacement and calibration in, clouds of the shape and of the 3D displacement out."""

from __future__ import annotations

from functools import partial
from typing import Any

from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from coupling_node.camera_transform import CameraTransform
from fringedic.chain import CouplingParameters, DicParameters, ShapeTracker, StepSurface
from fringedic.rig import RigModel
from fringedic.sequence import Orientation, PatternKind
from fringedic_msgs.msg import Exposure, NodeParameters, NodeStatus, Reference, RigCalibration
from fringedic_ros.clouds import cloud_message
from fringedic_ros.images import image_array
from fringedic_ros.main import run
from fringedic_ros.processing import Outcome, ProcessingNode, StampJoin
from fringedic_ros.qos import DERIVED, EVENTS, IMAGES, LATCHED, LATCHED_BY_MANY, OVERRIDABLE
from fringedic_ros.stamps import to_nanoseconds

FRAME = "reference_plane"
MAPS = ("phase/map", "phase/sigma", "dic/displacement", "dic/sigma")
SURFACE = ("phase/map", "phase/sigma", "camera/exposure", "phase/status")  # what the surface of a step is made from


class CouplingNode(ProcessingNode[CouplingParameters]):
    """Joins everything that carries a step's stamp and hands it to a `ShapeTracker`.

    The surface is made as soon as the phase is there, while the dic node still measures.
    """

    def __init__(self) -> None:
        super().__init__("coupling", CouplingParameters)
        self._shape = self.create_publisher(PointCloud2, "coupling/shape", DERIVED)
        self._displacement = self.create_publisher(PointCloud2, "coupling/displacement", DERIVED)
        self._transform = CameraTransform(self)
        self._tracker = ShapeTracker(self.parameters.value)
        self._parts = StampJoin((*MAPS, "dic/camera_info", "camera/exposure", "phase/status", "dic/status"))
        self._window: tuple[int | None, str] = (None, DicParameters().method)
        self._begun = 0  # stamp of the surface asked for last
        self._surface: tuple[int, StepSurface | None] = (0, None)  # made last, in the worker's thread
        self.create_subscription(NodeParameters, "node_parameters", self._take_parameters, LATCHED_BY_MANY)
        self.create_subscription(RigCalibration, "calibration", self._take_calibration, LATCHED)
        self.create_subscription(Reference, "experiment/reference", self._take_reference, LATCHED)
        self.subscribe_to_steps()
        self.create_subscription(Exposure, "camera/exposure", self._take_exposure, IMAGES)
        for name in ("phase", "dic"):
            self.create_subscription(NodeStatus, f"{name}/status", partial(self._take_status, name), EVENTS)
        for topic in MAPS:
            self.create_subscription(
                Image, topic, partial(self._join, topic), DERIVED, qos_overriding_options=OVERRIDABLE
            )
        self.create_subscription(CameraInfo, "dic/camera_info", partial(self._join, "dic/camera_info"), DERIVED)

    def _take_parameters(self, message: NodeParameters) -> None:
        if message.node == "dic":
            values = {each.name: parameter_value_to_python(each.value) for each in message.parameters}
            self.worker.submit(self._set_window, values.get("window"), values.get("method", DicParameters().method))

    def _set_window(self, window: int | None, method: str) -> None:
        self._window = (window, method)

    def _take_calibration(self, message: RigCalibration) -> None:
        try:
            rig = RigModel.from_message(message)
        except Exception as error:
            self.get_logger().error(f"calibration '{message.identifier}' refused: {error}")
            self.diagnostics.failure(str(error))
            return
        self._transform.publish(rig, message.header.stamp)
        # through the queue, so that steps which arrived before it are measured without it
        self.worker.submit(self._tracker.set_calibration, rig)

    def _take_reference(self, message: Reference) -> None:
        self.worker.submit(self._tracker.set_reference, message.experiment, message.step)

    def _take_exposure(self, message: Exposure) -> None:
        if message.index != message.count - 1:
            return
        if message.kind == PatternKind.FRINGES:  # the last one has the step's stamp and the finest pitch
            self._join("camera/exposure", message)
        elif message.kind == PatternKind.WHITE:
            stamp = to_nanoseconds(message.header.stamp)
            self.answer(message.experiment, message.step, stamp, NodeStatus.NONE)

    def _take_status(self, name: str, message: NodeStatus) -> None:
        if message.error_code != NodeStatus.NONE:
            self._parts.discard(to_nanoseconds(message.header.stamp))
            self.refuse_input(name, message)
        elif not self.answered(message.experiment, message.step):
            self._join(f"{name}/status", message)

    def abandon(self, experiment: str, step: int, stamp: int) -> str:
        """Forget what has arrived of a step."""
        return self._parts.discard(stamp)

    def _join(self, topic: str, message: Any) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        parts = self._parts.add(topic, stamp, message)
        self.report_unjoined(self._parts.unjoined)
        if parts is not None:
            status: NodeStatus = parts["phase/status"]
            self.measure(
                status.experiment,
                status.step,
                stamp,
                partial(self._couple, status, stamp, parts, self.parameters.value),
            )
        elif stamp != self._begun and (begun := self._parts.waiting(stamp, SURFACE)):
            self._begun = stamp
            self.worker.submit(self._make_surface, stamp, begun, self.parameters.value)

    def _make_surface(self, stamp: int, parts: dict[str, Any], parameters: CouplingParameters) -> None:
        exposure: Exposure = parts["camera/exposure"]
        self._tracker.parameters = parameters
        phase, sigma = (image_array(parts[topic]) for topic in SURFACE[:2])
        orientation, relative = Orientation(exposure.orientation), parts["phase/status"].relative
        self._surface = (
            stamp,
            self._tracker.surface(phase, sigma, pitch=exposure.pitch, orientation=orientation, relative=relative),
        )

    def _couple(self, status: NodeStatus, stamp: int, parts: dict[str, Any], parameters: CouplingParameters) -> Outcome:
        grid: CameraInfo = parts["dic/camera_info"]
        exposure: Exposure = parts["camera/exposure"]
        (made, surface), self._surface = self._surface, (0, None)
        self._tracker.parameters = parameters
        result = self._tracker.step(
            status.experiment,
            status.step,
            stamp,
            *(image_array(parts[topic]) for topic in MAPS),
            pitch=exposure.pitch,
            orientation=Orientation(exposure.orientation),
            relative=status.relative,
            spacing=grid.binning_x,
            origin=(grid.roi.y_offset, grid.roi.x_offset),
            window=self._window[0],
            method=self._window[1],
            surface=surface if made == stamp else None,
        )
        # the displacement is what is waited for; the shape, at every pixel, is larger
        for publisher, fields in ((self._displacement, result.displacement), (self._shape, result.shape)):
            if publisher.get_subscription_count():
                publisher.publish(cloud_message(fields, stamp_ns=stamp, frame_id=FRAME))
        remarks = [f"heights may be off by whole fringes: {status.error_message}"] if status.relative else []
        if result.watched is not None and result.watched.words:
            remarks.append(result.watched.words)
        return Outcome(result.valid_fraction, result.rms, status.frames, "; ".join(remarks), status.relative)


def main() -> int:
    """Run the coupling node."""
    return run(CouplingNode)
