"""What is known to be wrong with a programme before its test: its text, its moves, the disk."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import yaml

from fringedic.configuration.crosshead_motion import crosshead_motion
from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import RigFile
from fringedic.configuration.yaml_section import validate
from fringedic.errors import ConfigurationError, PatternError
from fringedic.settings.experiment import MOVING_ONE_WAY
from fringedic.settings.load_frame import DescribedLoadFrame
from fringedic.wording.yaml_text import load_yaml

_MOST_IN_STACK = 0.5  # of the height of the image, by which a point may move during a stack
_ROUNDING = 1e-9  # relative; positions of a ramp are computed


class MachineRange(NamedTuple):
    """Positions [mm] and speeds [mm/s] that may be requested of a machine."""

    lowest_mm: float
    highest_mm: float
    fastest_mm_per_s: float


def parse_programme(text: str) -> Programme:
    """Return the programme in a text.

    Parameters
    ----------
    text
        YAML, as in a programme file.

    Raises
    ------
    ConfigurationError
        It is no YAML, or a key is unknown, missing or out of its range; the message is one sentence.

    Examples
    --------
    >>> parse_programme("{ramp: {to_mm: 1.0, steps: 3}}").count()
    3
    """
    try:
        content = load_yaml(text)
    except yaml.YAMLError as error:
        raise ConfigurationError(f"programme: is not YAML: {error}") from error
    if not isinstance(content, dict):
        raise ConfigurationError("programme: has no 'key: value'; write for example ramp: {to_mm: 1.0, steps: 11}")
    return validate(Programme, content, "programme")


def machine_range(rig: RigFile) -> MachineRange | None:
    """Return the range of the machine of a rig; None where only the machine itself knows it.

    Examples
    --------
    >>> rig = RigFile.model_validate({"camera": {"source": "virtual"}, "virtual_rig": {"preset": "plate"},
    ...                               "load_frame": {"source": "simulated"}})
    >>> machine_range(rig)
    MachineRange(lowest_mm=0.0, highest_mm=1.0, fastest_mm_per_s=5.0)
    """
    machine = rig.load_frame
    if isinstance(machine, DescribedLoadFrame):
        return _described_range(Path(machine.file))
    if machine is not None and machine.source == "simulated" and rig.virtual_rig is not None:
        simulated = rig.virtual_configuration().load_frame
        return MachineRange(0.0, simulated.maximum_position_mm, simulated.maximum_speed_mm_per_s)
    return None


def _described_range(file: Path) -> MachineRange | None:
    """Return the limits in a machine file; its node checks and reports everything else."""
    try:
        limits = load_yaml(file.read_text("utf-8"))["limits"]
        return MachineRange(*(float(limits[name]) for name in MachineRange._fields))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError):
        return None


def check_programme(rig: RigFile, programme: Programme) -> None:
    """Refuse a programme with moves that the machine of a rig cannot make.

    Parameters
    ----------
    rig, programme
        The rig, and the load steps.

    Raises
    ------
    ConfigurationError
        The rig moves no machine, so that all steps would be measured at the same load; a position or a speed is
        outside the range of the machine; or the rig cannot measure while it moves at this speed.
    """
    allowed, steps = machine_range(rig), programme.load_steps()
    if any(step.mode == "moving" for step in steps):
        _check_moving(rig, programme)
    for number, step in enumerate(steps, start=1):
        if step.position_mm is None:
            continue
        where = f"step {number} of {len(steps)} of {programme.experiment}"
        if not rig.has_load_frame_node:
            raise ConfigurationError(
                f"{where} moves the crosshead to {step.position_mm:g} mm, but this rig moves no machine; remove the "
                "positions from the programme, or describe the machine in a machine file (load_frame: {source: "
                "machine, file: ...})"
            )
        if allowed is None:
            continue
        room = _ROUNDING * max(abs(allowed.lowest_mm), abs(allowed.highest_mm))
        if not allowed.lowest_mm - room <= step.position_mm <= allowed.highest_mm + room:
            raise ConfigurationError(
                f"{where} moves the crosshead to {step.position_mm:g} mm, outside {allowed.lowest_mm:g} to "
                f"{allowed.highest_mm:g} mm of the machine; change the position"
            )
        if step.speed_mm_per_s > allowed.fastest_mm_per_s * (1 + _ROUNDING):
            raise ConfigurationError(
                f"{where} moves at {step.speed_mm_per_s:g} mm/s, faster than {allowed.fastest_mm_per_s:g} mm/s of the "
                "machine; reduce speed_mm_per_s"
            )


def _check_moving(rig: RigFile, programme: Programme) -> None:
    if rig.projector_size() is None:
        raise ConfigurationError(
            f"{programme.experiment} measures in motion, which needs the fringes of a projector; add a projector to "
            "the rig, or use steps with mode: white"
        )
    try:
        rig.moving_patterns()
    except PatternError as error:
        raise ConfigurationError(f"{programme.experiment}: {error}") from error
    for step in programme.load_steps():
        if step.mode == "moving":
            _check_speed(rig, step.speed_mm_per_s, programme.experiment)


def _check_speed(rig: RigFile, speed_mm_per_s: float, name: str) -> None:
    """Refuse a speed that the stacks of a rig with a known calibration cannot follow."""
    motion = crosshead_motion(rig, 1e-3 * speed_mm_per_s)
    if motion is None:
        return
    followed, cure = rig.sequence.fastest_motion, ""
    if motion.in_stack > _MOST_IN_STACK:
        raise ConfigurationError(
            f"{name} measures at {speed_mm_per_s:g} mm/s, where a point moves by {motion.pixels:.3g} px from frame to "
            f"frame, {100 * motion.in_stack:.0f} % of the image during a stack; reduce speed_mm_per_s to "
            f"{_lower(speed_mm_per_s * _MOST_IN_STACK / motion.in_stack)}"
        )
    if motion.fringes > followed:
        if motion.fringes <= MOVING_ONE_WAY:
            cure = f", set sequence.motion_fringes to [0, {MOVING_ONE_WAY}] or [-{MOVING_ONE_WAY}, 0] by the direction"
        raise ConfigurationError(
            f"{name} measures at {speed_mm_per_s:g} mm/s, where a point moves by {motion.pixels:.3g} px, "
            f"{motion.fringes:.2f} fringes, from frame to frame, and the shifts follow {followed:.2f}; reduce "
            f"speed_mm_per_s to {_lower(speed_mm_per_s * followed / motion.fringes)}{cure}, use a coarser finest "
            "pitch, or expose for a shorter time"
        )


def _lower(value: float) -> str:
    """Return a value rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / unit) * unit:.2g}"
