"""The reference step of each experiment, and what is kept of the latest steps."""

from __future__ import annotations

from collections import OrderedDict
from typing import TypeVar

from fringedic.errors import ErrorCode, StepError

Kept = TypeVar("Kept")
StepKey = tuple[str, int]  # (experiment, step)


class References:
    """The reference step of each experiment: the one that was set, otherwise the first successful one."""

    def __init__(self) -> None:
        self._chosen: dict[str, int] = {}

    def set(self, experiment: str, step: int) -> None:
        """Set the reference of the following steps."""
        self._chosen[experiment] = step

    def of(self, experiment: str, step: int) -> int:
        """Return the reference of a step: the step itself while the experiment has none."""
        return self._chosen.get(experiment, step)

    def succeeded(self, experiment: str, step: int) -> None:
        """Make a successful step the reference when the experiment has none."""
        self._chosen.setdefault(experiment, step)


class LatestSteps(OrderedDict[StepKey, Kept]):
    """Data of the latest steps; those of the reference step are always kept.

    Those of the reference before it are kept until another step was measured against the new one: a step that was
    measured here and rejected for another reason, such as its hold, is no reference, and the one before is restored.
    """

    def __init__(self) -> None:
        super().__init__()
        self._references: tuple[StepKey, ...] = ()

    def keep(self, key: StepKey, value: Kept, number: int, reference: StepKey) -> None:
        """Keep the data of a step, and drop the oldest when more than `number` steps are kept."""
        self[key] = value
        self.move_to_end(key)
        self._references = (*self._references[-1:], reference) if key == reference else (reference,)
        for oldest in list(self)[: max(len(self) - number, 0)]:
            if oldest not in self._references:
                del self[oldest]


def check_fraction(what: str, fraction: float, minimum: float, key: StepKey) -> None:
    """Raise a `StepError` (TOO_FEW_VALID) when the measured fraction is 0 or below the minimum."""
    if fraction < minimum or fraction == 0:
        experiment, step = key
        raise StepError(
            f"only {fraction:.1%} of the image has {what}, minimum_valid_fraction requires {minimum:.1%}",
            experiment=experiment,
            step=step,
            code=ErrorCode.TOO_FEW_VALID,
        )


def no_reference(key: StepKey, reference: StepKey) -> StepError:
    """Return the error of a step whose reference is not available."""
    experiment, step = key
    return StepError(
        f"its reference, step {reference[1]}, was not measured or is no longer kept; set another reference or raise "
        "kept_steps",
        experiment=experiment,
        step=step,
        code=ErrorCode.NO_REFERENCE,
    )


def size_mismatch(
    what: str, key: StepKey, reference: StepKey, shapes: tuple[tuple[int, ...], tuple[int, ...]]
) -> StepError:
    """Return the error of a step whose image has another size than that of its reference.

    Parameters
    ----------
    what
        The kind of image.
    key, reference
        The step and its reference.
    shapes
        (row, column) of the step's image and of the reference's.
    """
    experiment, step = key
    (rows, columns), (reference_rows, reference_columns) = shapes
    return StepError(
        f"the {what} is {columns}x{rows} px, its reference step {reference[1]} has "
        f"{reference_columns}x{reference_rows} px",
        experiment=experiment,
        step=step,
        code=ErrorCode.FRAME_MISMATCH,
    )
