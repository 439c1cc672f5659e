"""Counts the exposures of a recording whose image never came."""

from __future__ import annotations


class ExposureTally:
    """Pairs images and exposure records by exactly equal stamps and counts the records that stay alone.

    A record counts as missing its image as soon as a newer image has come, because one publisher over reliable
    transport keeps the order, or when its step has ended. An image that comes after all is taken off the count.
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
        """Give up the images that have not come: nothing more of this step is expected."""
        self._missing |= self._waiting
        self._waiting.clear()
