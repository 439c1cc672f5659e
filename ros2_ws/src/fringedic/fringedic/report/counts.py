"""Numbers of things in sentences."""


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
