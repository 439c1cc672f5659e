"""The languages of the page: a catalogue (gettext, ``languages/*.po``) of its sentences."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

CATALOGUES = Path(__file__).with_name("languages")
ENGLISH = "en"
_LINE = re.compile(r'(?:(msgid|msgstr) )?(".*")')


def read_catalogue(text: str) -> dict[str, str]:
    r"""Return the translations in a catalogue by their English sentences; fuzzy and empty ones are left out.

    Plural forms and contexts, which the page does not use, are not read.

    Examples
    --------
    >>> read_catalogue('msgid "Step {step}"\nmsgstr "Schritt "\n"{step}"')
    {'Step {step}': 'Schritt {step}'}
    """
    found = {}
    for entry in re.split(r"\n\s*\n", text):
        fields, name = {"msgid": "", "msgstr": ""}, ""
        for line in entry.splitlines():
            if match := _LINE.fullmatch(line.strip()):
                name = match[1] or name
                fields[name] += json.loads(match[2])
        if fields["msgid"] and fields["msgstr"] and "#, fuzzy" not in entry:
            found[fields["msgid"]] = fields["msgstr"]
    return found


@lru_cache
def catalogues() -> dict[str, dict[str, str]]:
    """Return the catalogue of each language by its code; that of English is empty."""
    files = sorted(CATALOGUES.glob("*.po"))
    return {ENGLISH: {}} | {file.stem: read_catalogue(file.read_text("utf-8")) for file in files}


def words_in(wanted: Sequence[str]) -> dict[str, Any]:
    """Return the first wanted language that the page has, all that it has, and the sentences of that one.

    Parameters
    ----------
    wanted
        Codes of languages in the order of preference, such as de-AT; without a known one it is English.

    Examples
    --------
    >>> words_in(["it", "de-AT", "fr"])["language"]
    'de'
    """
    known = catalogues()
    codes = (each.partition("-")[0].lower() for each in wanted)
    language = next((each for each in codes if each in known), ENGLISH)
    return {"language": language, "languages": list(known), "sentences": known[language]}
