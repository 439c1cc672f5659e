"""The group of a recording in the store of a campaign while it is written, with Zarr."""

from __future__ import annotations

import hashlib
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any

import numpy as np

from fringedic.campaign.store import RECORDINGS, CampaignStore, digest_of
from fringedic.datasets.checked_store import ChecksummedStore
from fringedic.datasets.checksums import CONTENT
from fringedic.datasets.quantities import MAP_DIMENSIONS, TEXT
from fringedic.datasets.stores import Variable, consolidate, create_array, free_bytes
from fringedic.wording.optional_packages import optional_import

with optional_import("campaign"):
    import zarr
    from zarr.abc.store import Store as ZarrStore
    from zarr.storage import WrapperStore

_METADATA = "zarr.json"
_STEPS_PER_CHUNK = 1024  # of values per step


class GroupStore:
    """The group of one recording while it is written, as `fringedic.datasets.stores.Store`.

    Maps are written at once, one whole chunk each. Values per step and all metadata are kept until the end. A second
    worker with the same unit, or a later one after a crash, writes the same bytes under the same names. What an attempt
    with other settings left is removed in the end.

    Parameters
    ----------
    store
        Of the campaign.
    recording
        Name of the recording.
    """

    def __init__(self, store: CampaignStore, recording: str) -> None:
        self._store = store
        self._folder = f"{RECORDINGS}/{recording}"
        self._target = _HeldMetadata(store.zarr_store(recording))
        self._group = zarr.create_group(self._target)
        self._arrays: dict[str, Any] = {}
        self._growing: list[str] = []
        self._values: dict[str, dict[Any, Any]] = {}
        self._steps = 0

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"{self._store.address}/{self._folder}"

    @property
    def digest(self) -> str:
        """SHA-256 over the names and SHA-256 of all objects of the group."""
        return digest_of(self._target.checksums)

    @property
    def objects(self) -> int:
        """Number of objects."""
        return len(self._target.checksums)

    @property
    def size(self) -> int:
        """Of all objects [byte]."""
        return self._target.size

    def room(self) -> float:
        """Return the bytes that still fit; infinity in an object store."""
        folder = self._store.local
        if folder is None:
            return np.inf
        folder.mkdir(parents=True, exist_ok=True)
        return free_bytes(folder / RECORDINGS)

    def add_variable(self, variable: Variable, sizes: Mapping[str, int]) -> None:
        """Make a variable; `sizes` is that of each dimension now (step may grow)."""
        name, dimensions, *_ = variable
        shape = tuple(sizes[dimension] for dimension in dimensions)
        chunks = (1, *shape[1:]) if dimensions == MAP_DIMENSIONS else (_STEPS_PER_CHUNK,)
        if dimensions[0] != "step":
            chunks = shape
        self._arrays[name] = create_array(self._group, variable, shape, chunks)
        if dimensions[0] == "step":
            self._growing.append(name)
        if dimensions == ("step",):
            self._values[name] = {}

    def grow(self, steps: int) -> None:
        """Make room for as many steps; only the metadata, which are not written yet, contain their number."""
        self._steps = steps
        for name in self._growing:
            if name not in self._values:
                self._resize(name)

    def put(self, name: str, index: int | slice, value: Any) -> None:
        """Write one map, or a whole coordinate; keep a value of a step, which replaces an earlier one."""
        if name in self._values:
            self._values[name][index] = value
            return
        self._arrays[name][index] = value

    def flush(self) -> None:
        """Every chunk is written already."""

    def finish(self, attributes: Mapping[str, str]) -> None:
        """Write the values of the steps, and the metadata."""
        for name, by_step in self._values.items():
            values = [by_step[index] for index in range(self._steps)]
            self._resize(name)
            self._arrays[name][:] = np.array(values, dtype=object if isinstance(values[0], str) else None)
        self._group.attrs.update(dict(attributes))
        consolidate(self._target)
        self._store.remove_others(self._folder, self._target.checksums)
        self._store.put({f"{self._folder}/{name}": data for name, data in self._target.metadata.items()})

    def discard(self) -> None:
        """Leave what was written: without a receipt it counts as nothing."""

    def _resize(self, name: str) -> None:
        array = self._arrays[name]
        array.resize((self._steps, *array.shape[1:]))


def join_parts(store: CampaignStore, parts: Sequence[str], group: GroupStore) -> None:
    """Write the groups of the parts of a recording, in their order, as the group of the recording."""
    target = ChecksummedStore(group)
    groups = [zarr.open_group(store.zarr_store(part, read_only=True), mode="r") for part in parts]
    arrays: list[dict[str, Any]] = [dict(group.arrays()) for group in groups]
    sizes = {
        dimension: length
        for array in arrays[0].values()
        for dimension, length in zip(array.metadata.dimension_names, array.shape, strict=True)
        if dimension != MAP_DIMENSIONS[0]
    }
    for name, array in arrays[0].items():
        dtype = TEXT if array.dtype.kind in "TOU" else array.dtype.str[1:]
        variable = Variable(name, array.metadata.dimension_names, dtype, dict(array.attrs))
        target.add_variable(variable, {"step": 0, **sizes})
        if MAP_DIMENSIONS[0] not in array.metadata.dimension_names:  # those of the whole recording are in every part
            target.put(name, slice(None), array[:])
    stepwise = [name for name, array in arrays[0].items() if MAP_DIMENSIONS[0] in array.metadata.dimension_names]
    steps = [(part, index) for part in arrays for index in range(part["step"].shape[0])]
    for place, (part, index) in enumerate(steps):
        target.grow(place + 1)
        for name in stepwise:
            target.put(name, place, part[name][index])
    target.finish(_joined_attributes([dict(group.attrs) for group in groups]))


def _joined_attributes(attributes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the attributes of a recording: the parameters of all parts, the latest of everything else."""
    settings: list[dict[str, Any]] = []
    for each in attributes:
        settings += [
            entry
            for entry in json.loads(each["parameters"])
            if not settings or entry["parameters"] != settings[-1]["parameters"]
        ]
    joined = {name: value for each in attributes for name, value in each.items() if name != CONTENT}
    return {**joined, "parameters": json.dumps(settings)}


class _HeldMetadata(WrapperStore[Any]):
    """Keeps metadata in memory and writes everything else at once, with its checksum.

    The metadata of an earlier attempt do not exist for it.
    """

    def __init__(self, store: ZarrStore) -> None:
        super().__init__(store)
        self._held: dict[str, Any] = {}
        self._checksums: dict[str, str] = {}
        self.size = 0

    @property
    def metadata(self) -> dict[str, bytes]:
        """The metadata by their names, with sorted keys: their order differs from run to run."""
        documents = {key: json.loads(value.to_bytes()) for key, value in self._held.items()}
        return {key: json.dumps(document, sort_keys=True).encode() for key, document in documents.items()}

    @property
    def checksums(self) -> dict[str, str]:
        """SHA-256 of every object by its name."""
        return self._checksums | {key: hashlib.sha256(data).hexdigest() for key, data in self.metadata.items()}

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        if key.endswith(_METADATA):
            return self._held.get(key)
        return await super().get(key, prototype, byte_range)

    async def exists(self, key: str) -> bool:
        if key.endswith(_METADATA):
            return key in self._held
        return await super().exists(key)

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """List the arrays, for the consolidated metadata; those without a chunk have no folder in the store."""
        for key in self._held:
            name, _, rest = key.removeprefix(prefix).lstrip("/").partition("/")
            if rest == _METADATA:
                yield name

    async def set_if_not_exists(self, key: str, value: Any) -> None:
        """Keep metadata that are new; nothing else is written by this method."""
        self._held.setdefault(key, value)

    async def set(self, key: str, value: Any) -> None:
        if key.endswith(_METADATA):
            self._held[key] = value
            return
        data = value.to_bytes()
        self._checksums[key] = hashlib.sha256(data).hexdigest()
        self.size += len(data)
        await super().set(key, value)
