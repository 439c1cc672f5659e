"""Test programmes: moves, holds and measurements in their order, repeated, and ended by what was measured.

Whatever ends a block early, the number of steps is bounded from the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Discriminator, Field, Tag, model_validator

from fringedic.facts import SpecimenFacts
from fringedic.yaml_section import Section

MILLI = 1e-3
MOST_STEPS = 100_000


class Reading(NamedTuple):
    """What conditions look at; NaN is not known.

    Attributes
    ----------
    force
        [N], tension positive.
    strain
        Of the extensometer [-].
    valid_fraction
        Measured part of the surface, 0 to 1.
    """

    force: float = math.nan
    strain: float = math.nan
    valid_fraction: float = math.nan


class Until(Section):
    """Conditions, of which the first that is met ends a move, a ramp or a cycle. What is not known ends it, too."""

    force_above_n: float | None = Field(None, description="The force reaches this from below [N].")
    force_below_n: float | None = Field(None, description="The force falls to this: unloaded, or broken [N].")
    strain_above_percent: float | None = Field(None, description="The extensometer's strain reaches this [%].")
    strain_below_percent: float | None = Field(None, description="The extensometer's strain falls to this [%].")
    valid_fraction_below: float | None = Field(
        None, gt=0, le=1, description="Less of the surface than this is measured, 0 to 1; not for a move."
    )

    @model_validator(mode="after")
    def _asks_for_something(self) -> Until:
        if not self.model_fields_set:
            raise ValueError(f"give one of {', '.join(type(self).model_fields)}")
        return self

    @property
    def needs_strain(self) -> bool:
        """Whether an extensometer has to be there."""
        return self.strain_above_percent is not None or self.strain_below_percent is not None

    def met(self, reading: Reading) -> str:
        """Return in words which condition a reading meets; empty when none."""
        strain = 100 * reading.strain
        for what, value, limit, sign, unit in (
            ("force", reading.force, self.force_above_n, 1, " N"),
            ("force", reading.force, self.force_below_n, -1, " N"),
            ("strain", strain, self.strain_above_percent, 1, " %"),
            ("strain", strain, self.strain_below_percent, -1, " %"),
            ("valid fraction", reading.valid_fraction, self.valid_fraction_below, -1, ""),
        ):
            if limit is None:
                continue
            if math.isnan(value):
                return f"the {what} is not known"
            if sign * value >= sign * limit:
                return f"the {what} of {value:.4g}{unit} {'reached' if sign > 0 else 'fell to'} {limit:g}{unit}"
        return ""


class ProgrammeStep(Section):
    """One load step: move, hold, measure."""

    position_mm: float | None = Field(None, description="Crosshead position to move to; none stays where it is.")
    speed_mm_per_s: float = Field(1.0, gt=0, description="Speed of the crosshead.")
    until: Until | None = Field(None, description="Ends the move before its position; the machine then holds.")
    hold_s: float = Field(0.0, ge=0, le=86400, description="Time to wait after the move before measuring.")
    mode: Literal["fringes", "white", "none"] = Field(
        "fringes", description="white: one frame, in-plane displacement only; none: nothing is measured."
    )
    set_reference: bool = Field(False, description="This step becomes the reference of the following ones.")

    @model_validator(mode="after")
    def _can_be_done(self) -> ProgrammeStep:
        if self.until is not None and self.position_mm is None:
            raise ValueError("until ends a move; give position_mm, the furthest that the move may go")
        if self.until is not None and self.until.valid_fraction_below is not None:
            raise ValueError("a move cannot end by valid_fraction_below; put it into the until of a ramp or cycle")
        if self.set_reference and self.mode == "none":
            raise ValueError("a step that is not measured (mode: none) cannot be the reference")
        return self

    @property
    def position(self) -> float | None:
        """Crosshead position [m]."""
        return None if self.position_mm is None else self.position_mm * MILLI

    @property
    def speed(self) -> float:
        """Speed of the crosshead [m/s]."""
        return self.speed_mm_per_s * MILLI


class Ramp(Section):
    """Equal steps from one crosshead position to another, both included."""

    from_mm: float = Field(0.0, description="First position.")
    to_mm: float = Field(description="Last position.")
    steps: int = Field(ge=2, le=10000, description="Number of steps.")
    repeats_at_rest: int = Field(
        0, ge=0, le=1000, description="How often the first position is measured again, for the noise floor."
    )
    speed_mm_per_s: float = Field(1.0, gt=0, description="Speed of the crosshead.")
    hold_s: float = Field(0.0, ge=0, le=86400, description="Time to wait after each move before measuring.")
    mode: Literal["fringes", "white"] = Field("fringes", description="white: one frame, in-plane displacement only.")
    until: Until | None = Field(None, description="Ends the ramp after the step that meets it.")

    @property
    def times(self) -> int:
        """How often its steps are done."""
        return 1

    def entries(self) -> list[ProgrammeStep]:
        """Return the steps one by one."""
        return [
            ProgrammeStep(
                position_mm=self.from_mm + (self.to_mm - self.from_mm) * max(number, 0) / (self.steps - 1),
                speed_mm_per_s=self.speed_mm_per_s,
                hold_s=self.hold_s,
                mode=self.mode,
            )
            for number in range(-self.repeats_at_rest, self.steps)
        ]

    def count(self) -> int:
        """Return the number of steps."""
        return self.repeats_at_rest + self.steps


class Cycle(Section):
    """Steps that are done several times."""

    times: int = Field(ge=1, le=MOST_STEPS, description="How often, at most.")
    steps: list[Entry] = Field(min_length=1, description="What is done each time.")
    until: Until | None = Field(None, description="Ends the cycle after the step that meets it.")

    def entries(self) -> list[ProgrammeStep | Ramp | Cycle]:
        """Return what is done each time."""
        return _plain(self.steps)

    def count(self) -> int:
        """Return the largest number of steps."""
        return self.times * _count(self.entries())


class RampEntry(Section):
    """A ramp among steps."""

    ramp: Ramp = Field(description="Equal steps.")


class CycleEntry(Section):
    """A cycle among steps."""

    cycle: Cycle = Field(description="Steps that are done several times.")


def _kind(entry: Any) -> str:
    for kind, section in (("cycle", CycleEntry), ("ramp", RampEntry)):
        if isinstance(entry, section) or (isinstance(entry, dict) and kind in entry):
            return f"a {kind}"
    return "a step"


Entry = Annotated[
    Annotated[ProgrammeStep, Tag("a step")]
    | Annotated[RampEntry, Tag("a ramp")]
    | Annotated[CycleEntry, Tag("a cycle")],
    Discriminator(_kind),
]
Cycle.model_rebuild()
CycleEntry.model_rebuild()


class Programme(Section):
    """The load steps of one experiment, written out or as a ramp."""

    experiment: str = Field("experiment", pattern=r"^[A-Za-z0-9_\-]+$", description="Name of the experiment.")
    specimen: SpecimenFacts | None = Field(None, description="Instead of the specimen of the rig file.")
    steps: list[Entry] | None = Field(None, min_length=1, description="The steps one by one, ramps and cycles.")
    ramp: Ramp | None = Field(None, description="Equal steps.")

    @model_validator(mode="after")
    def _can_be_done(self) -> Programme:
        if (self.steps is None) == (self.ramp is None):
            raise ValueError("give either steps or ramp")
        if self.count() > MOST_STEPS:
            raise ValueError(f"these are {self.count()} steps; a programme has {MOST_STEPS} at most")
        return self

    def entries(self) -> list[ProgrammeStep | Ramp | Cycle]:
        """Return what is done, in its order."""
        return [self.ramp] if self.ramp is not None else _plain(self.steps or ())

    def count(self) -> int:
        """Return the largest number of steps."""
        return _count(self.entries())

    def conditions(self) -> list[Until]:
        """Return every condition, whether of a move, a ramp or a cycle."""
        return _conditions(self.entries())

    def load_steps(self) -> list[ProgrammeStep]:
        """Return all steps one by one, as if no condition ended a block."""
        return list(self.walk())

    def walk(self, tell: Callable[[str], None] = lambda words: None) -> Generator[ProgrammeStep, Reading | None, None]:
        """Yield step after step; what is sent back decides which one follows.

        Send the reading that a step gave, None when it gave none: then no condition is looked at. `tell` is called with
        words when a condition ends a ramp or a cycle.
        """
        yield from _walk(self.entries(), (), tell)


def _walk(
    entries: Sequence[ProgrammeStep | Ramp | Cycle],
    blocks: tuple[Ramp | Cycle, ...],
    tell: Callable[[str], None],
) -> Generator[ProgrammeStep, Reading | None, int | None]:
    """Yield the steps of entries inside these blocks; return which of them has to end, None for none."""
    for entry in entries:
        if isinstance(entry, ProgrammeStep):
            reading = yield entry
            for number, block in enumerate(blocks):
                met = block.until.met(reading) if reading is not None and block.until is not None else ""
                if met:
                    tell(f"{type(block).__name__.lower()} ended: {met}")
                    return number
            continue
        for _ in range(entry.times):
            ended = yield from _walk(entry.entries(), (*blocks, entry), tell)
            if ended is not None and ended < len(blocks):
                return ended
            if ended is not None:
                break
    return None


def _plain(entries: Sequence[ProgrammeStep | RampEntry | CycleEntry]) -> list[ProgrammeStep | Ramp | Cycle]:
    plain: list[ProgrammeStep | Ramp | Cycle] = []
    for entry in entries:
        if isinstance(entry, RampEntry):
            plain.append(entry.ramp)
        elif isinstance(entry, CycleEntry):
            plain.append(entry.cycle)
        else:
            plain.append(entry)
    return plain


def _conditions(entries: Sequence[ProgrammeStep | Ramp | Cycle]) -> list[Until]:
    found = [entry.until for entry in entries if entry.until is not None]
    for entry in entries:
        if isinstance(entry, Cycle):
            found += _conditions(entry.entries())
    return found


def _count(entries: Sequence[ProgrammeStep | Ramp | Cycle]) -> int:
    return sum(1 if isinstance(entry, ProgrammeStep) else entry.count() for entry in entries)
