"""The image in which a region of interest is drawn, from a file or from the camera of a rig; masks from files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.files import read_grey
from fringedic.frames.region import Region

RIG_SUFFIXES = (".yaml", ".yml")
SETTLING_S = 1.0  # longer than the delay of any projector


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
    ImageError
        The image cannot be read.
    ConfigurationError, NodeDiedError, WaitTimeoutError, StepFailedError
        The rig file is not valid, or the camera of the rig takes no frame.
    """
    if source.suffix not in RIG_SUFFIXES:
        return read_grey(source)
    # not at the top: images need no ROS
    from fringedic.configuration.rig_file import load_rig_file
    from fringedic_bringup.launch.graph import exposing_graph
    from fringedic_bringup.launch.processes import RunningGraph
    from fringedic_bringup.procedures.exposing import WHITE, ExposingClient

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
    """Return the mask in a file: polygons (YAML), or an image that is white where the surface is measured.

    Parameters
    ----------
    path
        The file.
    shape
        Rows and columns of the images.

    Returns
    -------
    ndarray
        bool, shape (row, column); True where the surface is measured.

    Raises
    ------
    ImageError
        The file cannot be read, the mask belongs to images of another size, or it is empty.
    """
    if path.suffix in RIG_SUFFIXES:
        return Region.load(path).mask_for(shape)
    image = read_grey(path)
    if image.shape != tuple(shape):
        raise ImageError(
            f"{path}: the mask has {image.shape[1]}x{image.shape[0]} px, the images have {shape[1]}x{shape[0]} px"
        )
    mask = image > np.iinfo(image.dtype).max // 2 if image.dtype.kind == "u" else image > 0
    if not mask.any():
        raise ImageError(f"{path}: the mask is black everywhere; make it white where the surface is measured")
    return mask
