"""The image in which a region of interest is drawn: a file, or what the camera of a rig sees in white light."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from camera_node.drivers.files import read_grey
from fringedic.errors import RegionError
from fringedic.region import Region

RIG_SUFFIXES = (".yaml", ".yml")
SETTLING_S = 1.0  # longer than any projector takes


def image_of(source: Path, *, domain: int | None = None) -> np.ndarray:
    """Return an image file, or a frame of a rig in white light.

    Parameters
    ----------
    source
        Image, or rig file.
    domain
        ROS_DOMAIN_ID of the rig's nodes; None takes the one of the environment.

    Raises
    ------
    CameraError
        The image cannot be read.
    RigFileError, NodeDiedError, NotAnsweredError, StepFailedError
        The rig file is not valid, or the rig gives no frame.
    """
    if source.suffix not in RIG_SUFFIXES:
        return read_grey(source)
    # not at the top: images need no ROS
    from fringedic.rig_file import load_rig_file
    from fringedic_bringup.exposing import WHITE, ExposingClient
    from fringedic_bringup.graph import exposing_graph
    from fringedic_bringup.processes import RunningGraph

    rig = load_rig_file(source)
    graph = exposing_graph(rig, source)
    with (
        tempfile.TemporaryDirectory(prefix="fringedic-region-") as folder,
        RunningGraph(graph, Path(folder), domain=domain) as running,
        ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        if rig.projector is not None:
            client.show(WHITE)
            client.sleep(SETTLING_S)
        return client.expose()[0]


def mask_of(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Return the mask in a file: polygons (YAML), or an image that is bright where the surface is to be measured.

    Raises
    ------
    RegionError
        It belongs to images of another size, or is empty.
    CameraError
        The image cannot be read.
    """
    if path.suffix in RIG_SUFFIXES:
        return Region.load(path).mask_for(shape)
    image = read_grey(path)
    if image.shape != tuple(shape):
        raise RegionError(
            f"{path}: the mask has {image.shape[1]}x{image.shape[0]} px, the images {shape[1]}x{shape[0]} px"
        )
    mask = image > np.iinfo(image.dtype).max // 2 if image.dtype.kind == "u" else image > 0
    if not mask.any():
        raise RegionError(f"{path}: the mask is dark everywhere; it has to be white where the surface is measured")
    return mask
