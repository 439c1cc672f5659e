"""Pairs each image with its exposure record: both carry exactly the same stamp."""

from __future__ import annotations

from collections import OrderedDict
from typing import Generic, TypeVar

ImageT = TypeVar("ImageT")
RecordT = TypeVar("RecordT")


class FramePairs(Generic[ImageT, RecordT]):
    """Pairs images and exposure records of one camera by exactly equal stamps, live or from a recording.

    Both topics arrive in the order of their strictly increasing stamps. When a pair is complete, an older image or
    record that is still alone has therefore lost its partner: it is dropped and counted.

    Parameters
    ----------
    capacity
        Images, and records, that may wait for their partner; the oldest is dropped when another arrives.

    Attributes
    ----------
    unpaired
        Images and records that were dropped without a partner.

    Examples
    --------
    >>> pairs = FramePairs(capacity=64)
    >>> pairs.add_record(20, "record 0")
    >>> pairs.add_image(20, "image 0")
    ('image 0', 'record 0')
    """

    def __init__(self, capacity: int) -> None:
        self.unpaired = 0
        self._capacity = capacity
        self._images: OrderedDict[int, ImageT] = OrderedDict()
        self._records: OrderedDict[int, RecordT] = OrderedDict()

    @property
    def waiting(self) -> int:
        """Images and records that have no partner yet."""
        return len(self._images) + len(self._records)

    def add_image(self, stamp: int, image: ImageT) -> tuple[ImageT, RecordT] | None:
        """Add an image with its stamp [ns]; return the pair when its record is there."""
        self._images[stamp] = image
        return self._pair(stamp)

    def add_record(self, stamp: int, record: RecordT) -> tuple[ImageT, RecordT] | None:
        """Add an exposure record with its stamp [ns]; return the pair when its image is there."""
        self._records[stamp] = record
        return self._pair(stamp)

    def _pair(self, stamp: int) -> tuple[ImageT, RecordT] | None:
        if stamp in self._images and stamp in self._records:
            pair = self._images.pop(stamp), self._records.pop(stamp)
            self._drop_older(self._images, stamp)
            self._drop_older(self._records, stamp)
            return pair
        for waiting in (self._images, self._records):
            while len(waiting) > self._capacity:
                waiting.popitem(last=False)
                self.unpaired += 1
        return None

    def _drop_older(self, waiting: OrderedDict[int, ImageT] | OrderedDict[int, RecordT], stamp: int) -> None:
        for older in [each for each in waiting if each < stamp]:
            del waiting[older]
            self.unpaired += 1
