"""What a command needs to go on with a run of an earlier one: the same settings, and the steps that were done."""

from __future__ import annotations

import fcntl
import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from fringedic.configuration.programme import Programme, ProgrammeStep
from fringedic.errors import ConfigurationError
from fringedic.recording.definitions import type_hash
from fringedic.recording.manifest import write_whole
from fringedic.recording.reader import BagReader
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.procedures.recording_parts import next_part
from fringedic_msgs.msg import StepStatus

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
        Numbers of the measured steps.
    last
        Number of the last step; -1 without steps.
    done
        How many steps of the programme were done, also those that move only or failed.
    """

    measured: list[int]
    last: int
    done: int


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


def recorded_steps(bag: Path, programme: Programme, namespace: str) -> RecordedSteps:
    """Return the steps of a recording that a programme goes on with.

    Raises
    ------
    ConfigurationError
        The programme has conditions, whose readings are not known any more, the steps that were done are not its
        first ones, no step is left, or the rig had another namespace, so that the recording would contain two rigs.
    """
    if programme.conditions():
        raise ConfigurationError(
            f"{programme.experiment} has conditions (until), which need the readings of all steps: start a new run"
        )
    reader = BagReader(bag)
    topic = reader.find("experiment/step")["experiment/step"]
    if topic.removesuffix("experiment/step").strip("/") != namespace:
        raise ConfigurationError(
            f"{bag.parent}: topics of its first steps are named {topic}, and the namespace of the rig is "
            f"'{namespace}'; undo the change, or start a new run"
        )
    statuses = [message for _, message, _ in reader.messages([topic])]
    measured = sorted({status.step for status in statuses if status.stage == StepStatus.END})
    steps = programme.load_steps()
    done = steps_done(bag.with_name("logs") / STEPS_DONE, measured, steps)
    if done >= len(steps):
        count = sum(step.mode != "none" for step in steps)
        raise ConfigurationError(
            f"{bag.parent}: no step of the programme is left, {len(measured)} of {count} are measured"
        )
    return RecordedSteps(measured, max((status.step for status in statuses), default=-1), done)


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
        if node.name in COMPARED
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
    changes: dict[str, dict[str, Any]] = {
        "recorder": {"bag_path": str(next_part(bag).absolute())},
        "experiment": {"first_step": before.last + 1, "reference_lost": bool(before.measured)},
        "camera": {"truth_folder": ""},
    }
    nodes = (
        replace(node, parameters={**node.parameters, **_known(node, changes.get(node.name, {}))})
        for node in graph.nodes
    )
    return replace(graph, nodes=tuple(nodes))


def _known(node: NodeEntry, changes: dict[str, Any]) -> dict[str, Any]:
    """Return changes without a truth for a camera that writes none."""
    return {name: value for name, value in changes.items() if name != "truth_folder" or name in node.parameters}
