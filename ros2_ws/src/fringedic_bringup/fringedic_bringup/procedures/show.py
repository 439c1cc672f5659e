"""Holds a pattern on the projector while a person adjusts the rig."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError
from fringedic.patterns.pattern import SETUP, WHITE, PatternKind, ProjectedPattern
from fringedic_bringup.launch.graph import projecting_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.exposing import ExposingClient
from fringedic_bringup.setup_patterns import ShownPattern


def hold_pattern(
    rig: RigFile,
    rig_path: Path,
    pattern: ShownPattern,
    wait: Callable[[], object],
    *,
    domain: int | None = None,
) -> None:
    """Show a pattern until a function returns.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    pattern
        The pattern; fringes are the finest of the rig's sequence.
    wait
        Called while the pattern is shown; returns when it may end.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        The rig has no projector.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The projector node did not start, or does not show the pattern.
    """
    if rig.projector is None:
        raise ConfigurationError(f"{rig_path}: has no projector that could show {pattern}")
    graph = projecting_graph(rig)
    with (
        tempfile.TemporaryDirectory(prefix="fringedic-show-") as folder,
        RunningGraph(graph, Path(folder), domain=domain) as running,
        ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        patterns = {
            ShownPattern.WHITE: WHITE,
            ShownPattern.GREY: ProjectedPattern(PatternKind.GREY, shift=1, shifts=2),
            ShownPattern.FRINGES: rig.patterns()[-1],
        }
        client.show(patterns.get(pattern, SETUP), "" if pattern in patterns else pattern)
        wait()
