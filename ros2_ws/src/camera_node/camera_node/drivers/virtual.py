"""Camera of the digital twin."""

from __future__ import annotations

import math

import numpy as np

from camera_node.drivers.driver import Frame, LocalDriver, PlacedPlane, Scene
from fringedic.settings.camera import CameraNodeSettings, VirtualCamera
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, pattern_weights
from fringedic_ros.lifecycle import HardwareNode


class VirtualDriver(LocalDriver):
    """Camera of the digital twin.

    Frames are numbered from 0 on; the number and the seed of the rig determine the noise.

    Parameters
    ----------
    configuration
        The rig.
    """

    needs_scene = True

    def __init__(self, configuration: VirtualRigConfiguration) -> None:
        self.rig = VirtualRig(configuration)
        self._plane: tuple[PlacedPlane, VirtualRig] | None = None
        self._frames = 0
        # the first call compiles or loads the compiled code: not during the first capture
        self.rig.expose(self._dark(), 0.0, 0)

    def expose(self, scene: Scene) -> Frame:
        """Render a scene."""
        white = self.rig.configuration.sensor.exposure_ms
        image = self._rig_with(scene.plane).expose_parts(
            self._parts(scene),
            scene.position,
            self._frames,
            exposure_factor=1.0 if white is None else 1e3 * scene.exposure_time / white,
            travel=scene.travel,
        )
        self._frames += 1
        return Frame(image, scene.stamp_ns, scene.exposure_time)

    def close(self) -> None:
        """Do nothing: no device is open."""

    def _parts(self, scene: Scene) -> list[tuple[np.ndarray, float]]:
        """Return the patterns on the screen during the exposure with their shares of the light."""
        if not scene.patterns:
            return [(self._dark(), 1.0)]
        projector = self.rig.configuration.projector
        if projector.is_immediate:
            return [(scene.patterns[-1].image, 1.0)]
        shown = [pattern.shown_ns for pattern in scene.patterns]
        start = scene.stamp_ns - round(0.5e9 * scene.exposure_time)
        weights = pattern_weights(projector, self.rig.configuration.seed, shown, start, scene.exposure_time)
        return [(pattern.image, float(weight)) for pattern, weight in zip(scene.patterns, weights, strict=True)]

    def _rig_with(self, plane: PlacedPlane | None) -> VirtualRig:
        """Return the rig with the specimen, or with the reference plane, of which the latest place is cached."""
        if plane is None:
            return self.rig
        if self._plane is None or self._plane[0] != plane:
            specimen = {
                "kind": "reference_plane",
                "surface": plane.surface,
                "angle_degree": math.degrees(plane.angle),
                "height_mm": 1e3 * plane.height,
            }
            self._plane = plane, self.rig.with_specimen(specimen)
        return self._plane[1]

    def _dark(self) -> np.ndarray:
        return np.zeros(self.rig.projector_shape, np.uint8)


def open_virtual_camera(_settings: VirtualCamera, node: HardwareNode[CameraNodeSettings]) -> VirtualDriver:
    """Return the camera of the virtual rig of a camera node."""
    return VirtualDriver(VirtualRigConfiguration.from_dict(node.parameters.value.virtual_rig))
