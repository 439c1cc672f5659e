"""Holds a pattern on the projector while a person adjusts the rig."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from fringedic.errors import RigFileError
from fringedic.rig_file import RigFile
from fringedic.sequence import PatternKind, Projection
from fringedic_bringup.exposing import SETUP, WHITE, ExposingClient
from fringedic_bringup.graph import projecting_graph
from fringedic_bringup.processes import RunningGraph


class ShownPattern(StrEnum):
    """What can be held on the projector."""

    CROSSHAIR = "crosshair"
    GRID = "grid"
    FOCUS = "focus"
    WHITE = "white"
    GREY = "grey"
    DARK = "dark"
    FRINGES = "fringes"


def hold_pattern(
    rig: RigFile,
    rig_path: Path,
    pattern: ShownPattern,
    until: Callable[[], object],
    *,
    domain: int | None = None,
) -> None:
    """Show a pattern until a person has seen enough of it.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    pattern
        What to show; the fringes are the finest of the rig's sequence.
    until
        Returns when it is enough.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    RigFileError
        The rig has no projector.
    NodeDiedError, NotAnsweredError, StepFailedError
        The projector's node did not start, or does not show it.
    """
    if rig.projector is None:
        raise RigFileError(f"{rig_path}: has no projector that could show {pattern}")
    graph = projecting_graph(rig, rig_path)
    with (
        tempfile.TemporaryDirectory(prefix="fringedic-show-") as folder,
        RunningGraph(graph, Path(folder), domain=domain) as running,
        ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        projections = {
            ShownPattern.WHITE: WHITE,
            ShownPattern.GREY: Projection(PatternKind.GREY, shift=1, shifts=2),
            ShownPattern.FRINGES: rig.projections()[-1],
        }
        client.show(projections.get(pattern, SETUP), "" if pattern in projections else pattern)
        until()
