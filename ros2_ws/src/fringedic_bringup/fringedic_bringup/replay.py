"""A recording through fresh processing nodes, in a ROS domain of its own, into a new recording."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fringedic.errors import NodeDiedError, RecordingError
from fringedic_bringup.graph import replay_graph
from fringedic_bringup.processes import RunningGraph, private_domain
from fringedic_bringup.report import Progress

_LOOK_EVERY_S = 0.1


def replay(
    bag: Path,
    output: Path,
    progress: Progress,
    *,
    overrides: Mapping[str, Mapping[str, Any]] | None = None,
    steps: Sequence[int] = (),
    reference: int | None = None,
    calibration: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> Path:
    """Process a recording again by the nodes and return the new recording.

    With the recorded parameters the derived topics come out bit-identical, whatever the number of threads.

    Parameters
    ----------
    bag
        Recording with raw topics.
    output
        New folder: ``bag`` with the recording and ``logs`` of the nodes.
    overrides
        Parameters that replace the recorded ones, ``{"dic": {"window": 24}}``.
    steps
        Only these steps and their references; all when empty.
    reference
        A step that all others are measured against, earlier ones too; by default as recorded.
    calibration
        File that replaces the recorded calibration of the rig.
    environment
        Further environment variables of the nodes, such as NUMBA_NUM_THREADS.

    Raises
    ------
    MissingTopicError
        The recording lacks frames, exposures or steps.
    RecordingError
        The output holds a recording already.
    NodeDiedError
        A node ended, or the player says that nodes did not answer; the message holds the end of its log.
    """
    target = output / "bag"
    if target.exists():
        raise RecordingError(f"{target} exists already; choose another --output")
    graph = replay_graph(bag, target, overrides or {}, steps=steps, reference=reference, calibration=calibration)
    with (
        private_domain() as domain,
        RunningGraph(graph, output / "logs", domain=domain, environment=environment) as running,
    ):
        running.expect_end("player")
        progress.stage(f"replaying {bag}")
        said = 0
        while running.exit_code("player") is None:
            running.check()
            said = _tell(running.log("player"), said, progress)
            time.sleep(_LOOK_EVERY_S)
        running.check()
        _tell(running.log("player"), said, progress)
    if not target.exists():
        raise NodeDiedError(f"the recorder wrote nothing; see {running.log('recorder')}")
    return target


def _tell(log: Path, said: int, progress: Progress) -> int:
    """Pass on what the player has written since; return the number of its lines."""
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    for line in lines[said:]:
        progress.note(line.split("]: ", 1)[-1])
    return len(lines)
