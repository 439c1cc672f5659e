"""YAML text that people edit: a key may be there once only, and the message about a wrong value has its line."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import yaml

_LONGEST_EXCERPT = 40  # characters of a wrong value in a message
_DEEPEST = 50  # brackets within brackets; a programme of cycles within cycles has about ten


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

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        places: dict[tuple[str, str], yaml.Mark] = {}
        for key, _ in node.value:
            name = (key.tag, str(key.value))
            if name in places:
                raise InvalidYamlError(
                    f"line {key.start_mark.line + 1}: the key '{_excerpt(key.value)}' is in line "
                    f"{places[name].line + 1} already: remove one of them"
                )
            places[name] = key.start_mark
        return super().construct_mapping(node, deep)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError) as error:  # an impossible date, or a number of too many digits
            raise InvalidYamlError(
                f"line {node.start_mark.line + 1}: {_excerpt(node.value)} is no valid value: "
                f"{str(error).partition(';')[0]}"
            ) from error


def load_yaml(text: str) -> Any:
    """Return the content of a YAML text: mappings, lists, text, numbers, dates, None.

    Parameters
    ----------
    text
        One YAML document of plain types.

    Raises
    ------
    InvalidYamlError
        The text is not YAML, has a key twice, a value that YAML does not allow, or too deep brackets.

    Examples
    --------
    >>> load_yaml("{window: 24, spacing: 2}")
    {'window': 24, 'spacing': 2}
    >>> load_yaml("{window: 24, window: 32}")
    Traceback (most recent call last):
    fringedic.inputs.yaml_text.InvalidYamlError: line 1: the key 'window' is in line 1 already: remove one of them
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
