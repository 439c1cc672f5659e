"""Options of the procedures that an operator may start: types, limits and defaults are those of the commands."""

from __future__ import annotations

from functools import cache
from inspect import signature
from typing import Any, get_args

from pydantic import Field, create_model

from fringedic.command.main import app
from fringedic.command.plugins import load_commands
from fringedic.configuration.test_form import Answers
from fringedic.configuration.yaml_section import Section


class TestOptions(Section):
    """The answers of the form of a test, by the names of its fields."""

    __test__ = False  # not one of pytest

    test: Answers = Field({}, description="Answers by the names of the fields.")


class RunOptions(TestOptions):
    """Also of ``fringedic run``: the folder of a run that ended early, by its name; empty: a new run."""

    continue_run: str = ""


@cache
def options_of(command: str, names: tuple[str, ...]) -> type[Section]:
    """Return these options of a subcommand of ``fringedic``, by the names of its parameters."""
    load_commands()
    callbacks = {each.callback.__name__: each.callback for each in app.registered_commands if each.callback}
    declared = signature(callbacks[command], eval_str=True).parameters
    fields: dict[str, Any] = {}
    for name in names:
        kind, option = get_args(declared[name].annotation)
        fields[name] = kind, Field(declared[name].default, ge=option.min, le=option.max)
    return create_model(f"options of {command}", __base__=Section, **fields)
