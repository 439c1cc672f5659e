"""YAML text: of people, strictly, with the line in every message; of other programs, as they write it.

Both are limited: a text of some hundred bytes whose anchors repeat each other can take all memory.
"""

from __future__ import annotations

import re
from typing import Any

import yaml
from yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent

_LONGEST_EXCERPT = 40  # characters of a wrong value in a message
_DEEPEST = 50  # brackets within brackets; a programme of cycles within cycles has about ten
_MOST_REPEATED = 10_000  # values that stand for others by aliases (*name)
_FAST_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where PyYAML has it
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
# YAML 1.1 reads 010 as octal and 1:30 in base 60: a crosshead would move to another place than a person has written
_DECIMAL = re.compile(r"[-+]?(?=\.?[0-9])(0|[1-9][0-9]*)?(\.[0-9]*)?(e[-+]?[0-9]+)?|[-+]?\.(inf|nan)", re.I)


class InvalidYamlError(yaml.YAMLError):
    """A text is not YAML, has a key twice, or a value that YAML does not allow; the message is one sentence."""


class _Loader(yaml.SafeLoader):
    """Refuses repeated keys, of which YAML would keep the last, and gives errors of single values their place."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        places: dict[tuple[str, str], yaml.Mark] = {}
        for key, _ in node.value:  # not yet those of a merge (<<), which the node's own keys replace
            name = (key.tag, str(key.value))
            if name in places:
                raise InvalidYamlError(
                    f"line {key.start_mark.line + 1}: the key '{_excerpt(key.value)}' is in line "
                    f"{places[name].line + 1} already: remove one of them"
                )
            places[name] = key.start_mark
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        if node.tag in _NUMBERS and isinstance(node, yaml.ScalarNode) and not _DECIMAL.fullmatch(node.value):
            raise _invalid(node, "write a number in decimal digits without leading zeros, and text in quotes")
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError) as error:  # an impossible date, or a number of too many digits
            raise _invalid(node, str(error).partition(";")[0]) from error
        except (KeyError, AttributeError) as error:  # !!bool or !!timestamp before something else
            raise _invalid(node, f"it is no {node.tag.rpartition(':')[2]}") from error

    def scan_flow_scalar(self, style: str) -> yaml.ScalarToken:
        try:
            return super().scan_flow_scalar(style)
        except (ValueError, OverflowError) as error:
            raise InvalidYamlError(f"line {self.line + 1}: an escape sequence is no character of Unicode") from error


def _invalid(node: yaml.Node, reason: str) -> InvalidYamlError:
    value = _excerpt(node.value) or "an empty text"
    return InvalidYamlError(f"line {node.start_mark.line + 1}: {value} is no valid value: {reason}")


def load_yaml(text: str) -> Any:
    """Return the content of a YAML text: mappings, lists, text, numbers, dates, None.

    Parameters
    ----------
    text
        One YAML document of plain types.

    Raises
    ------
    InvalidYamlError
        The text is not YAML, has a key twice, a value that YAML does not allow, a number that is not decimal (octal,
        hexadecimal, binary, base 60, with underscores), too deep brackets, or aliases that repeat too much.

    Examples
    --------
    >>> load_yaml("{window: 24, spacing: 2}")
    {'window': 24, 'spacing': 2}
    >>> load_yaml("{window: 24, window: 32}")
    Traceback (most recent call last):
    fringedic.wording.yaml_text.InvalidYamlError: line 1: the key 'window' is in line 1 already: remove one of them
    """
    return _load(text, _Loader)


def load_foreign_yaml(text: str) -> Any:
    """Return the content of a YAML text that another program may have written; a repeated key replaces the first one.

    Raises
    ------
    Exception
        The text is not valid YAML, or as of `load_yaml` too deep or repeated too much. PyYAML raises errors of many
        classes for values that do not fit their tag.
    """
    return _load(text, _FAST_LOADER)


def _load(text: str, loader: Any) -> Any:
    try:
        refuse_bombs(text, loader)
        return yaml.load(text, loader)
    except InvalidYamlError:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        raise InvalidYamlError(f"{place}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise InvalidYamlError(" ".join(str(error).split())) from error


def refuse_bombs(text: str, loader: Any = _FAST_LOADER) -> None:
    """Refuse a YAML text that takes much more memory or time than its length lets expect.

    Parameters
    ----------
    text
        What another reader is going to load.
    loader
        Class of PyYAML that parses it.

    Raises
    ------
    InvalidYamlError
        Brackets are too deep, or an alias stands for itself, or aliases for too many values.
    yaml.YAMLError
        The text is not YAML.

    Examples
    --------
    >>> refuse_bombs("a: &a [*a]")
    Traceback (most recent call last):
    fringedic.wording.yaml_text.InvalidYamlError: line 1: &a contains itself
    """
    sizes: dict[str, int] = {}  # values within each anchor
    opened: list[tuple[str | None, int]] = []  # anchor of each open bracket, and the values before it
    values = repeated = 0
    for event in yaml.parse(text, loader):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, AliasEvent):
            name = _excerpt(event.anchor)
            if event.anchor in (anchor for anchor, _ in opened):
                raise InvalidYamlError(f"line {line}: &{name} contains itself")
            size = sizes.get(event.anchor or "", 1)
            values += size
            repeated += size
            if repeated > _MOST_REPEATED:
                raise InvalidYamlError(
                    f"line {line}: aliases such as *{name} stand for more than {_MOST_REPEATED} values: write them out"
                )
        elif isinstance(event, CollectionEndEvent):
            anchor, before = opened.pop()
            sizes |= {anchor: values - before} if anchor else {}
        elif isinstance(event, NodeEvent):
            values += 1
            if isinstance(event, CollectionStartEvent):
                opened.append((event.anchor, values - 1))
                if len(opened) > _DEEPEST:
                    raise InvalidYamlError(f"line {line}: more than {_DEEPEST} brackets or indents within each other")


def _excerpt(value: object) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST_EXCERPT else f"{text[:_LONGEST_EXCERPT]}..."
