"""Measures the delay and the refresh of a projector: shows dark and white in turn and takes frames of the changes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fringedic.command.outcome import Progress
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError
from fringedic.figures.timing import timing_figure
from fringedic.patterns.pattern import SETUP
from fringedic.rig_setup.projector_sentences import timing_sentences
from fringedic.rig_setup.timing import ProjectorTiming, measure_timing
from fringedic.rig_setup.timing_session import TimingSession
from fringedic_bringup.launch.graph import exposing_graph, full_scale
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.exposing import ExposingClient

MOST_TRIES = 3  # for each change


@dataclass(frozen=True)
class TimingReport:
    """The measured timing, and the recommended settings.

    Attributes
    ----------
    timing
        The measurement.
    words
        The measurement in sentences.
    settings
        Lines for the rig file.
    """

    timing: ProjectorTiming
    words: list[str]
    settings: str


def measure_rig_timing(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    exposure_time: float,
    longest: float,
    changes: int = 60,
    domain: int | None = None,
) -> TimingReport:
    """Measure the projector of a rig and write ``timing.yaml`` and ``timing.png`` into a folder.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    folder
        Where the files and ``logs`` are written.
    progress
        Receives the progress.
    exposure_time
        Exposure time of the frames [s]: short compared with the refresh, and long enough for a bright image.
    longest
        Longest delay of a pattern [s].
    changes
        Number of changes between dark and white that have to be captured in time; a busy computer misses some.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        The rig has no projector, or its camera reads files.
    RigSetupError
        The camera does not see the projector, or see `fringedic.rig_setup.timing.measure_timing`.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, one of them ended, or a pattern or a frame failed.
    """
    if rig.projector is None or rig.camera.source == "files":
        raise ConfigurationError(f"{rig_path}: timing needs a projector and a camera that sees its light")
    graph = exposing_graph(rig)
    progress.stage(f"starting {len(graph.nodes)} nodes")
    with (
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        session = TimingSession(client, exposure_time, longest, full_scale(rig))
        progress.stage("searching for the projector's light")
        session.find_light()
        session.find_delay()
        captured = 0
        for _ in range(MOST_TRIES * changes):
            progress.part(1, 1, "dark and white in turn", captured + 1, changes)
            captured += session.capture_change()
            if captured == changes:
                break
        client.show(SETUP, "dark")
    samples = session.samples()
    timing = measure_timing(samples)
    timing.save(folder / "timing.yaml", rig.camera.exposure_time)
    timing_figure(samples, timing, rig.camera.exposure_time).savefig(folder / "timing.png")
    settings = (
        f"camera:\n  exposure_ms: {1e3 * timing.whole_exposure(rig.camera.exposure_time):.6g}\n"
        f"  settle_ms: {1e3 * timing.settle_time():.4g}"
    )
    sentences = timing_sentences(timing, rig.camera.exposure_time, rig.camera.settle_time, rig.sequence)
    return TimingReport(timing, sentences, settings)
