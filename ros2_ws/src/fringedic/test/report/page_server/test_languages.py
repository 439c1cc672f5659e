"""Every sentence of the page has its translation in every catalogue, and no catalogue has others."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from fringedic.datasets.quantities import JOINED_MAPS, MAPS
from fringedic.report.page_server.app import PAGE, plain
from fringedic.report.page_server.languages import CATALOGUES, catalogues, read_catalogue, words_in
from fringedic.wording.translation import Sentence

PACKAGES = Path(__file__).resolve().parents[4]
LANGUAGES = sorted(path.stem for path in CATALOGUES.glob("*.po"))
_IN_SCRIPT = re.compile(r'\bt\(("(?:[^"\\]|\\.)*")')
_CALL = re.compile(r"\bt\(")
_TEMPLATE = "t(text.template, "  # the one call with a variable: of a sentence of the server


def in_scripts() -> set[str]:
    """Return the sentences of the scripts: t("…")."""
    found = set()
    for script in PAGE.glob("*.js"):
        text = script.read_text("utf-8").replace(_TEMPLATE, "").replace('t("Step {step}", { step: 3 })', "")
        sentences = [json.loads(each) for each in _IN_SCRIPT.findall(text)]
        assert len(sentences) == len(_CALL.findall(text)), f"{script.name}: t(...) needs a literal"
        found |= set(sentences)
    return found


def in_modules() -> set[str]:
    """Return the literals of the packages in translatable(…) and Sentence("…"), and the meanings of the maps."""
    files = [each for each in PACKAGES.rglob("*.py") if "test" not in each.parts]
    texts = (each.read_text("utf-8") for each in files)
    marked = (text for text in texts if "translatable(" in text or "Sentence(" in text)
    found = {sentence for text in marked for sentence in _marked(ast.parse(text))}
    return found | {quantity.long_name for quantity in (MAPS | JOINED_MAPS).values()}


def _marked(tree: ast.AST) -> Iterator[str]:
    for call in ast.walk(tree):
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or not call.args:
            continue
        if call.func.id == "Sentence":
            assert isinstance(call.args[0], ast.Constant), f"line {call.lineno}: Sentence(...) needs a literal"
            yield call.args[0].value
        elif call.func.id == "translatable":
            yield from (each.value for each in ast.walk(call) if isinstance(each, ast.Constant))


def placeholders(sentence: str) -> set[str]:
    return set(re.findall(r"\{\w*\}", sentence))


@pytest.fixture(scope="module")
def sentences() -> set[str]:
    found = in_scripts() | in_modules()
    assert len(found) > 300, "the sentences are found at all"
    return found


def test_german_and_french_are_there() -> None:
    assert {"de", "fr"} <= set(LANGUAGES)


@pytest.mark.parametrize("language", LANGUAGES)
def test_catalogue_has_every_sentence_and_no_other(language: str, sentences: set[str]) -> None:
    catalogue = catalogues()[language]  # without those that are empty or fuzzy
    lacking = sorted(sentences - set(catalogue))
    missing = "\n\n".join(f'msgid {json.dumps(each, ensure_ascii=False)}\nmsgstr ""' for each in lacking)
    assert not missing, f"{language}.po lacks:\n{missing}"
    assert not set(catalogue) - sentences, f"{language}.po has sentences that the page does not show"
    different = [each for each in catalogue if placeholders(each) != placeholders(catalogue[each])]
    assert not different, f"{language}.po: other values in braces"


@pytest.mark.parametrize("language", LANGUAGES)
def test_catalogue_is_read_as_other_programs_read_it(language: str) -> None:
    pofile = pytest.importorskip("babel.messages.pofile")
    with (CATALOGUES / f"{language}.po").open("rb") as file:
        read = pofile.read_po(file, abort_invalid=True)
    assert read.locale.language == language
    assert not read.obsolete
    assert {each.id: each.string for each in read if each.id} == catalogues()[language]


def test_fuzzy_empty_and_continued_entries() -> None:
    text = (
        '# glossary\nmsgid ""\nmsgstr "Language: de\\n"\n\n#, fuzzy\nmsgid "a"\nmsgstr "b"\n\nmsgid "c"\nmsgstr ""\n\n'
    )
    assert read_catalogue(text + 'msgid "d "\n"\\"e\\""\nmsgstr "f"\n') == {'d "e"': "f"}


@pytest.mark.parametrize(
    ("wanted", "language"),
    [("de-AT,fr", "de"), ("it,FR", "fr"), ("it", "en"), ("", "en"), ("en-GB,de", "en")],
)
def test_first_known_language_of_the_browser(wanted: str, language: str) -> None:
    assert words_in(wanted.split(","))["language"] == language


def test_a_sentence_is_sent_in_its_parts() -> None:
    who = Sentence("browser {number} ({address})", number=2, address="10.0.0.3")
    sentence = Sentence("{browser} drives: ask for the wheel first.", browser=who)
    assert sentence == "browser 2 (10.0.0.3) drives: ask for the wheel first."
    sent = plain([sentence])[0]
    assert sent["values"]["browser"] == {"template": who.template, "values": {"number": 2, "address": "10.0.0.3"}}
