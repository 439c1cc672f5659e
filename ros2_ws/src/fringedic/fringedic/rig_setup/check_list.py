"""Check list for setting up a rig: what was done, when, and what has become out of date since."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from fringedic.errors import RigSetupError
from fringedic.wording.yaml_text import load_yaml


class SetupItem(StrEnum):
    """Items in their order."""

    AXES = "axes"
    CAMERA_FOCUS = "camera_focus"
    PROJECTOR_FOCUS = "projector_focus"
    TIMING = "timing"
    RESPONSE = "response"
    CALIBRATE = "calibrate"
    CHECK = "check"
    REGION = "region"
    NOISE = "noise"
    ADVISE = "advise"


class ItemState(Enum):
    """State of an item."""

    NOT_DONE = 0
    DONE = 1
    OUT_OF_DATE = 2
    FAILED = 3
    NOT_IN_USE = 4


_GEOMETRY = (SetupItem.AXES, SetupItem.CAMERA_FOCUS, SetupItem.PROJECTOR_FOCUS)
# A new result of these makes the one of an item out of date
DEPENDS_ON: Mapping[SetupItem, tuple[SetupItem, ...]] = {
    SetupItem.PROJECTOR_FOCUS: (SetupItem.AXES,),
    SetupItem.RESPONSE: (SetupItem.CAMERA_FOCUS, SetupItem.PROJECTOR_FOCUS),
    SetupItem.CALIBRATE: _GEOMETRY,
    SetupItem.CHECK: (SetupItem.CALIBRATE,),
    SetupItem.REGION: (SetupItem.AXES, SetupItem.CAMERA_FOCUS),
    SetupItem.NOISE: (*_GEOMETRY, SetupItem.CALIBRATE, SetupItem.REGION),
    SetupItem.ADVISE: (SetupItem.CAMERA_FOCUS,),
}


class SetupRecord(BaseModel):
    """Result of one item.

    Attributes
    ----------
    when
        Time of its end, with time zone.
    words
        The result in sentences.
    folder, picture
        Folder of its files, and a picture in it; empty without.
    good
        False for a check that the calibration did not pass.
    settings
        Lines for the rig file (YAML) that put the result into use; empty for a result that needs none.
    measured_with
        Lines of the rig file that the result is about, such as the calibration that was checked; empty without.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    when: datetime
    words: tuple[str, ...] = ()
    folder: str = ""
    picture: str = ""
    good: bool = True
    settings: str = ""
    measured_with: str = ""


@dataclass(frozen=True)
class ListedItem:
    """An item with its state.

    Attributes
    ----------
    record
        Its result; None when it was not done.
    superseded_by
        Items that were done later and that it depends on.
    present
        Lines of the rig file that correspond to the result: its settings, or those that it was measured with.
    is_in_use
        Whether they are those of the result.
    """

    item: SetupItem
    record: SetupRecord | None
    superseded_by: tuple[SetupItem, ...] = ()
    present: tuple[str, ...] = ()
    is_in_use: bool = True

    @property
    def state(self) -> ItemState:
        """State of the item."""
        if self.record is None:
            return ItemState.NOT_DONE
        if self.superseded_by or (self.record.measured_with and not self.is_in_use):
            return ItemState.OUT_OF_DATE
        if not self.record.good:
            return ItemState.FAILED
        return ItemState.DONE if self.is_in_use else ItemState.NOT_IN_USE


@dataclass(frozen=True)
class CheckList:
    """The results of a rig's set-up so far.

    Attributes
    ----------
    records
        By item.

    Examples
    --------
    >>> from datetime import UTC
    >>> first, later = datetime(2026, 3, 1, tzinfo=UTC), datetime(2026, 3, 2, tzinfo=UTC)
    >>> done = CheckList().with_record(SetupItem.CALIBRATE, SetupRecord(when=first))
    >>> done = done.with_record(SetupItem.CAMERA_FOCUS, SetupRecord(when=later))
    >>> [each.item.value for each in done.items() if each.state is ItemState.OUT_OF_DATE]
    ['calibrate']
    """

    records: Mapping[SetupItem, SetupRecord] = field(default_factory=dict)

    def with_record(self, item: SetupItem, record: SetupRecord) -> CheckList:
        """Return the list with a new result of an item."""
        return replace(self, records={**self.records, item: record})

    def items(
        self, rig_file: Mapping[str, Any] | None = None, folder: str | os.PathLike[str] = "."
    ) -> list[ListedItem]:
        """Return all items in their order.

        Parameters
        ----------
        rig_file
            Content of the rig file, which decides what is in use; without it every result counts as used.
        folder
            Folder of the rig file: files that it names are shown with their dates.
        """
        return [self._item(item, rig_file, Path(folder)) for item in SetupItem]

    def _item(self, item: SetupItem, rig_file: Mapping[str, Any] | None, folder: Path) -> ListedItem:
        record = self.records.get(item)
        settings = "" if record is None else record.settings or record.measured_with
        if rig_file is None or not settings:
            return ListedItem(item, record, self._superseding(item))
        wanted = _lines(load_yaml(settings))
        present = _lines(rig_file)
        lines = tuple(f"{name}: {_dated(present.get(name, 'nothing'), folder)}" for name in wanted)
        is_in_use = all(present.get(name) == value for name, value in wanted.items())
        return ListedItem(item, record, self._superseding(item), lines, is_in_use)

    def _superseding(self, item: SetupItem) -> tuple[SetupItem, ...]:
        own = self.records.get(item)
        if own is None:
            return ()
        needed = [each for each in DEPENDS_ON.get(item, ()) if each in self.records]
        if item is SetupItem.CHECK and own.measured_with:  # the calibration in use decides, not one that is newer
            needed = []
        return tuple(each for each in needed if self.records[each].when > own.when)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the list as YAML; an earlier file is replaced at once."""
        content = {item.value: record.model_dump(mode="json") for item, record in self.records.items()}
        target = Path(path)
        new = target.with_name(f"{target.name}.new")
        new.write_text("# Results of the set-up, for the operator's page\n" + yaml.safe_dump(content, sort_keys=False))
        new.replace(target)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> CheckList:
        """Read what `save` wrote; an empty list when there is no file.

        Raises
        ------
        RigSetupError
            The file is no check list.
        """
        file = Path(path)
        if not file.exists():
            return cls()
        try:
            content = load_yaml(file.read_text("utf-8")) or {}
            return cls({SetupItem(key): SetupRecord.model_validate(value) for key, value in content.items()})
        except (OSError, UnicodeDecodeError, yaml.YAMLError, ValidationError, ValueError, AttributeError) as error:
            raise RigSetupError(f"{file}: is no check list of the set-up: correct or remove it") from error


def _dated(value: Any, folder: Path) -> str:
    """Return a value for people; a file with the time of its last change."""
    file = folder / value if isinstance(value, str) else None
    if file is None or not file.is_file():
        return str(value)
    return f"{value} of {datetime.fromtimestamp(file.stat().st_mtime):%Y-%m-%d %H:%M}"


def _lines(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of nested sections by their paths, such as ``camera.settle_ms``."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        inner = _lines(value) if isinstance(value, Mapping) else None
        found |= {str(key): value} if inner is None else {f"{key}.{name}": each for name, each in inner.items()}
    return found
