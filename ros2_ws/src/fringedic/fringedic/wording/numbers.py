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


def uncertain_text(value: float, sigma: float) -> str:
    """Return a value with its standard uncertainty, rounded to two digits of it; without it as `number_text`.

    Examples
    --------
    >>> uncertain_text(3105.27, 41.3), uncertain_text(0.61234, 0.0042), uncertain_text(2.5, float("nan"))
    ('3105 ± 41', '0.6123 ± 0.0042', '2.5')
    """
    if not (math.isfinite(value) and math.isfinite(sigma) and sigma > 0):
        return number_text(value)
    digits = max(1 - math.floor(math.log10(sigma)), 0)
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"
