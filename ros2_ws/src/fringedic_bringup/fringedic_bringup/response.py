"""Measures the response curve of projector and camera, and how well corrected patterns make up for it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fringedic.errors import RigFileError
from fringedic.phase.waves import WAVE_SHIFTS, PhaseWaves, phase_waves
from fringedic.response import ResponseCurve, measure_response, response_projections
from fringedic.response_picture import response_figure
from fringedic.rig_file import RigFile
from fringedic.sequence import Orientation, PatternKind, Projection
from fringedic_bringup.exposing import SETUP, ExposingClient
from fringedic_bringup.graph import NodeEntry, exposing_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.report import Progress

FILE = "response.yaml"
PICTURE = "response.png"
HARMLESS = 0.0005  # waves [fringe] below which a correction is worth nothing
UNEVEN = 0.02  # scatter of the curve over the image, from which something else changed while it was measured


@dataclass(frozen=True)
class ResponseReport:
    """What was measured, and what to do.

    Attributes
    ----------
    curve
        Of projector and camera together.
    before, after
        Waves on the phase of patterns as they are, and of corrected ones.
    words
        The same in sentences.
    setting
        Line for the rig file; empty when a correction is not worth it.
    """

    curve: ResponseCurve
    before: PhaseWaves
    after: PhaseWaves
    words: list[str]
    setting: str


def measure_rig_response(
    rig: RigFile, rig_path: Path, folder: Path, progress: Progress, *, domain: int | None = None
) -> ResponseReport:
    """Measure the response of a rig in front of any surface that stands still.

    The greys tell the curve; fringes of the rig's finest pitch, shown as they are and corrected, tell what it does to
    the phase. Leaves ``response.yaml``, ``response.png`` and ``logs`` in a folder.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    folder
        Gets the files.
    progress
        Told what goes on.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    RigFileError
        The rig has no projector, or its camera reads files.
    InvalidResponseError, InvalidSequenceError
        The image is too bright, too dark, or shows no fringes.
    NodeDiedError, NotAnsweredError, StepFailedError
        The nodes did not start, one of them ended, or a pattern or a frame failed.
    """
    if rig.projector is None or rig.camera.source == "files":
        raise RigFileError(f"{rig_path}: a response needs a projector and a camera that sees it")
    greys = response_projections()
    orientation = Orientation[rig.sequence.orientation.upper()]
    pitch = rig.pitches()[-1]
    fringes = [
        Projection(PatternKind.FRINGES, orientation, pitch, shift, WAVE_SHIFTS) for shift in range(1, WAVE_SHIFTS + 1)
    ]

    def take(curve_file: Path | None, projections: Sequence[Projection], name: str) -> np.ndarray:
        """Start the nodes with a curve, or none, and take one frame of each pattern."""
        assert rig.projector is not None
        file = None if curve_file is None else str(curve_file.absolute())
        projector = rig.projector.model_copy(update={"response_curve": file})
        graph = exposing_graph(rig.model_copy(update={"projector": projector}), rig_path)
        graph = replace(graph, nodes=tuple(_settling(node, rig) for node in graph.nodes))
        progress.stage(f"starting {len(graph.nodes)} nodes")
        frames = []
        with (
            RunningGraph(graph, folder / "logs" / name, domain=domain) as running,
            ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
        ):
            client.wait_until_ready(graph.names)
            for number, projection in enumerate(projections, start=1):
                client.show(projection)
                frames.append(client.expose()[0])
                progress.step(1, 1, name, number, len(projections))
            client.show(SETUP, "dark")
        return np.array(frames)

    frames = take(None, [*greys, *fringes], "as it is")
    curve = measure_response(frames[: len(greys)], greys)
    before = phase_waves(frames[len(greys) :])
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / FILE
    curve.save(file)
    after = phase_waves(take(file, fringes, "corrected"))
    response_figure(curve, before, after).savefig(folder / PICTURE)
    words = _words(curve, before, after, rig.sequence.shifts)
    worse = after.rms(3) > before.rms(3)
    setting = "" if worse or before.rms(3) < HARMLESS else f"projector:\n  response_curve: {_beside(file, rig_path)}"
    return ResponseReport(curve, before, after, words, setting)


def _settling(node: NodeEntry, rig: RigFile) -> NodeEntry:
    """The camera's node with the rig's own settle time."""
    if node.name != "camera":
        return node
    return replace(node, parameters={**node.parameters, "settle_time_s": rig.camera.settle_time})


def _beside(file: Path, rig_path: Path) -> str:
    """Path of a file as the rig file names it."""
    return os.path.relpath(file.absolute(), rig_path.absolute().parent)


def _words(curve: ResponseCurve, before: PhaseWaves, after: PhaseWaves, shifts: int) -> list[str]:
    words = [
        f"projector and camera together: gamma {curve.gamma:.2f} (1 is a straight line), the same over the image to "
        f"{100 * curve.sigma:.1f} %"
    ]
    if curve.sigma > UNEVEN:
        words.append(
            "that differs too much over the image: did the light or the surface change, or is room light strong? "
            "measure again"
        )
    words += [
        f"waves on the phase with {each} shifts: {before.rms(each):.5f} fringe as it is, {after.rms(each):.5f} fringe "
        "with corrected patterns"
        for each in before.error
    ]
    if before.rms(3) < HARMLESS:
        words.append("the response is straight enough: nothing to correct")
    elif after.rms(3) > before.rms(3):
        words.append("corrected patterns make it worse: the curve is not that of these fringes; measure again")
    elif shifts == 3:
        words.append("three shifts need the correction: without it the waves are on every shape")
    else:
        words.append(
            f"the rig file's {shifts} shifts suffer less than three; the correction costs nothing and helps the coarse "
            "pitches too"
        )
    return words
