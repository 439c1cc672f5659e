"""Counts the exposure records of a recording whose image is missing."""

from __future__ import annotations


class ExposureTally:
    """Pairs images and exposure records by exactly equal stamps and counts the records without image.

    The image of a record counts as missing when a newer image has arrived, because one publisher over reliable
    transport keeps the order, or when the step has ended. If it arrives later, the count decreases again.
    """

    def __init__(self) -> None:
        self._images: set[int] = set()
        self._waiting: set[int] = set()
        self._missing: set[int] = set()
        self._newest_image = -1

    @property
    def missing(self) -> int:
        """Exposure records without an image."""
        return len(self._missing)

    def add_image(self, stamp: int) -> None:
        """Count one image, stamp in ns."""
        if stamp in self._waiting | self._missing:
            self._waiting.discard(stamp)
            self._missing.discard(stamp)
        else:
            self._images.add(stamp)
        self._newest_image = max(self._newest_image, stamp)
        overtaken = {waiting for waiting in self._waiting if waiting < stamp}
        self._waiting -= overtaken
        self._missing |= overtaken

    def add_exposure(self, stamp: int) -> None:
        """Count one exposure record, stamp in ns."""
        if stamp in self._images:
            self._images.discard(stamp)
        elif stamp < self._newest_image:
            self._missing.add(stamp)
        else:
            self._waiting.add(stamp)

    def end_step(self) -> None:
        """Count all images as missing that have not arrived: the step has ended."""
        self._missing |= self._waiting
        self._waiting.clear()
