"""Runs a programme of load steps on a rig, and replays recordings: starts the graph, drives it, ends it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fringedic.errors import NotAnsweredError, RecordingError
from fringedic.recording import BagReader
from fringedic.rig_file import Programme
from fringedic_bringup.client import RigClient
from fringedic_bringup.graph import PLAYER, RECORDER, replay_graph, rig_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import RecorderStatus
from fringedic_ros.qos import LATCHED

CLOSING_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class Progress:
    """How far an experiment is.

    Attributes
    ----------
    step, steps
        Present step, from 0, and their number.
    stage
        What is being done: move, capture, process.
    frame, frames
        Frames of the step taken and needed.
    """

    step: int
    steps: int
    stage: str
    frame: int = 0
    frames: int = 0


@dataclass(frozen=True)
class ExperimentRun:
    """What came of an experiment.

    Attributes
    ----------
    bag
        The recording.
    results
        What `measure_step` answered for each step.
    missing_images
        Exposure records whose image was not recorded.
    """

    bag: Path
    results: list[MeasureStep.Result]
    missing_images: int


def run_programme(
    rig_file: Path,
    programme: Programme,
    output: Path,
    *,
    domain: int | None = None,
    environment: Mapping[str, str] | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
) -> ExperimentRun:
    """Start a rig, measure the steps of a programme, and end the rig.

    Parameters
    ----------
    rig_file
        The rig.
    programme
        The load steps.
    output
        Folder for the recording (``bag``) and the nodes' logs (``logs``).
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.
    environment
        Further environment variables of the nodes.
    progress
        Called whenever something has gone on.

    Raises
    ------
    RigFileError
        The rig file cannot be used.
    RecordingError
        There is a recording in the folder already.
    StepFailedError
        A step or a movement failed; everything recorded before stays readable.
    NodeDiedError
        A node ended; the message holds the end of its log.
    """
    bag = output / "bag"
    if bag.exists():
        raise RecordingError(f"{bag}: exists already; choose another output folder, recordings are never overwritten")
    graph = rig_graph(rig_file, output, experiment=programme.experiment)
    steps = programme.load_steps()
    has_load_frame = any(entry.name == "load_frame" for entry in graph.nodes)
    results: list[MeasureStep.Result] = []
    recorder: list[RecorderStatus] = []
    with (
        RunningGraph(graph, output / "logs", domain=domain, environment=environment) as running,
        RigClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.node.create_subscription(RecorderStatus, "recorder/status", recorder.append, LATCHED)
        for number, step in enumerate(steps):
            if step.position is not None and has_load_frame:
                progress(Progress(number, len(steps), "move"))
                client.move(step.position, speed=step.speed)
            time.sleep(step.hold_s)
            results.append(
                client.measure(
                    white=step.mode == "white",
                    set_reference=step.set_reference,
                    feedback=lambda said, number=number: progress(
                        Progress(number, len(steps), said.stage, said.frame, said.frames)
                    ),
                )
            )
        running.stop(entry.name for entry in graph.nodes if entry.name != RECORDER)
        missing = recorder[-1].missing_images if recorder else 0
    return ExperimentRun(bag, results, missing)


def replay(
    bag: Path,
    output: Path,
    *,
    domain: int,
    overrides: Mapping[str, Any] | None = None,
    derived: bool = True,
    environment: Mapping[str, str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> str:
    """Play a recording through fresh processing nodes into a new recording.

    Parameters
    ----------
    bag, output
        The recording to play, and the folder of the new one.
    domain
        ROS_DOMAIN_ID, one that no rig uses.
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24}``.
    derived
        Also record what the processing nodes compute.
    environment
        Further environment variables of the nodes.
    progress
        Called with each line that the player writes.

    Returns
    -------
    str
        The player's summary.

    Raises
    ------
    RecordingError, MissingTopicError
        The recording cannot be played, or the output exists.
    NodeDiedError
        A node ended, or the player gave up; the message holds the end of its log.
    """
    BagReader(bag).find("camera/image_raw", "camera/exposure", "experiment/step")
    if output.exists():
        raise RecordingError(f"{output}: exists already; choose another output, recordings are never overwritten")
    logs = output.parent / f"{output.name}.logs"
    graph = replay_graph(bag, output, overrides=overrides or {}, derived=derived)
    with RunningGraph(graph, logs, domain=domain, environment=environment) as running:
        running.expect_end(PLAYER)
        said = 0
        while True:
            ended = running.exit_code(PLAYER) is not None
            lines = running.log(PLAYER).read_text(errors="replace").splitlines()
            for line in lines[said:]:
                progress(line)
            said = len(lines)
            running.check()
            if ended:
                break
            time.sleep(0.1)
    if not lines:
        raise NotAnsweredError(f"the player ended without a summary; its log is {running.log(PLAYER)}")
    return lines[-1]
