"""YAML text that people edit: a key may be there once only, numbers are decimal, and messages contain the line."""

from __future__ import annotations

import re
from typing import Any

import yaml

_LONGEST_EXCERPT = 40  # characters of a wrong value in a message
_DEEPEST = 50  # brackets within brackets; a programme of cycles within cycles has about ten
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
# YAML 1.1 reads 010 as octal and 1:30 in base 60: a crosshead would move to another place than a person has written
_DECIMAL = re.compile(r"[-+]?(?=\.?[0-9])(0|[1-9][0-9]*)?(\.[0-9]*)?(e[-+]?[0-9]+)?|[-+]?\.(inf|nan)", re.I)


class InvalidYamlError(yaml.YAMLError):
    """A text is not YAML, has a key twice, or a value that YAML does not allow; the message is one sentence."""


class _Loader(yaml.SafeLoader):
    """Refuses repeated keys, of which YAML would keep the last, and gives errors of single values their place."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self._depth == _DEEPEST:
            mark = self.get_mark()
            raise InvalidYamlError(f"line {mark.line + 1}: more than {_DEEPEST} brackets or indents within each other")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

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
        hexadecimal, binary, base 60, with underscores), or too deep brackets.

    Examples
    --------
    >>> load_yaml("{window: 24, spacing: 2}")
    {'window': 24, 'spacing': 2}
    >>> load_yaml("{window: 24, window: 32}")
    Traceback (most recent call last):
    fringedic.wording.yaml_text.InvalidYamlError: line 1: the key 'window' is in line 1 already: remove one of them
    """
    try:
        return yaml.load(text, _Loader)
    except InvalidYamlError:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        raise InvalidYamlError(f"{place}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise InvalidYamlError(" ".join(str(error).split())) from error


def _excerpt(value: object) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST_EXCERPT else f"{text[:_LONGEST_EXCERPT]}..."
