"""Measures the response curve of projector and camera, and the phase error without and with its correction."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fringedic.command.outcome import Progress
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError
from fringedic.figures.response import response_figure
from fringedic.frames.records import Frame, image_stack
from fringedic.patterns.pattern import SETUP, Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.response import ResponseCurve
from fringedic.phase.checks.harmonic_error import SERIES_SHIFTS, HarmonicError, measure_harmonic_error
from fringedic.rig_setup.projector_sentences import response_sentences
from fringedic.rig_setup.response import Correction, assess_correction, measure_response, response_patterns
from fringedic_bringup.launch.graph import Graph, NodeEntry, exposing_graph, full_scale
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.exposing import ExposingClient

FILE = "response.yaml"
PICTURE = "response.png"


@dataclass(frozen=True)
class ResponseReport:
    """The measured response, and the recommended setting.

    Attributes
    ----------
    curve
        Response of projector and camera together.
    before, after
        Harmonic error of the phase of patterns without and with the correction.
    words
        The measurement in sentences.
    setting
        Line for the rig file; empty when the correction does not reduce the error.
    """

    curve: ResponseCurve
    before: HarmonicError
    after: HarmonicError
    words: list[str]
    setting: str


def measure_rig_response(
    rig: RigFile, rig_path: Path, folder: Path, progress: Progress, *, domain: int | None = None
) -> ResponseReport:
    """Measure the response of a rig in front of any surface at rest.

    Uniform greys give the curve. Fringes of the rig's finest pitch, without and with the correction, give the phase
    error. Writes ``response.yaml``, ``response.png`` and ``logs``.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    folder
        Where the files are written.
    progress
        Receives the progress.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        The rig has no projector, or its camera reads files.
    PatternError, PhaseError
        The image is too bright, too dark, or shows no fringes.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, one of them ended, or a pattern or a frame failed.
    """
    if rig.projector is None or rig.camera.source == "files":
        raise ConfigurationError(f"{rig_path}: a response needs a projector and a camera that sees its light")
    greys = response_patterns()
    fringes = _fringes(rig)
    rig_frames = _RigFrames(rig, rig_path, folder / "logs", progress, domain)
    frames = image_stack(rig_frames.take([*greys, *fringes], "without correction"))
    saturation = full_scale(rig) or None
    curve = measure_response(frames[: len(greys)], greys, saturation=saturation)
    before = measure_harmonic_error(frames[len(greys) :], saturation=saturation)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / FILE
    curve.save(file)
    corrected = image_stack(rig_frames.take(fringes, "with correction", curve_file=file))
    after = measure_harmonic_error(corrected, saturation=saturation)
    response_figure(curve, before, after).savefig(folder / PICTURE)
    setting = ""
    if assess_correction(before, after) is Correction.USEFUL:
        setting = f"projector:\n  response_curve: {_relative(file, rig_path)}"
    return ResponseReport(
        curve, before, after, response_sentences(curve, before, after, min(rig.sequence.shifts)), setting
    )


@dataclass(frozen=True)
class _RigFrames:
    """Takes frames of a rig with one response file after the other."""

    rig: RigFile
    rig_path: Path
    logs: Path
    progress: Progress
    domain: int | None

    def take(self, patterns: Sequence[ProjectedPattern], name: str, *, curve_file: Path | None = None) -> list[Frame]:
        """Start the nodes with a curve, or with none, and take one frame of each pattern."""
        graph = self._graph(curve_file)
        self.progress.stage(f"starting {len(graph.nodes)} nodes")
        frames = []
        with (
            RunningGraph(graph, self.logs / name, domain=self.domain) as running,
            ExposingClient(graph.namespace, domain=self.domain, watch=running.check) as client,
        ):
            client.wait_until_ready(graph.names)
            for number, pattern in enumerate(patterns, start=1):
                client.show(pattern)
                frames.append(client.expose())
                self.progress.part(1, 1, name, number, len(patterns))
            client.show(SETUP, "dark")
        return frames

    def _graph(self, curve_file: Path | None) -> Graph:
        assert self.rig.projector is not None, "checked by the caller"
        file = "" if curve_file is None else str(curve_file.absolute())
        projector = self.rig.projector.model_copy(update={"response_curve": file})
        graph = exposing_graph(self.rig.model_copy(update={"projector": projector}))
        return replace(graph, nodes=tuple(map(self._with_settle_time, graph.nodes)))

    def _with_settle_time(self, node: NodeEntry) -> NodeEntry:
        """Return a node; the camera node waits for the settle time of the rig."""
        if node.name != "camera":
            return node
        return replace(node, parameters={**node.parameters, "settle_ms": self.rig.camera.settle_ms})


def _fringes(rig: RigFile) -> list[ProjectedPattern]:
    orientation = Orientation[rig.sequence.orientation.upper()]
    return [
        ProjectedPattern(PatternKind.FRINGES, orientation, rig.pitches()[-1], shift, SERIES_SHIFTS)
        for shift in range(1, SERIES_SHIFTS + 1)
    ]


def _relative(file: Path, rig_path: Path) -> str:
    """Return the path of a file as the rig file names it."""
    return os.path.relpath(file.absolute(), rig_path.absolute().parent)
