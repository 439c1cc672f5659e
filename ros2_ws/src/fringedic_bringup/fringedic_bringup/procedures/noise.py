"""Noise floor with the specimen mounted, from steps at rest that the nodes measure."""

from __future__ import annotations

from pathlib import Path

from fringedic.command.outcome import Progress
from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import RigSetupError
from fringedic.figures.noise_floor import noise_figure
from fringedic.rig_setup.camera_noise import FEWEST_STEPS
from fringedic.rig_setup.noise_floor import NoiseMeasurement, noise_of_recording
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.driving import drive
from fringedic_bringup.procedures.recording_parts import join_parts


def measure_noise(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    steps: int,
    domain: int | None = None,
) -> NoiseMeasurement:
    """Measure steps at rest and compute the noise floor from them; the machine does not move.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    folder
        Where the recording ``bag``, its dataset, ``noise_floor.yaml`` and ``noise_floor.png`` are written.
    progress
        Receives the progress.
    steps
        Number of steps, with the reference.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    RigSetupError
        Too few steps were requested or measured.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, or one of them ended.
    KeyboardInterrupt
        Ctrl-C or a signal ended the measurement; the recording is closed.
    """
    if steps < FEWEST_STEPS:
        raise RigSetupError(f"{steps} steps: a noise floor needs at least {FEWEST_STEPS}")
    mode = "white" if rig.projector is None else "fringes"
    programme = Programme.model_validate({"experiment": "noise_floor", "steps": [{"mode": mode}] * steps})
    rig = rig.model_copy(update={"recording": rig.recording.model_copy(update={"derived": True})})
    graph = rig_graph(rig, rig_path, folder, experiment=programme.experiment)
    progress.stage(f"starting {len(graph.nodes)} nodes")
    with RunningGraph(graph, folder / "logs", domain=domain) as running:
        driven = drive(running, programme, progress, domain=domain)
        progress.stage("closing the recording")
    join_parts(folder / "bag", progress, rig.recording.split)
    if driven.interrupted:
        raise KeyboardInterrupt
    if driven.ended_early:
        raise RigSetupError(f"the steps at rest are not complete: {driven.ended_early}; measure the noise again")
    progress.stage("measuring the noise")
    measured = noise_of_recording(folder / "bag")
    measured.save(folder)
    noise_figure(measured).savefig(folder / "noise_floor.png")
    return measured
