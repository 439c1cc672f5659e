"""A frame of a rig in white light, in which a region of interest is drawn."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fringedic.configuration.rig_file import load_rig_file
from fringedic.frames.records import Frame
from fringedic.patterns.pattern import WHITE
from fringedic_bringup.launch.graph import exposing_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.exposing import ExposingClient

SETTLING_S = 1.0  # longer than the delay of any projector


def frame_of_rig(rig_path: Path, *, sensor: str | None = None, domain: int | None = None) -> Frame:
    """Return a frame of a rig in white light.

    Parameters
    ----------
    rig_path
        The rig file.
    sensor
        Name of the sensor, if the file has several.
    domain
        ROS_DOMAIN_ID of the rig's nodes; None takes the one of the environment.

    Raises
    ------
    ConfigurationError, NodeDiedError, WaitTimeoutError, StepFailedError
        The rig file is not valid, or the camera of the rig takes no frame.
    """
    rig = load_rig_file(rig_path, sensor=sensor)
    graph = exposing_graph(rig)
    with (
        tempfile.TemporaryDirectory(prefix="fringedic-region-") as folder,
        RunningGraph(graph, Path(folder), domain=domain) as running,
        ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        if rig.projector is not None:
            client.show(WHITE)
            client.sleep(SETTLING_S)
        return client.expose()
