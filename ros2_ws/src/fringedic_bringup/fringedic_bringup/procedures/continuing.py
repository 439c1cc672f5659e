"""What a command needs to go on with a run of an earlier one: the same settings, and the steps that were done."""

from __future__ import annotations

import fcntl
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from fringedic.command.outcome import CALIBRATION_FILE, Progress
from fringedic.configuration.programme import Programme, ProgrammeStep
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError
from fringedic.frames.sensor import file_of
from fringedic.recording.definitions import type_hash
from fringedic.recording.manifest import write_whole
from fringedic.recording.reader import BagReader
from fringedic_bringup.launch.environment import domain_of, node_environment
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.launch.processes import require_no_nodes
from fringedic_bringup.procedures.recording_parts import join_parts, next_part
from fringedic_msgs.msg import StepStatus

CONTINUED = "run continued"
"""Action of the entry in the log of a run that a later command has continued."""
STEPS_DONE = "steps_done"  # file among the logs: steps of the programme that were done
COMPARED = ("experiment", "camera", "projector", "phase", "dic", "coupling")  # nodes whose parameters change results
_LATER = "nodes, region_file or pixel_format, which earlier versions did not record without processing"
OF_ONE_COMMAND = {
    *("truth_folder", "calibration_file", "calibration_folder", "metadata"),
    *("first_step", "reference_step", "reference_lost"),
}


class RecordedSteps(NamedTuple):
    """Steps of the run that a programme goes on with.

    Attributes
    ----------
    measured
        Numbers of the measured steps; of several sensors, of those that one of them has measured.
    last
        Number of the last step; -1 without steps.
    done
        How many steps of the programme were done, also those that move only or failed.
    sensors
        Names of the sensors that have measured a step, and so have a reference; of a rig of one sensor the empty name.
    """

    measured: list[int]
    last: int
    done: int
    sensors: frozenset[str]


@contextmanager
def folder_of_one_command(folder: Path) -> Iterator[None]:
    """Keep other commands out of the folder of a run, until the end of the `with` block or of the process.

    Raises
    ------
    ConfigurationError
        Another command uses the folder.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)  # nodes do not inherit it
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigurationError(f"{folder} is in use by another command; wait until it has ended") from None
        yield
    finally:
        os.close(descriptor)
        if is_new:
            with suppress(OSError):  # only a folder that is empty, because nothing was started, is removed
                folder.rmdir()


def require_recording(folder: Path, *, is_there: bool) -> None:
    """Check that the folder of a run contains a recording to go on with, or none.

    Raises
    ------
    ConfigurationError
        The message names the other choice.
    """
    if (folder / "bag").exists() != is_there:
        raise ConfigurationError(
            f"{folder} contains no recording to continue; give the folder of the run as --output"
            if is_there
            else f"{folder} contains a recording already; choose another --output, or go on with it by --continue"
        )


def calibrations_in(folder: Path, rigs: Iterable[RigFile]) -> dict[Path, str]:
    """Return the calibration files in the folder of a run with their contents, before `rig_graph` replaces them."""
    files = (file_of(folder / CALIBRATION_FILE, rig.sensor) for rig in rigs)
    return {file: file.read_text() for file in files if file.exists()}


def go_on(
    graph: Graph,
    folder: Path,
    programme: Programme,
    rigs: Sequence[RigFile],
    calibrations: Mapping[Path, str],
    progress: Progress,
    *,
    domain: int | None,
) -> tuple[Graph, RecordedSteps]:
    """Return the nodes that go on with a run, and the steps that were done.

    Parameters
    ----------
    graph
        The nodes as for a new run.
    folder, programme
        Folder of the run, and its programme.
    rigs
        The rig file for each sensor of the graph.
    calibrations
        From `calibrations_in`.
    progress
        Receives how many steps are measured already.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        Nodes of the rig still run; or messages, settings, calibration, sensors or programme do not continue the run.
    RecordingError
        The recording cannot be read.
    """
    bag = folder / "bag"
    for file, before in calibrations.items():
        require_same_calibration(file, before)
    # a recorder may still be writing what it has received
    require_no_nodes(domain_of(node_environment(domain)), graph)
    require_same_messages(bag)
    join_parts(bag, progress, rigs[0].recording.split)  # of a command that was killed before it joined them
    done = recorded_steps(bag, programme, {rig.sensor if graph.sensors else "": rig.topic_namespace for rig in rigs})
    require_same_settings(graph, folder / "logs")
    progress.note(f"{programme.experiment}: {len(done.measured)} steps are measured already")
    return continued(graph, bag, done), done


def require_same_messages(bag: Path) -> None:
    """Check that the messages of the first steps are those of today: the parts of the recording will be joined.

    Raises
    ------
    ConfigurationError
        The definition of a type has changed.
    RecordingError
        A type is not installed.
    """
    for topic in BagReader(bag).topics.values():
        if topic.hash and topic.hash != type_hash(topic.type_name):
            raise ConfigurationError(
                f"{bag.parent}: its first steps were recorded by a version of fringedic with other messages "
                f"({topic.type_name}); start a new run"
            )


def recorded_steps(bag: Path, programme: Programme, namespaces: Mapping[str, str]) -> RecordedSteps:
    """Return the steps of a recording that a programme goes on with.

    Parameters
    ----------
    bag, programme
        Recording and programme of the run.
    namespaces
        Of several sensors, the namespace of each by its name; of a rig of one sensor by the empty name.

    Raises
    ------
    ConfigurationError
        The programme has conditions, whose readings are not known any more, the steps that were done are not its
        first ones, no step is left, or the rig had other sensors or another namespace, so that the recording would
        contain two rigs.
    """
    if programme.conditions():
        raise ConfigurationError(
            f"{programme.experiment} has conditions (until), which need the readings of all steps: start a new run"
        )
    statuses = _statuses(bag, namespaces)
    measured = {name: {each.step for each in of if each.stage == StepStatus.END} for name, of in statuses.items()}
    of_any = sorted(set[int]().union(*measured.values()))
    steps = programme.load_steps()
    done = steps_done(bag.with_name("logs") / STEPS_DONE, of_any, steps)
    if done >= len(steps):
        count = sum(step.mode != "none" for step in steps)
        raise ConfigurationError(
            f"{bag.parent}: no step of the programme is left, {len(of_any)} of {count} are measured"
        )
    last = max((each.step for of in statuses.values() for each in of), default=-1)
    return RecordedSteps(of_any, last, done, frozenset(name for name, of in measured.items() if of))


def _statuses(bag: Path, namespaces: Mapping[str, str]) -> dict[str, list[StepStatus]]:
    """Return the states of the steps of each sensor that has exposed a frame, see `recorded_steps`."""
    readers = {"": BagReader(bag)}
    if "" not in namespaces:
        recorded = readers[""].sensors.keys()
        if recorded - namespaces.keys():
            raise ConfigurationError(
                f"{bag.parent}: its first steps were measured by the sensors {', '.join(sorted(recorded))}, and the "
                f"rig has {', '.join(namespaces)}; undo the change, or start a new run"
            )
        readers = {name: BagReader(bag, sensor=name) for name in namespaces if name in recorded}
    statuses = {}
    for name, reader in readers.items():
        topic = reader.find("experiment/step")["experiment/step"]
        if topic.removesuffix("experiment/step").strip("/") != namespaces[name]:
            raise ConfigurationError(
                f"{bag.parent}: topics of its first steps are named {topic}, and the namespace of the rig is "
                f"'{namespaces[name]}'; undo the change, or start a new run"
            )
        statuses[name] = [message for _, message, _ in reader.messages([topic])]
    return statuses


def save_steps_done(file: Path, steps: Sequence[ProgrammeStep]) -> None:
    """Save the steps of a programme that were done, for `steps_done`."""
    write_whole(file, f"{len(steps)} {_checksum(steps)}")


def steps_done(file: Path, measured: Sequence[int], steps: Sequence[ProgrammeStep]) -> int:
    """Return how many steps of a programme were done; of a run of an earlier version, as if no step had failed.

    Raises
    ------
    ConfigurationError
        Other steps were done than the first ones of the programme.
    """
    try:
        number, checksum, *_ = file.read_text().split()
        done = int(number)
    except (OSError, ValueError):
        ends = [number for number, step in enumerate(steps, 1) if step.mode != "none"]
        return ([0, *ends])[min(len(measured), len(ends))]
    if _checksum(steps[:done]) != checksum:
        raise ConfigurationError(
            f"{file.parent.parent}: the first {done} steps of the programme are not those that were done; "
            "undo the change of the programme, or start a new run"
        )
    return done


def _checksum(steps: Iterable[ProgrammeStep]) -> str:
    return f"{zlib.crc32(''.join(step.model_dump_json() for step in steps).encode()):08x}"


def require_same_settings(graph: Graph, logs: Path) -> None:
    """Check that nodes get the parameters of the earlier command, so that all steps are measured alike.

    Parameters
    ----------
    graph
        The nodes of a rig.
    logs
        Folder with the parameter files of the nodes of the earlier command.

    Raises
    ------
    ConfigurationError
        The message names the parameters that differ, or a parameter file that is damaged.
    """
    changed = [
        _LATER if name == "later_parameters" else f"{node.name}.{name}"
        for node in graph.nodes
        if node.own_name in COMPARED
        for name in sorted(node.changed_parameters(logs) - OF_ONE_COMMAND)
    ]
    if changed:
        raise ConfigurationError(
            f"{logs.parent}: the settings are not those of its first steps ({', '.join(changed)}); undo the change, or "
            "start a new run"
        )


def require_same_calibration(file: Path, before: str) -> None:
    """Check that the calibration file of a run is that of an earlier command, which is restored when it is not.

    Raises
    ------
    ConfigurationError
        Another calibration was written.
    """
    if before and file.read_text() != before:
        write_whole(file, before)
        raise ConfigurationError(
            f"{file.parent}: the calibration of the rig is not that of its first steps, {file.name}; go on with that "
            "one, or start a new run"
        )


def continued(graph: Graph, bag: Path, before: RecordedSteps) -> Graph:
    """Return a graph that records the next part, with the next numbers of steps; the truth ends with the first part."""
    return replace(graph, nodes=tuple(_continued(node, bag, before) for node in graph.nodes))


def _continued(node: NodeEntry, bag: Path, before: RecordedSteps) -> NodeEntry:
    changes: dict[str, Any] = {}
    if node.name == "recorder":
        changes = {"bag_path": str(next_part(bag).absolute())}
    elif node.own_name == "experiment":
        changes = {"first_step": before.last + 1, "reference_lost": node.sensor in before.sensors}
    elif node.own_name == "camera" and "truth_folder" in node.parameters:
        changes = {"truth_folder": ""}
    return replace(node, parameters={**node.parameters, **changes})
