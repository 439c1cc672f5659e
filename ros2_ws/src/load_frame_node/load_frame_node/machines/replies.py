"""Values in the text replies of a machine, and what to change in its file where a reply does not fit it."""

from __future__ import annotations

import re

from fringedic.errors import MachineGoneError
from load_frame_node.machines.description import NumberQuery, Query

_WHOLE_NUMBER = re.compile(r"[+-]?[0-9]{1,9}")
_UNIT = r"(?:\s*([A-Za-z\u00b5\u03bc]+))?"
# float() takes 1_0 and other digits, too; displays right-align the digits after the sign
_NUMBERS = {
    ".": re.compile(r"([+-]?)\s*([0-9]+\.?[0-9]*(?:[eE][+-]?[0-9]+)?|\.[0-9]+(?:[eE][+-]?[0-9]+)?)" + _UNIT),
    ",": re.compile(r"([+-]?)\s*([0-9]+,?[0-9]*(?:[eE][+-]?[0-9]+)?|,[0-9]+(?:[eE][+-]?[0-9]+)?)" + _UNIT),
}
_SEPARATORS = (";", "|", ",", "=", ":", " ")  # that replies are tried with, to find what to change in the file
_SHOWN = 40  # characters of a reply that a message repeats
_PLACES = 8  # of numbers in a reply that a message lists


class UnfitReplyError(MachineGoneError):
    """A reply does not fit the machine file; it may also be the late answer to an earlier query.

    Attributes
    ----------
    cure
        End of the message: which keys make it fit; empty when none is known.
    """

    def __init__(self, message: str, cure: str = "") -> None:
        super().__init__(message + cure)
        self.cure = cure


def number_in(reply: str, query: NumberQuery, name: str) -> float:
    """Return the SI value of a reply.

    Parameters
    ----------
    reply
        Text that the machine has sent.
    query
        Entry of the machine file.
    name
        Name of this entry.

    Raises
    ------
    UnfitReplyError
        It is not the reply that the entry describes; the message says what to change.
    """
    text = value_in(reply, query, name)
    found = _NUMBERS[query.decimal].fullmatch(text)
    if found is None:
        raise UnfitReplyError(
            f"{name}: '{query.query}' was answered with {quoted(reply)}, which is not a number",
            _cure(text, query, name),
        )
    sign, digits, unit = found.groups()
    return query.si(float(sign + digits.replace(",", ".")), None if unit is None else _known_unit(unit, query, name))


def status_in(reply: str, query: Query, name: str) -> int | str:
    """Return the status of a reply; the parameters and errors are those of `number_in`."""
    text = value_in(reply, query, name)
    return int(text) if _WHOLE_NUMBER.fullmatch(text) else text


def value_in(reply: str, query: Query, name: str) -> str:
    """Return the text of one value of a reply; the parameters and errors are those of `number_in`."""
    values = _split(reply, query.separator)
    if query.index >= len(values):
        raise UnfitReplyError(
            f"{name}: '{query.query}' was answered with {quoted(reply)}, which has {len(values)} "
            f"value{'s' if len(values) > 1 else ''} separated by {query.separator!r}, so that index {query.index} has "
            f"none; correct separator or index of {name} (0 is the first)"
        )
    return values[query.index]


def quoted(reply: str) -> str:
    """Return a reply in quotes without its end, as messages repeat it: not too long, control characters visible."""
    return repr(reply.strip()[:_SHOWN])


def shown(reply: str) -> str:
    """Return a reply in quotes, with the characters of its end."""
    return repr(reply[:_SHOWN])


def _split(reply: str, separator: str | None) -> list[str]:
    if separator is None:
        return [reply.strip()]
    return [each.strip() for each in reply.strip().split(separator if separator.strip() else None)] or [""]


def _known_unit(unit: str, query: NumberQuery, name: str) -> str:
    """Return a unit as the file writes it. Displays write KN; mN alone depends on the case, against a mega-newton."""
    written = unit.replace("\u00b5", "u").replace("\u03bc", "u")
    folded = {each.casefold(): each for each in query.units if each != "mN"}
    known = written if written in query.units else folded.get(written.casefold())
    if known is None:
        raise UnfitReplyError(
            f"{name}: the reply to '{query.query}' is in '{unit[:_SHOWN]}', and {name} is expected in one of "
            f"{', '.join(query.units)}: check the query, or select another unit at the machine; separator: ' ' takes "
            "the number without its unit, which scale then converts"
        )
    return known


def _cure(text: str, query: NumberQuery, name: str) -> str:
    """Return which keys make a number of a text that is not one; empty when none does."""
    for separator in (None, *(_SEPARATORS if query.separator is None else ())):
        values = _split(text, separator)
        if separator is not None and len(values) < 2:
            continue
        for decimal, words in ((".", "remove decimal from"), (",", "add decimal: ',' to")):
            numbers = [index for index, value in enumerate(values) if _NUMBERS[decimal].fullmatch(value)]
            others = [value for index, value in enumerate(values) if index not in numbers]
            if not numbers or separator == decimal or any(value[:1].isdigit() for value in others):
                continue
            changes_sign = decimal != query.decimal and any("." in each or "," in each for each in values)
            sign = f"it has a decimal {'comma' if decimal == ',' else 'point'}: {words} {name}"
            if separator is None:
                return f": {sign}"
            places = " or ".join(map(str, numbers[:_PLACES]))
            parts = f"add separator: {separator!r} and index: {places} to {name}"
            return f": it contains several values: {parts}{f'; {sign}' if changes_sign else ''}"
    return ""
