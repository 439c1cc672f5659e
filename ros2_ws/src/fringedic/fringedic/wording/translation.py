"""English sentences and words that the page shows in the language of its reader."""

from __future__ import annotations

from typing import Any, TypeVar

WordsT = TypeVar("WordsT")


class Sentence(str):
    """A sentence with values, as text; the page translates its template and sets the values in.

    Parameters
    ----------
    template
        The sentence with a name in braces in place of each value: a literal, which is a key of the catalogues.
    values
        The values: words, other sentences, and numbers with the digits that are shown.

    Examples
    --------
    >>> measured = Sentence("{steps} steps measured", steps=3)
    >>> measured
    '3 steps measured'
    >>> measured.template, measured.values
    ('{steps} steps measured', {'steps': 3})
    """

    template: str
    values: dict[str, Any]

    def __new__(cls, template: str, **values: Any) -> Sentence:
        """Return the sentence in English."""
        created = super().__new__(cls, template.format(**values))
        created.template, created.values = template, values
        return created


def translatable(words: WordsT) -> WordsT:
    """Return a word, or a literal with words, that the page looks up in its catalogues as it is.

    The test of the catalogues finds all literal texts in the argument, so that keys of the code do not belong there.

    Examples
    --------
    >>> translatable(("moving", "hold"))[1]
    'hold'
    """
    return words
