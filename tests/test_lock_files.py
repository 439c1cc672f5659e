"""The lock files fit what they were made from, and each other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

SETUP = Path(__file__).parent.parent / "setup"
DISTRIBUTIONS = ("jazzy", "kilted")


def locked(name: str) -> dict[str, list[str]]:
    """Return the versions of each package in a lock file; several where they differ by Python."""
    versions: dict[str, list[str]] = {}
    for package, version in re.findall(r"^([a-z0-9._-]+)==(\S+)", (SETUP / f"{name}.lock").read_text(), re.MULTILINE):
        versions.setdefault(canonicalize_name(package), []).append(version)
    return versions


def required(name: str) -> list[Requirement]:
    """Return what an input file and those that it includes require."""
    requirements = []
    for line in (SETUP / f"{name}.in").read_text().splitlines():
        if line.startswith("-r "):
            requirements += required(Path(line.split()[1]).stem)
        elif line and not line.startswith("#"):
            requirements.append(Requirement(line))
    return requirements


@pytest.mark.parametrize(
    ("inputs", "locks", "left_out"),
    [
        ("requirements", ["requirements"], set()),
        ("requirements-stock", ["requirements-stock"], {"numpy"}),
        ("requirements-installer", ["requirements-installer"], set()),
        ("requirements-hardware", ["requirements-hardware"], set()),
        *[(f"requirements-{each}", ["requirements", f"requirements-{each}"], set()) for each in DISTRIBUTIONS],
    ],
)
def test_locked_versions_are_those_required(inputs: str, locks: list[str], left_out: set[str]) -> None:
    versions: dict[str, list[str]] = {}
    for lock in locks:
        versions |= locked(lock)
    for requirement in required(inputs):
        name = canonicalize_name(requirement.name)
        if name in left_out:
            assert name not in versions
            continue
        assert versions[name], name
        assert all(requirement.specifier.contains(Version(version)) for version in versions[name]), name


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_a_distribution_locks_only_what_belongs_to_it(distribution: str) -> None:
    """Everything else has one version, whatever the distribution."""
    assert not locked(f"requirements-{distribution}").keys() & locked("requirements").keys()
    assert not any(name.startswith("ros-") for name in locked("requirements"))


@pytest.mark.parametrize("lock", sorted(SETUP.glob("*.lock")), ids=lambda lock: lock.stem)
def test_every_locked_package_has_hashes_and_no_address(lock: Path) -> None:
    text = lock.read_text()
    assert "://" not in text
    for entry in re.split(r"\n(?=[a-z])", text.strip()):
        assert "--hash=sha256:" in entry, entry.splitlines()[0]
