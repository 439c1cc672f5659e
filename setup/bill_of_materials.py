#!/usr/bin/env python3
"""Writes which packages set-up installs, with version, licence and checksums (CycloneDX 1.6, JSON).

The lock files contain all of this but the licence, which the installed packages state. The format is a list; a library
for it would bring more packages than it describes fields.

    python setup/bill_of_materials.py docs/_build/sbom.cdx.json
"""

from __future__ import annotations

import json
import os
import re
import sys
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

FOLDER = Path(__file__).parent
LOCKS = (FOLDER / "requirements.lock", FOLDER / f"requirements-{os.environ.get('ROS_DISTRO', 'jazzy')}.lock")
_PINNED = re.compile(
    r"^([A-Za-z0-9][\w.-]*)==([^ ;\\\n]+)(?: ; ([^\\\n]+?))?((?: \\\n +--hash=sha256:[0-9a-f]{64})+)$", re.M
)
_LONGEST_NAME = 60  # characters of a licence's name; some packages state its whole text instead
# Of packages whose metadata do not contain it, by their licence files
STATED_ELSEWHERE = {"setuptools": "MIT", "ros-fastcdr": "Apache-2.0", "ros-fastrtps": "Apache-2.0"}
# Of packages that are installed on other systems, for real devices, or with another distribution of ROS 2, only
ELSEWHERE = {
    "appnope": "BSD-2-Clause",
    "colorama": "BSD-3-Clause",
    "coloredlogs": "MIT",
    "humanfriendly": "MIT",
    "pycairo": "LGPL-2.1-only OR MPL-1.1",
    "pygobject": "LGPL-2.1-or-later",
    "pyobjc-core": "MIT",
    "pyobjc-framework-cocoa": "MIT",
    "pyreadline3": "BSD-3-Clause",
    "pytz": "MIT",
    "ros-ament-cmake-ros-core": "Apache-2.0",
    "ros-fastdds": "Apache-2.0",
    "ros-rmw-security-common": "Apache-2.0",
    "ros-rmw-test-fixture": "Apache-2.0",
    "ros-rmw-test-fixture-implementation": "Apache-2.0",
    "tzdata": "Apache-2.0",
}


@dataclass(frozen=True)
class Package:
    """A locked package: name, version, the systems that it is installed on (empty for all), SHA-256 of its files."""

    name: str
    version: str
    marker: str
    checksums: tuple[str, ...]

    @property
    def licences(self) -> list[str]:
        """SPDX expression, or the names that the package states; empty if nothing states one."""
        try:
            installed = metadata.distribution(self.name)
        except metadata.PackageNotFoundError:
            return [ELSEWHERE[self.name]] if self.name in ELSEWHERE else []
        stated: Any = installed.metadata  # a mapping by its documentation, not by its type
        if expression := stated.get("License-Expression"):
            return [expression]
        classifiers = [each.split(" :: ") for each in stated.get_all("Classifier") or []]
        names = [each[-1] for each in classifiers if each[0] == "License" and each[-1] != "DFSG approved"]
        names = names or [name for name in [stated.get("License") or ""] if _is_name(name)]
        names = names or [name for file in installed.files or [] for name in _of_ros(Path(str(file.locate())))]
        return names or ([STATED_ELSEWHERE[self.name]] if self.name in STATED_ELSEWHERE else [])


def _is_name(text: str) -> bool:
    return 0 < len(text) <= _LONGEST_NAME and "\n" not in text and text != "UNKNOWN"


def _of_ros(file: Path) -> list[str]:
    """Return the licences in the description of a ROS package, nothing of other files."""
    if file.name != "package.xml":
        return []
    return [each.text or "" for each in ElementTree.parse(file).getroot().findall("license")]


def locked(*locks: Path) -> Iterator[Package]:
    """Yield the packages of lock files; one that differs between versions of Python is there several times."""
    for found in _PINNED.finditer(_text(locks)):
        name, version, marker, hashes = found.groups()
        yield Package(name, version, marker or "", tuple(re.findall("[0-9a-f]{64}", hashes)))


def _text(locks: tuple[Path, ...]) -> str:
    return "\n".join(lock.read_text("utf-8") for lock in locks)


def bill() -> dict[str, object]:
    """Return the bill of materials of the environment that set-up makes; the same lock files give the same bill."""
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, _text(LOCKS))}",
        "version": 1,
        "metadata": {
            "component": {"type": "application", "name": "fringedic", "version": metadata.version("fringedic")}
        },
        "components": [_component(package) for package in locked(*LOCKS)],
    }


def _component(package: Package) -> dict[str, object]:
    address = f"pkg:pypi/{package.name}@{package.version}"
    component: dict[str, object] = {
        "type": "library",
        "bom-ref": address,
        "name": package.name,
        "version": package.version,
        "purl": address,
        "licenses": [{"license": {"name": name}} for name in package.licences],
        "externalReferences": [
            {
                "type": "distribution",
                "url": f"https://pypi.org/project/{package.name}/{package.version}/",
                "hashes": [{"alg": "SHA-256", "content": checksum} for checksum in package.checksums],
            }
        ],
    }
    if package.marker:
        component["properties"] = [{"name": "python:marker", "value": package.marker}]
    return component


def main() -> None:
    """Write the bill into the file that the command names."""
    target = Path(sys.argv[1])
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(bill(), indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
