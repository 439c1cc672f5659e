"""The store of a campaign: a folder or an object store with results, plan, receipts and failures.

::

    plan.json              settings, software and units
    recordings/NAME/       one Zarr group (format 3) per recording, one chunk per step and map
    receipts/NAME.json     written last: the recording is complete
    failures/NAME.json     why it could not be processed
    begun/NAME.json        a worker processes it, or died meanwhile; removed with its receipt or failure
    parts/NAME~0.json      receipt of a part of a recording, recordings/NAME~0 its group; both end with the recording

Nothing is appended to or resized in place. A file is seen as a whole or not at all, as an object of an object store.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from fringedic.errors import CampaignError, FringedicError
from fringedic.wording.causes import cause_of
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from zarr.abc.store import Store as ZarrStore

with optional_import("campaign"):
    import fsspec

PLAN = "plan.json"
RECORDINGS, RECEIPTS, FAILURES = "recordings", "receipts", "failures"
BEGUN = "begun"  # recordings that a worker has begun, with the number of the attempt
PARTS = "parts"  # receipts of parts of recordings
_CHECKSUM = "crc32"  # key of each JSON object
_PARTIAL = ".partial"  # ending of a file that is being written, here and by zarr


class CampaignStore:
    """Reads and writes the objects of a store.

    Parameters
    ----------
    address
        A folder, or an address such as ``s3://laboratory/batch-7``. Credentials and the end point of an object store
        are those of the environment.

    Raises
    ------
    CampaignError
        The address is of no known kind; from every method, when the store cannot be read or written.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        try:
            self._files, self._root = fsspec.core.url_to_fs(address)
        except (ValueError, ImportError) as error:
            raise CampaignError(f"{address}: is no folder and no known kind of address: {error}") from error

    @property
    def local(self) -> Path | None:
        """The folder; None of an object store."""
        return None if "://" in self.address else Path(self.address)

    def read(self, name: str) -> dict[str, Any] | None:
        """Return a JSON object; None if there is none, or if it is not complete."""
        with self._named("read"):
            try:
                return _document(self._files.cat_file(self._path(name)), f"{self.address}/{name}")
            except FileNotFoundError:
                return None

    def write(self, name: str, document: Mapping[str, Any]) -> None:
        """Write a JSON object."""
        self.put({name: json.dumps({**document, _CHECKSUM: _checksum(document)}, indent=1).encode()})

    def put(self, objects: Mapping[str, bytes]) -> None:
        """Write objects by their names."""
        with self._named("written"):
            if self.local is None:
                self._files.pipe({self._path(name): data for name, data in objects.items()})
                return
            for name, data in objects.items():
                _replace(self.local / _inside(name), data)

    def remove(self, name: str) -> None:
        """Remove an object or everything below a name, if there is something."""
        with self._named("written"), suppress(FileNotFoundError):
            self._files.rm(self._path(name), recursive=True)

    def remove_others(self, folder: str, kept: Container[str]) -> None:
        """Remove the objects below a folder that an earlier attempt left, except those whose names are given."""
        with self._named("written"), suppress(FileNotFoundError):
            self._files.invalidate_cache()
            root = f"{self._path(folder)}/"
            names = [path.removeprefix(root) for path in self._files.find(root) if path.startswith(root)]
            # another worker renames its partial files at once
            others = [f"{root}{name}" for name in names if name not in kept and not name.endswith(_PARTIAL)]
            if others:
                self._files.rm(others)

    def documents(self, folder: str) -> dict[str, dict[str, Any]]:
        """Return all complete JSON objects of a folder by their names, in the order of the names.

        Objects that are removed meanwhile are left out.
        """
        with self._named("read"):
            self._files.invalidate_cache()
            try:
                paths = sorted(path for path in self._files.find(self._path(folder)) if path.endswith(".json"))
            except FileNotFoundError:
                return {}
            contents = self._files.cat(paths, on_error="return") if paths else {}
            present = {path: each for path, each in contents.items() if not isinstance(each, FileNotFoundError)}
            for each in present.values():
                if isinstance(each, Exception):
                    raise each
        found = {Path(path).stem: _document(present[path], path) for path in paths if path in present}
        return {name: document for name, document in found.items() if document is not None}

    def complete_groups(self, recordings: Iterable[str]) -> list[str]:
        """Return which of some recordings have a complete group, whose metadata are written last."""
        with self._named("read"):
            self._files.invalidate_cache()
            try:
                present = {Path(path).name for path in self._files.ls(self._path(RECORDINGS), detail=False)}
            except FileNotFoundError:
                return []
            metadata = {name: self._path(f"{RECORDINGS}/{name}/zarr.json") for name in recordings if name in present}
            return [name for name, path in metadata.items() if self._files.exists(path)]

    def digest(self, recording: str) -> str:
        """Return the SHA-256 over the names and SHA-256 of all objects of the group of a recording, as its receipt."""
        with self._named("read"):
            self._files.invalidate_cache()
            root = f"{self._path(f'{RECORDINGS}/{recording}')}/"
            checksums = {
                path.removeprefix(root): hashlib.sha256(self._files.cat_file(path)).hexdigest()
                for path in self._files.find(root)
                if not path.endswith(_PARTIAL)
            }
        return digest_of(checksums)

    def zarr_store(self, recording: str, *, read_only: bool = False) -> ZarrStore:
        """Return the Zarr store of a recording, whose root is its group."""
        from zarr.storage import FsspecStore, LocalStore  # not at the top: states of campaigns do not need it

        name = _inside(f"{RECORDINGS}/{recording}")
        if self.local is not None:
            return LocalStore(self.local / name, read_only=read_only)
        return FsspecStore.from_url(f"{self.address}/{name}", read_only=read_only)

    def _path(self, name: str) -> str:
        return f"{self._root}/{_inside(name)}"

    @contextmanager
    def _named(self, what: str) -> Iterator[None]:
        try:
            yield
        except (FringedicError, FileNotFoundError):
            raise
        except Exception as error:  # every kind of store has its own errors
            reason = cause_of(error)
            raise CampaignError(
                f"the store {self.address} cannot be {what}: {reason}; check the address, the rights and the "
                "credentials, and repeat the command: what is committed stays"
            ) from error


def digest_of(checksums: Mapping[str, str]) -> str:
    """Return the SHA-256 over the names and SHA-256 of objects."""
    lines = (f"{checksum}  {name}\n" for name, checksum in sorted(checksums.items()))
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _inside(name: str) -> str:
    """Return a name after a check that it stays inside the store, whatever a plan or another worker calls a recording.

    Raises
    ------
    CampaignError
        It does not.
    """
    if any(part in ("", ".", "..") for part in name.split("/")):
        raise CampaignError(f"'{name}' is no name in a store; plan again with 'fringedic campaign plan --recompute'")
    return name


def _replace(file: Path, data: bytes) -> None:
    """Write a file that other workers may read, or write as well, at the same time."""
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f"{file.name}.{uuid4().hex}{_PARTIAL}")
    try:
        partial.write_bytes(data)
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)


def _document(data: bytes, place: str) -> dict[str, Any] | None:
    """Return a JSON object; None when a power cut, or a killed process of an earlier version, has left a part of it.

    Raises
    ------
    CampaignError
        It was changed since it was written.
    """
    whole = data.rstrip().endswith(b"}")
    try:
        found = json.loads(data)
    except ValueError:
        if whole:
            raise _damaged(place) from None
        return None
    if not isinstance(found, dict):
        return None
    checksum = found.pop(_CHECKSUM, None)  # earlier versions wrote none
    if checksum not in (None, _checksum(found)):
        raise _damaged(place)
    return found


def _damaged(place: str) -> CampaignError:
    return CampaignError(
        f"{place} is damaged, its content is not what was written: remove it and repeat 'fringedic campaign run', "
        "which makes it again"
    )


def _checksum(document: Mapping[str, Any]) -> str:
    return f"{zlib.crc32(json.dumps(document, sort_keys=True).encode()):08x}"
