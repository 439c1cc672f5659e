"""Characters that would command a terminal, in texts of other people: names of topics, keys of files, replies."""

from __future__ import annotations

_KEPT = "\n\t"
_PICTURES = {code: chr(0x2400 + code) for code in range(0x20) if chr(code) not in _KEPT} | {0x7F: "\u2421"}
# C1 control codes, marks that change the direction of writing, and halves of characters, which no terminal can show
_OTHERS = (*range(0x80, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A), *range(0xD800, 0xE000))
_VISIBLE = _PICTURES | dict.fromkeys(_OTHERS, "\ufffd")


def visible(text: str) -> str:
    r"""Return a text in which control characters except tabs and ends of lines are replaced by visible ones.

    Examples
    --------
    >>> visible("/force\x1b[2J")
    '/force␛[2J'
    """
    return text.translate(_VISIBLE)
