"""Test programmes: moves, holds and measurements in their order, repeated, and ended by conditions.

The number of steps has an upper bound that is known before the test; how often a move is measured depends on the rig,
see `fringedic.configuration.forecast`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from fringedic.configuration.conditions import MetCondition, Reading, Until
from fringedic.configuration.yaml_section import Section
from fringedic.metadata import SpecimenMetadata

MILLI = 1e-3
FARTHEST_MM = 1e5  # larger than every machine; a number beyond it is a typing error
FASTEST_MM_PER_S = 1e5
MOST_STEPS = 100_000  # a test of 14 days at 12 s per step; a larger number is a typing error


class BlockEnd(NamedTuple):
    """A block that a condition ended; `fringedic.configuration.sentences.block_end_sentence` composes the sentence."""

    block: Literal["ramp", "cycle"]
    condition: MetCondition


def _of_a_block(until: Until) -> Until:
    if until.time_above_s is not None:
        raise ValueError("time_above_s ends a move; put it into the until of a step or of continuous")
    return until


BlockUntil = Annotated[Until, AfterValidator(_of_a_block)]
"""Conditions that are compared after each step of a ramp or a cycle."""


class ProgrammeStep(Section):
    """One load step: move, hold, measure."""

    position_mm: float | None = Field(
        None,
        ge=-FARTHEST_MM,
        le=FARTHEST_MM,
        description="Crosshead position to move to [mm]; without it the machine stays.",
    )
    speed_mm_per_s: float = Field(1.0, gt=0, le=FASTEST_MM_PER_S, description="Speed of the crosshead [mm/s].")
    until: Until | None = Field(None, description="Ends the move before its position; the machine then holds.")
    hold_s: float = Field(0.0, ge=0, le=86400, description="Time between move and measurement [s].")
    mode: Literal["fringes", "white", "none", "moving"] = Field(
        "fringes",
        description="white: one frame, in-plane displacement only; none: nothing is measured; moving: stack after "
        "stack is measured during the move, without a hold.",
    )
    set_reference: bool = Field(False, description="This step becomes the reference of the following ones.")
    every_s: float = Field(
        0.0,
        ge=0,
        le=86400,
        description="With mode: moving, from the begin of a stack to that of the next [s]; 0: as fast as possible.",
    )

    @model_validator(mode="after")
    def _can_be_done(self) -> ProgrammeStep:
        if self.until is not None and self.position_mm is None:
            raise ValueError("until ends a move; give position_mm, the farthest position of the move")
        if self.until is not None and self.until.valid_fraction_below is not None:
            raise ValueError("a move cannot end by valid_fraction_below; put it into the until of a ramp or cycle")
        if self.set_reference and self.mode == "none":
            raise ValueError("a step that is not measured (mode: none) cannot be the reference")
        if self.mode == "moving" and (self.position_mm is None or self.hold_s or self.set_reference):
            raise ValueError(
                "mode: moving measures during a move; give position_mm, no hold_s, and set the reference in a step "
                "before it"
            )
        if self.every_s and self.mode != "moving":
            raise ValueError("every_s is the time from stack to stack with mode: moving; remove it")
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

    from_mm: float = Field(0.0, ge=-FARTHEST_MM, le=FARTHEST_MM, description="First crosshead position [mm].")
    to_mm: float = Field(ge=-FARTHEST_MM, le=FARTHEST_MM, description="Last crosshead position [mm].")
    steps: int = Field(ge=2, le=10000, description="Number of steps.")
    repeats_at_rest: int = Field(
        0, ge=0, le=1000, description="Additional measurements at the first position, for the noise floor."
    )
    speed_mm_per_s: float = Field(1.0, gt=0, le=FASTEST_MM_PER_S, description="Speed of the crosshead [mm/s].")
    hold_s: float = Field(0.0, ge=0, le=86400, description="Time between each move and its measurement [s].")
    mode: Literal["fringes", "white"] = Field("fringes", description="white: one frame, in-plane displacement only.")
    until: BlockUntil | None = Field(None, description="Ends the ramp after the step that meets it.")

    @property
    def times(self) -> int:
        """Number of repetitions: a ramp is done once."""
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


class Continuous(Section):
    """A step at rest, and then a move during which stack after stack is measured without a hold.

    Examples
    --------
    >>> pull = Continuous(to_mm=0.6, speed_mm_per_s=0.02, until=Until(force_above_n=500))
    >>> [(step.position_mm, step.mode) for step in pull.entries()]
    [(0.0, 'fringes'), (0.6, 'moving')]
    """

    from_mm: float = Field(
        0.0,
        ge=-FARTHEST_MM,
        le=FARTHEST_MM,
        description="Crosshead position of the step at rest, which is measured first [mm].",
    )
    to_mm: float = Field(
        ge=-FARTHEST_MM, le=FARTHEST_MM, description="Farthest crosshead position, where the move ends [mm]."
    )
    speed_mm_per_s: float = Field(gt=0, le=FASTEST_MM_PER_S, description="Speed of the crosshead meanwhile [mm/s].")
    until: Until | None = Field(None, description="Ends the move before its position; the machine then holds.")
    every_s: float = Field(
        0.0,
        ge=0,
        le=86400,
        description="From the begin of a stack to that of the next [s]; 0: as fast as possible.",
    )

    @model_validator(mode="after")
    def _can_be_done(self) -> Continuous:
        if self.from_mm == self.to_mm:
            raise ValueError("from_mm and to_mm are equal, so that nothing moves; give another to_mm")
        self.entries()
        return self

    def entries(self) -> list[ProgrammeStep]:
        """Return the step at rest and the one that moves; the way to `from_mm` has the same speed."""
        return [
            ProgrammeStep(position_mm=self.from_mm, speed_mm_per_s=self.speed_mm_per_s),
            ProgrammeStep(
                position_mm=self.to_mm,
                speed_mm_per_s=self.speed_mm_per_s,
                until=self.until,
                mode="moving",
                every_s=self.every_s,
            ),
        ]


class Cycle(Section):
    """Steps that are repeated."""

    times: int = Field(ge=1, le=MOST_STEPS, description="Largest number of repetitions.")
    steps: list[Entry] = Field(min_length=1, description="Steps, ramps and cycles of each repetition.")
    until: BlockUntil | None = Field(None, description="Ends the cycle after the step that meets it.")

    def entries(self) -> list[ProgrammeStep | Ramp | Cycle]:
        """Return the steps, ramps and cycles of each repetition."""
        return _plain(self.steps)

    def count(self) -> int:
        """Return the largest number of steps."""
        return self.times * _count(self.entries())


class RampEntry(Section):
    """A ramp among steps."""

    ramp: Ramp = Field(description="Equal steps.")


class ContinuousEntry(Section):
    """A measured move among steps."""

    continuous: Continuous = Field(description="A move during which stack after stack is measured.")


class CycleEntry(Section):
    """A cycle among steps."""

    cycle: Cycle = Field(description="Steps that are repeated.")


def _kind(entry: Any) -> str:
    for kind, section in (("cycle", CycleEntry), ("ramp", RampEntry), ("continuous", ContinuousEntry)):
        if isinstance(entry, section) or (isinstance(entry, dict) and kind in entry):
            return f"a {kind}"
    return "a step"


Entry = Annotated[
    Annotated[ProgrammeStep, Tag("a step")]
    | Annotated[RampEntry, Tag("a ramp")]
    | Annotated[ContinuousEntry, Tag("a continuous")]
    | Annotated[CycleEntry, Tag("a cycle")],
    Discriminator(_kind),
]
Cycle.model_rebuild()
CycleEntry.model_rebuild()


class Programme(Section):
    """The load steps of one experiment, written out, as a ramp, or as a move that is measured while it lasts.

    Examples
    --------
    >>> programme = Programme.model_validate({"experiment": "plate", "ramp": {"to_mm": 1.0, "steps": 3}})
    >>> [step.position_mm for step in programme.load_steps()]
    [0.0, 0.5, 1.0]
    """

    experiment: str = Field("experiment", pattern=r"^[A-Za-z0-9_\-]+$", description="Name of the experiment.")
    specimen: SpecimenMetadata | None = Field(
        None, description="Metadata of the specimen, instead of those of the rig file."
    )
    steps: list[Entry] | None = Field(
        None, min_length=1, description="Steps, ramps, moves that are measured (continuous) and cycles in their order."
    )
    ramp: Ramp | None = Field(None, description="Equal steps, instead of the key steps.")
    continuous: Continuous | None = Field(
        None, description="A move at constant speed that is measured while it lasts, instead of the key steps."
    )
    on_operator_lost: Literal["continue", "hold"] = Field(
        "continue",
        description="With `fringedic operate`, when the page of the driver is closed: continue, or pause after the "
        "present step with the machine on hold.",
    )

    @model_validator(mode="after")
    def _can_be_done(self) -> Programme:
        if sum(each is not None for each in (self.steps, self.ramp, self.continuous)) != 1:
            raise ValueError("give either steps, ramp or continuous")
        if self.count() > MOST_STEPS:
            raise ValueError(f"the programme has {self.count()} steps, at most {MOST_STEPS} are allowed")
        return self

    def entries(self) -> list[ProgrammeStep | Ramp | Cycle]:
        """Return steps, ramps and cycles in their order."""
        if self.continuous is not None:
            return list(self.continuous.entries())
        return [self.ramp] if self.ramp is not None else _plain(self.steps or ())

    def count(self) -> int:
        """Return the largest number of steps."""
        return _count(self.entries())

    def conditions(self) -> list[Until]:
        """Return all conditions of moves, ramps and cycles."""
        return _conditions(self.entries())

    def load_steps(self) -> list[ProgrammeStep]:
        """Return all steps one by one, as without conditions."""
        return list(self.walk())

    def walk(self, on_end: Callable[[BlockEnd], None] | None = None) -> Generator[ProgrammeStep, Reading | None, None]:
        """Yield step after step; the reading that is sent back decides which one follows.

        Parameters
        ----------
        on_end
            Called when a condition ends a ramp or a cycle.

        Yields
        ------
        ProgrammeStep
            The next step. Send the reading after it, or None without a reading: then no condition is evaluated.
        """
        yield from _walk(self.entries(), (), on_end)


def _walk(
    entries: Sequence[ProgrammeStep | Ramp | Cycle],
    blocks: tuple[Ramp | Cycle, ...],
    on_end: Callable[[BlockEnd], None] | None,
) -> Generator[ProgrammeStep, Reading | None, int | None]:
    """Yield the steps of entries inside these blocks; return the number of the block that has to end, None for none."""
    for entry in entries:
        if isinstance(entry, ProgrammeStep):
            reading = yield entry
            ended = None if reading is None else _ended_block(blocks, reading, on_end)
            if ended is not None:
                return ended
            continue
        for _ in range(entry.times):
            ended = yield from _walk(entry.entries(), (*blocks, entry), on_end)
            if ended is not None and ended < len(blocks):
                return ended
            if ended is not None:
                break
    return None


def _ended_block(
    blocks: tuple[Ramp | Cycle, ...], reading: Reading, on_end: Callable[[BlockEnd], None] | None
) -> int | None:
    """Return the number of the outermost block whose condition is met."""
    for number, block in enumerate(blocks):
        condition = None if block.until is None else block.until.met(reading)
        if condition is not None:
            if on_end is not None:
                on_end(BlockEnd("ramp" if isinstance(block, Ramp) else "cycle", condition))
            return number
    return None


def _plain(
    entries: Sequence[ProgrammeStep | RampEntry | ContinuousEntry | CycleEntry],
) -> list[ProgrammeStep | Ramp | Cycle]:
    plain: list[ProgrammeStep | Ramp | Cycle] = []
    for entry in entries:
        if isinstance(entry, RampEntry):
            plain.append(entry.ramp)
        elif isinstance(entry, CycleEntry):
            plain.append(entry.cycle)
        elif isinstance(entry, ContinuousEntry):
            plain.extend(entry.continuous.entries())
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
