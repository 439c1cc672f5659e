"""Groups the frames of a step by their exposure time."""

from __future__ import annotations

from collections.abc import Sequence

# Relative difference up to which exposure times count as equal. Cameras round a requested time to whole lines and
# report the rounded one; exposures that are bracketed on purpose differ by a factor of 2 or more.
EQUAL_EXPOSURES = 0.01


def exposure_groups(exposure_times: Sequence[float]) -> dict[float, list[int]]:
    """Return the frames of each exposure time.

    Parameters
    ----------
    exposure_times
        Exposure time of each frame, in any one unit.

    Returns
    -------
    dict
        Exposure time of the first frame of each group -> indices of its frames, in the order of the frames.

    Examples
    --------
    >>> exposure_groups([0.01, 0.04, 0.010001, 0.04])
    {0.01: [0, 2], 0.04: [1, 3]}
    """
    groups: dict[float, list[int]] = {}
    for index, time in enumerate(exposure_times):
        alike = (known for known in groups if abs(time - known) <= EQUAL_EXPOSURES * known)
        groups.setdefault(next(alike, time), []).append(index)
    return groups
