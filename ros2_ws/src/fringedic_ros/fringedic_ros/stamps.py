"""Stamps: integer nanoseconds in the library, `builtin_interfaces/Time` in messages."""

from builtin_interfaces.msg import Time

NANOSECONDS_PER_SECOND = 1_000_000_000


def to_msg(nanoseconds: int) -> Time:
    """Return the message of a stamp in nanoseconds since the epoch of the acquisition clock."""
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS_PER_SECOND)
    return Time(sec=seconds, nanosec=rest)


def to_nanoseconds(stamp: Time) -> int:
    """Return the nanoseconds of a stamp message; exact, so that equal stamps stay equal."""
    return int(stamp.sec) * NANOSECONDS_PER_SECOND + int(stamp.nanosec)
