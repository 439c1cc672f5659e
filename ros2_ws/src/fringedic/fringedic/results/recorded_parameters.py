"""Parameters of the nodes as a recording tells them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError

from fringedic.chain import CouplingParameters, DicParameters, Parameters, PhaseParameters
from fringedic.errors import ParameterError
from fringedic.facts import Facts
from fringedic.results.rows import Settings
from fringedic.rig import RigModel

FACTS = "facts"


class RecordedParameters:
    """Parameters of the processing nodes as recorded, with overrides on top; others for the record."""

    def __init__(self, overrides: Mapping[str, Any]) -> None:
        self.phase = PhaseParameters()
        self.dic = DicParameters()
        self.coupling = CouplingParameters()
        self._overrides: dict[str, dict[str, Any]] = {"phase": {}, "dic": {}, "coupling": {}}
        self._others: dict[str, dict[str, Any]] = {}
        self._facts: Facts | None = None
        for name, value in overrides.items():
            node, _, parameter = name.partition(".")
            if node not in self._overrides or parameter not in type(getattr(self, node)).model_fields:
                known = ", ".join(f"{each}.{key}" for each in self._overrides for key in self._model(each).model_fields)
                raise ParameterError(f"there is no parameter '{name}'; known are {known}")
            self._overrides[node][parameter] = value
        for node in self._overrides:
            self._set(node, {})

    def settings(self, calibration: RigModel | None) -> Settings:
        """Return everything that the next step is measured with."""
        processing: dict[str, Parameters] = {"phase": self.phase, "dic": self.dic, "coupling": self.coupling}
        return Settings(processing, calibration, self._others, self._facts)

    def take(self, message: Any) -> None:
        """Take what one node published about its parameters; those that this version does not know are left out."""
        recorded = {each.name: _value(each.value) for each in message.parameters}
        if message.node in self._overrides:
            known = self._model(message.node).model_fields
            self._set(message.node, {name: value for name, value in recorded.items() if name in known})
            return
        text = recorded.pop(FACTS, "")
        if text:
            self._facts = Facts.from_text(text)
        self._others[message.node] = recorded

    def _model(self, node: str) -> type[Parameters]:
        return type(getattr(self, node))

    def _set(self, node: str, recorded: Mapping[str, Any]) -> None:
        try:
            setattr(self, node, self._model(node)(**{**recorded, **self._overrides[node]}))
        except ValidationError as error:
            problems = "; ".join(
                f"{node}.{each['loc'][0]} = {each['input']!r}: {each['msg']}" for each in error.errors()
            )
            raise ParameterError(problems) from error


def _value(value: Any) -> Any:
    """Value of an ``rcl_interfaces/ParameterValue``."""
    kinds = ("", "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array", "double_array")
    content = getattr(value, f"{(*kinds, 'string_array')[value.type]}_value")
    return content.tolist() if isinstance(content, np.ndarray) else content


def recorded_facts(messages: Iterable[Any]) -> Facts:
    """Return specimen and hardware from what the nodes published about their parameters."""
    facts = Facts()
    for message in messages:
        for each in message.parameters:
            if each.name == FACTS and each.value.string_value:
                facts = Facts.from_text(each.value.string_value)
    return facts
