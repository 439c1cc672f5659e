"""What a machine's description allows to be asked for."""

from __future__ import annotations

import math

from fringedic.errors import CrossheadRangeError, MachineError
from load_frame_node.machines.description import MachineDescription


def check_move(description: MachineDescription, position: float, speed: float) -> None:
    """Refuse a move to `position` [m] at `speed` [m/s] that the description does not allow.

    The machine's own limits are in charge; these only keep a slip of the keyboard from reaching it.

    Raises
    ------
    CrossheadRangeError
        Outside the description's limits, or not a number.
    MachineError
        The description does not say how to move.
    """
    limits = description.limits
    if description.move is None or limits is None:
        raise MachineError(f"{description.name}: its description has no move; move it at the machine")
    if not (math.isfinite(position) and limits.lowest_mm <= 1e3 * position <= limits.highest_mm):
        raise CrossheadRangeError(
            f"crosshead position {1e3 * position:g} mm is outside {limits.lowest_mm:g} to {limits.highest_mm:g} mm"
        )
    if not (math.isfinite(speed) and 0 < 1e3 * speed <= limits.fastest_mm_per_s):
        raise CrossheadRangeError(
            f"crosshead speed {1e3 * speed:g} mm/s is outside 0 to {limits.fastest_mm_per_s:g} mm/s"
        )
