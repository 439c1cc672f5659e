"""What set-up installs: every locked package has a licence that is known here, and is in the bill of materials."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "setup" / "bill_of_materials.py"
KNOWN = {
    *("0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "LLVM-exception", "MIT", "MIT-0", "MIT-CMU"),
    *("LGPL-2.1-only", "LGPL-2.1-or-later", "MPL-1.1", "MPL-2.0", "PSF-2.0", "Zlib", "any-OSI"),
    *(
        "Apache 2.0",
        "Apache License 2.0",
        "Apache License, Version 2.0",
        "Apache Software License",
        "BSD",
        "BSD License",
    ),
    *("ISC License (ISCL)", "MIT License", "Mozilla Public License 2.0 (MPL 2.0)", "Public Domain", "zlib License"),
    *("Python Software Foundation License", "GNU Library or Lesser General Public License (LGPL)"),
    "GNU Lesser General Public License v2 or later (LGPLv2+)",
}
# docutils is in the public domain except for files that are not installed or not imported here
OF_ONE_PACKAGE = {("docutils", "GNU General Public License (GPL)")}
specification = importlib.util.spec_from_file_location("bill_of_materials", SCRIPT)
assert specification is not None
assert specification.loader is not None
materials = importlib.util.module_from_spec(specification)
sys.modules["bill_of_materials"] = materials
specification.loader.exec_module(materials)


def unknown(packages: list[materials.Package]) -> list[str]:
    """Return the packages whose licence is not stated, or not known here."""
    found = []
    for package in packages:
        stated = package.licences
        parts = [
            part for name in stated for part in ([name] if name in KNOWN else re.split(r" (?:AND|OR|WITH) ", name))
        ]
        if not parts or not all(part in KNOWN or (package.name, part) in OF_ONE_PACKAGE for part in parts):
            found.append(f"{package.name} {package.version}: {stated}")
    return found


@pytest.mark.parametrize("lock", sorted(path.name for path in SCRIPT.parent.glob("*.lock")))
def test_every_locked_package_has_a_known_licence(lock: str) -> None:
    text = (SCRIPT.parent / lock).read_text()
    packages = list(materials.locked(SCRIPT.parent / lock))
    assert len(packages) == len(re.findall("==.*", re.sub(";.*", "", text)))
    assert sum(len(package.checksums) for package in packages) == text.count("--hash=sha256:")
    assert all(package.checksums for package in packages)
    assert unknown(packages) == []


def test_package_without_a_known_licence_is_found() -> None:
    assert unknown([materials.Package("not-installed", "1", "", ())]) == ["not-installed 1: []"]


def test_bill_of_materials(tmp_path: Path) -> None:
    file = tmp_path / "new" / "sbom.cdx.json"
    subprocess.run([sys.executable, SCRIPT, file], check=True)
    bill = json.loads(file.read_text())
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    components = {each["name"]: each for each in bill["components"]}
    assert components.keys() == {package.name for package in materials.locked(*materials.LOCKS)}
    numba = components["numba"]
    assert numba["purl"] == f"pkg:pypi/numba@{numba['version']}"
    assert numba["licenses"] == [{"license": {"name": "BSD License"}}]
    assert numba["externalReferences"][0]["hashes"]
    assert components["colorama"]["properties"] == [{"name": "python:marker", "value": "sys_platform == 'win32'"}]
    references = [each["bom-ref"] for each in bill["components"]]
    assert len(references) == len(set(references))
