"""YAML files of sections with known keys, and messages about wrong keys."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from fringedic.errors import ConfigurationError
from fringedic.settings.base import FILE, FOLDER, Settings
from fringedic.settings.devices import UNKNOWN_KEY
from fringedic.wording.causes import cause_of
from fringedic.wording.yaml_text import load_yaml

Model = TypeVar("Model", bound=BaseModel)
# Names of the members of unions in paths of pydantic, which are not keys of the file
_LONGEST_LIST = 400  # characters of a list of problems; the rest is counted
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_MEMBERS = ("a name", "a file", "a section", "a step", "a ramp", "a cycle")


class Section(Settings):
    """Base of the sections that are no settings of a device or a node."""


def load_sections(path: Path, model: type[Model], replaced: Mapping[str, str] | None = None) -> Model:
    """Read and check a file.

    Parameters
    ----------
    path
        A YAML file.
    model
        Its sections.
    replaced
        Paths of keys of earlier versions, and the end of the sentence that says what to write instead.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or a key is unknown, missing, replaced or out of its range; the message names file and
        key.
    """
    return validate(model, read_sections(path, model), str(path), replaced, folder=path.parent)


def read_sections(path: Path, model: type[BaseModel]) -> dict[str, Any]:
    """Return the content of a file of sections, unchecked.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or contains no sections.
    """
    try:
        content = load_yaml(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {cause_of(error)}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: is not YAML: {error}") from error
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}: is empty or has no 'key: value'; keys are {_keys(model)}")
    return content


def validate(
    model: type[Model],
    content: Mapping[str, Any],
    source: str,
    replaced: Mapping[str, str] | None = None,
    *,
    folder: Path | None = None,
) -> Model:
    """Return checked sections; the error names `source`, the key and what is allowed, in one sentence.

    Parameters
    ----------
    model, content, source, replaced
        The sections, what they contain, where it is written, and keys of earlier versions, as of `load_sections`.
    folder
        Paths in the sections are relative to it; by default to the working directory.

    Raises
    ------
    ConfigurationError
        A key is unknown, missing, replaced or out of its range.
    """
    try:
        return model.model_validate(content, context={FILE: source, FOLDER: folder})
    except ValidationError as error:
        problems = [_problem(model, each, replaced or {}) for each in error.errors()]
        raise ConfigurationError(f"{source}: {_listed(problems)}") from error


def _problem(model: type[BaseModel], error: Mapping[str, Any], replaced: Mapping[str, str]) -> str:
    """Return one sentence about one wrong key: where, what, and what is allowed."""
    place = [part for part in error["loc"] if part not in _MEMBERS]
    name = ".".join(map(str, place)) or "file"
    if error["type"] == "extra_forbidden" and name in replaced:
        return f"{name} {replaced[name]}"
    if error["type"] == "extra_forbidden":
        return f"{name}: unknown key; known are {_keys(_section_at(model, place[:-1]))}"
    if error["type"] == "missing":
        return f"{name}: is missing"
    if isinstance(error["input"], str) and _DECIMAL_COMMA.fullmatch(error["input"].strip()):
        return f"{name}: write {error['input'].strip().replace(',', '.')} with a decimal point"
    words = f"{name}: {error['msg'].removeprefix('Value error, ')}"
    is_value = error["type"] != UNKNOWN_KEY and not isinstance(error["input"], dict)
    return f"{words} (it is {reprlib.repr(error['input'])})" if is_value else words


def _listed(problems: Sequence[str]) -> str:
    """Return the first problems, and the number of those that would make the message too long."""
    words, *others = problems
    for number, each in enumerate(others):
        if len(words) + len(each) > _LONGEST_LIST:
            return f"{words}; and {len(others) - number} more"
        words = f"{words}; {each}"
    return words


def _section_at(model: type[BaseModel], place: Sequence[str | int]) -> type[BaseModel]:
    """Return the section that a key path leads to."""
    for position, part in enumerate(place):
        if isinstance(part, str):
            found = _sections_in(model.model_fields[part].annotation)
            # of several that an entry of a list can be, the one that has the next key
            following = next((each for each in place[position + 1 :] if isinstance(each, str)), None)
            fitting = [each for each in found if following in each.model_fields]
            model = next(iter(fitting or found), model)
    return model


def _sections_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    inner = [_sections_in(argument) for argument in getattr(annotation, "__args__", ())]
    return [section for sections in inner for section in sections]


def _keys(model: type[BaseModel]) -> str:
    return ", ".join(model.model_fields)
