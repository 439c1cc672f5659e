"""How numbers are written in sentences."""

from __future__ import annotations

import math
from decimal import Decimal


def number_text(value: float, digits: int = 4, *, sign: bool = False) -> str:
    """Return a number as people write it: rounded, without an exponent; "-" when it is not finite.

    Parameters
    ----------
    value
        Any number.
    digits
        Significant digits; those before the decimal point are all written.
    sign
        Write the plus of a positive number.

    Examples
    --------
    >>> [number_text(value) for value in (3.14159, 123456.0, -0.042, 3.191e-05, 0.0, float("nan"))]
    ['3.142', '123456', '-0.042', '0.00003191', '0', '-']
    >>> number_text(1793.4, 3, sign=True)
    '+1793'
    """
    if not math.isfinite(value):
        return "-"
    rounded = f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"
    text = format(Decimal(rounded), "f")
    return f"+{text}" if sign and value > 0 else text


def grouped(number: int) -> str:
    """Return a number with its digits in groups of three.

    Examples
    --------
    >>> grouped(12345)
    '12 345'
    """
    return f"{number:,}".replace(",", " ")


def counted(number: int, thing: str) -> str:
    """Return a number of things.

    Examples
    --------
    >>> counted(1, "step"), counted(2, "step")
    ('1 step', '2 steps')
    """
    return f"{grouped(number)} {thing}{'s' * (number != 1)}"
