"""Checks of the arguments of public functions, declared in one line each: a wrong one is an error of one sentence."""

from __future__ import annotations

import functools
import inspect
import numbers
import os
import reprlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ParamSpec, TypeVar

from fringedic.errors import FringedicError
from fringedic.wording.causes import cause_of
from fringedic.wording.numbers import number_text

# Returns the value that the function uses; raises ValueError with the end of a sentence: "it has to be ..."
Check = Callable[[Any], Any]
Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
_LARGEST = 1e15  # magnitude of a number: no length, grey level or count is larger, and its square is a float32
_KINDS = {1: "a list", 2: "an image (row, column)", 3: "frames (frame, row, column)"}


def check_arguments(
    error: type[FringedicError], **checks: Check
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Return a decorator that checks arguments before a function uses them.

    Parameters
    ----------
    error
        Is raised for a wrong argument; the message names it.
    checks
        Check of each parameter; defaults are not checked.

    Examples
    --------
    >>> from fringedic.errors import CorrelationError
    >>> @check_arguments(CorrelationError, window=whole(8, 256))
    ... def smooth(window: int = 32) -> int:
    ...     return window
    >>> smooth(window=None)
    Traceback (most recent call last):
    fringedic.errors.CorrelationError: window is None: it has to be a whole number from 8 to 256
    """

    def decorate(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def checked(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
            bound = signature.bind(*args, **kwargs)
            for name in checks.keys() & bound.arguments.keys():
                bound.arguments[name] = check_value(error, name, bound.arguments[name], checks[name])
            return function(*bound.args, **bound.kwargs)

        return checked

    return decorate


def check_value(error: type[FringedicError], name: str, value: Any, check: Check) -> Any:
    """Return a value after its check.

    Parameters
    ----------
    error, name, value, check
        The error for a wrong value, its name in the message, the value, and its check.
    """
    try:
        return check(value)
    except ValueError as reason:
        raise error(f"{name} is {excerpt(value)}: it has to be {reason}") from None


def excerpt(value: Any) -> str:
    """Return a value as it appears in a message: the shape of an array, the beginning of a long text."""
    if hasattr(value, "data_vars"):
        return f"a dataset of {', '.join(map(str, value.data_vars))[:80] or 'nothing'} over {dict(value.sizes)}"
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array of shape {tuple(value.shape)} and type {value.dtype}"
    if isinstance(value, os.PathLike):
        return repr(os.fspath(value))
    return " ".join(reprlib.repr(value).split())


def number(low: float = -_LARGEST, high: float = _LARGEST) -> Check:
    """Return the check of a finite number in a range; both ends are included."""
    words = "a number" if low == -_LARGEST else f"a number from {number_text(low, 6)}"
    if high < _LARGEST:
        words += f" to {number_text(high, 6)}"

    def check(value: Any) -> Any:
        real = _real(value, words)
        if not low <= real <= high:
            raise ValueError(words)
        return real

    return check


def whole(low: int = -(2**31), high: int = 2**31 - 1) -> Check:
    """Return the check of a whole number in a range; both ends are included."""
    words = f"a whole number from {low} to {high}" if low > -(2**31) else "a whole number"

    def check(value: Any) -> int:
        real = _real(value, words)
        if not low <= real <= high or real != int(real):
            raise ValueError(words)
        return int(real)

    return check


def array(dimensions: int, *, infinite: bool = False) -> Check:
    """Return the check of an array of real numbers with so many dimensions, none of them empty; lists become arrays."""
    words = f"{_KINDS[dimensions]} of real numbers, not empty"

    def check(value: Any) -> Any:
        import numpy as np  # not at the top: most checks need none

        try:
            found = value if hasattr(value, "dtype") and hasattr(value, "ndim") else np.asarray(value)
        except ValueError:  # lists of different lengths
            raise ValueError(words) from None
        if found.dtype.kind not in "biuf" or found.ndim != dimensions or 0 in found.shape:
            raise ValueError(words)
        if found.dtype.kind == "f" and not infinite:
            values = np.asarray(found)
            extremes = np.fmin.reduce(values, axis=None), np.fmax.reduce(values, axis=None)  # NaN of NaN alone
            if any(abs(each) > _LARGEST for each in extremes):
                raise ValueError(f"{words}, finite or NaN")
        return found

    return check


def grey_levels(dimensions: int) -> Check:
    """Return the check of an array of grey levels; types but uint8, uint16, float32 and float64 become float32."""
    of_array = array(dimensions, infinite=True)  # a pixel that saturated in every exposure is infinite

    def check(value: Any) -> Any:
        found = of_array(value)
        return found if found.dtype.str[1:] in ("u1", "u2", "f4", "f8") else found.astype("f4")

    return check


def dataset(*names: str, over: Sequence[str] = ("row", "column")) -> Check:
    """Return the check of a dataset with maps of real numbers.

    Parameters
    ----------
    names
        Of the maps; each has the last two dimensions row and column after the check.
    over
        Dimensions of the dataset, of which only ``step`` may be empty.
    """
    words = f"a dataset with {', '.join(names) or 'maps'} over {', '.join(over)}"
    image = [name for name in ("row", "column") if name in over]

    def check(value: Any) -> Any:
        if not hasattr(value, "data_vars") or not set(over) <= set(value.sizes) or not all(map(value.sizes.get, image)):
            raise ValueError(words)
        if "step" in over and "step" not in value.coords:
            raise ValueError(words)
        maps = [value.variables.get(name) for name in names]  # without coordinates, which takes a tenth of the time
        if any(each is None or not set(image) <= set(each.dims) or each.dtype.kind not in "iuf" for each in maps):
            raise ValueError(words)
        ordered = all(each.dims[-2:] == ("row", "column") for each in maps)
        return value if ordered or not image else value.transpose(..., *image)

    return check


def several(check_one: Check, *, least: int = 0, length: int | None = None) -> Check:
    """Return the check of a sequence with a check of each of its members; it becomes a list."""
    count = f"{length} values" if length is not None else f"at least {least} values"

    def check(value: Any) -> list[Any]:
        if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
            raise ValueError(f"a sequence of {count}")
        members = [check_one(each) for each in _members(value)]
        if len(members) < least or (length is not None and len(members) != length):
            raise ValueError(f"a sequence of {count}")
        return members

    return check


def one_of(*names: str) -> Check:
    """Return the check of a name out of some."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise ValueError(f"one of {', '.join(names)}")
        return value

    return check


def optional(check_value_of: Check) -> Check:
    """Return the check of a value that may be None."""
    return lambda value: None if value is None else check_value_of(value)


def of_type(*types: type) -> Check:
    """Return the check of an object of one of these types."""

    def check(value: Any) -> Any:
        if not isinstance(value, types):
            raise ValueError(f"of the type {' or '.join(each.__name__ for each in types)}")
        return value

    return check


def either(first: type, otherwise: Check) -> Check:
    """Return the check of a value that is of a type, or passes another check."""
    return lambda value: value if isinstance(value, first) else otherwise(value)


def path(value: Any) -> Any:
    """Check a path of a file or folder, which need not exist."""
    if not isinstance(value, (str, os.PathLike)):
        raise ValueError("a path")
    try:
        os.lstat(value)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:  # a name that is too long, or contains NUL
        raise ValueError(f"a path of this file system ({cause_of(error)})") from None
    return value


def text(value: Any) -> str:
    """Check a text."""
    if not isinstance(value, str):
        raise ValueError("a text")
    return value


def _real(value: Any, words: str) -> Any:
    """Return a real number that is not NaN."""
    if getattr(value, "ndim", None) == 0:
        value = value.item()
    if not isinstance(value, numbers.Real) or value != value:
        raise ValueError(words)
    return value


def _members(value: Iterable[Any]) -> Sequence[Any]:
    try:
        return list(value)
    except TypeError:  # an array without dimensions
        raise ValueError("a sequence") from None
