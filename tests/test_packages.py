"""Papers of the packages: changelog, addresses, and the quality declaration with its proofs."""

from __future__ import annotations

import re
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from docutils import nodes
from docutils.core import publish_doctree
from running_system import ROOT

SOURCES = ROOT / "ros2_ws" / "src"
PACKAGES = sorted(path.parent for path in SOURCES.glob("*/package.xml"))
DECLARATION = ROOT / "QUALITY_DECLARATION.md"
ROW = re.compile(r"^\| (?P<what>.+?) \| (?P<answer>yes|no) \| (?P<proof>.+) \|$", re.MULTILINE)
ANSWERS = [(row["what"], row["answer"], row["proof"]) for row in ROW.finditer(DECLARATION.read_text())]


@pytest.mark.parametrize(("what", "proof"), [(what, proof) for what, answer, proof in ANSWERS if answer == "yes"])
def test_each_yes_is_proven_by_something_that_exists(what: str, proof: str) -> None:
    proofs = re.findall(r"`([^`]+)`", proof)
    assert proofs, f"'{what}' names no proof"
    for each in proofs:
        file, _, test = each.partition("::")
        assert (ROOT / file).exists(), f"'{what}' names {file}"
        if test:
            assert re.search(rf"^def {test}\(", (ROOT / file).read_text(), re.MULTILINE), f"'{what}' names {each}"


def test_every_no_has_a_reason_and_no_row_is_without_an_answer() -> None:
    rows = [line for line in DECLARATION.read_text().splitlines() if line.startswith("| ") and "proof or" not in line]
    assert len(ANSWERS) == len(rows)
    assert all(len(proof.split()) > 3 for _, answer, proof in ANSWERS if answer == "no")


def test_level_3_is_not_claimed_while_a_requirement_is_missing() -> None:
    missing = [what for what, answer, _ in ANSWERS if answer == "no"]
    assert bool(missing) == ("do not claim level 3 yet" in DECLARATION.read_text())


def test_the_declaration_is_linked() -> None:
    assert "(QUALITY_DECLARATION.md)" in (ROOT / "README.md").read_text()


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_each_package_has_a_changelog(package: Path) -> None:
    document = publish_doctree((package / "CHANGELOG.rst").read_text(), settings_overrides={"halt_level": 2})
    assert document.next_node(nodes.title).astext() == f"Changelog for package {package.name}"
    version = ElementTree.parse(package / "package.xml").findtext("version")
    sections = [section.astext().split("\n")[0] for section in document.findall(nodes.subtitle)]
    sections += [section.next_node(nodes.title).astext() for section in document.findall(nodes.section)]
    assert sections
    assert all(name == "Forthcoming" or name.split(" ")[0] == version for name in sections[:1])
    assert document.next_node(nodes.list_item) is not None


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_each_package_has_licence_maintainer_and_addresses(package: Path) -> None:
    manifest = ElementTree.parse(package / "package.xml")
    assert manifest.findtext("license") == "Apache-2.0"
    maintainer = manifest.find("maintainer")
    assert maintainer is not None
    assert "@" in maintainer.attrib["email"]
    assert {url.attrib["type"] for url in manifest.iter("url")} == {"repository", "bugtracker"}


def test_coverage_has_a_limit() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["coverage"]
    assert settings["report"]["fail_under"] >= 90
    assert "--cov" in (ROOT / "setup" / "check.sh").read_text()
    assert "COVERAGE=yes make test" in (ROOT / ".ci" / "run").read_text()
