"""Parameters of the nodes as recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from fringedic.errors import ConfigurationError
from fringedic.metadata import Metadata, SpecimenMetadata
from fringedic.rig.model import RigModel
from fringedic.steps.parameters import CouplingParameters, DicParameters, Parameters, PhaseParameters

METADATA_PARAMETER = "metadata"
_OLD_METADATA_PARAMETER = "facts"  # in recordings of earlier versions
SPECIMEN = "specimen"
_DIGITS = 9  # of a converted value, which does not show the rounding of its conversion
MODELS: dict[str, type[Parameters]] = {"phase": PhaseParameters, "dic": DicParameters, "coupling": CouplingParameters}


def _renamed(name: str, scale: float | None = None) -> Callable[[Any], dict[str, Any]]:
    """Return the conversion of a parameter that has another name, and with a scale another unit."""

    def scaled(value: Any) -> Any:
        if scale is None:
            return value
        return [scaled(each) for each in value] if isinstance(value, list) else round(scale * value, _DIGITS)

    return lambda value: {name: scaled(value)}


def _part_of_the_sensor(region: Sequence[int]) -> dict[str, Any]:
    return dict(zip(("first_column", "first_row", "width", "height"), region, strict=False))


# By node and name of earlier versions: the parameters that replace it
_REPLACED: dict[str, dict[str, Callable[[Any], dict[str, Any]]]] = {
    "camera": {
        "exposure_time_s": _renamed("exposure_ms", 1e3),
        "settle_time_s": _renamed("settle_ms", 1e3),
        "region_px": _part_of_the_sensor,
    },
    "coupling": {"watch_region_px": _renamed("drift_marker_px")},
    "experiment": {
        "exposure_times_s": _renamed("exposures_ms", 1e3),
        _OLD_METADATA_PARAMETER: _renamed(METADATA_PARAMETER),
    },
    "extensometer": {"pad_px": _renamed("subset_px"), "largest_sigma": _renamed("largest_sigma_ustrain", 1e6)},
    "load_frame": {"machine_file": _renamed("file")},
    "projector": {
        "screen": _renamed("source"),
        "width_px": _renamed("width"),
        "height_px": _renamed("height"),
        "response_file": _renamed("response_curve"),
    },
    "recorder": {"split_s": _renamed("split_minutes", 1 / 60)},
}


def present_parameters(node: str, recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Return recorded parameters of a node with the names and units of this version.

    Examples
    --------
    >>> present_parameters("camera", {"exposure_time_s": 0.012, "region_px": [0, 64, 1280, 960]})
    {'exposure_ms': 12.0, 'first_column': 0, 'first_row': 64, 'width': 1280, 'height': 960}
    """
    replaced = _REPLACED.get(node, {})
    present: dict[str, Any] = {}
    for name, value in recorded.items():
        present |= replaced[name](value) if name in replaced else {name: value}
    return present


def present_name(node: str, recorded: str) -> str | None:
    """Return the present name of a recorded parameter of a processing node; None if this version does not have it.

    Examples
    --------
    >>> present_name("coupling", "watch_region_px"), present_name("dic", "colour")
    ('drift_marker_px', None)
    """
    [name] = present_parameters(node, {recorded: None})
    return name if name in MODELS[node].model_fields else None


@dataclass(frozen=True)
class StepSettings:
    """What a step was measured with.

    Attributes
    ----------
    parameters
        Of the processing nodes, by node.
    calibration
        Of the rig; None before it is known.
    rig
        Recorded parameters of the other nodes, by node.
    metadata
        Specimen and hardware as entered; None when not recorded.
    """

    parameters: dict[str, Parameters]
    calibration: RigModel | None
    rig: dict[str, dict[str, Any]]
    metadata: Metadata | None

    @property
    def spacing(self) -> int:
        """Distance of the displacement's points [px]."""
        dic = self.parameters["dic"]
        assert isinstance(dic, DicParameters)
        return dic.spacing


class RecordedParameters:
    """Recorded parameters of the processing nodes with overrides, and those of the other nodes.

    Parameters
    ----------
    overrides
        Values that replace recorded ones, ``{"dic.window": 24, "specimen.force_sign": -1}``.

    Raises
    ------
    ConfigurationError
        An override is unknown or not allowed.
    """

    def __init__(self, overrides: Mapping[str, Any]) -> None:
        self.phase = PhaseParameters()
        self.dic = DicParameters()
        self.coupling = CouplingParameters()
        self._overrides: dict[str, dict[str, Any]] = {"phase": {}, "dic": {}, "coupling": {}}
        self._others: dict[str, dict[str, Any]] = {}
        self._of_specimen = of_specimen(overrides)
        self._metadata = with_specimen(Metadata(), self._of_specimen) if self._of_specimen else None
        for name, value in overrides.items():
            node, _, parameter = name.partition(".")
            if node == SPECIMEN:
                continue
            if node not in self._overrides or parameter not in type(getattr(self, node)).model_fields:
                raise ConfigurationError(f"there is no parameter '{name}'; {self._known(node)}")
            self._overrides[node][parameter] = value
        for node in self._overrides:
            self._set(node, {})

    def _known(self, node: str) -> str:
        if node not in self._overrides:
            return f"give one of {', '.join([*self._overrides, SPECIMEN])}, such as dic.window"
        return f"known are {', '.join(f'{node}.{key}' for key in self._model(node).model_fields)}"

    def settings(self, calibration: RigModel | None) -> StepSettings:
        """Return everything that the next step is measured with."""
        processing: dict[str, Parameters] = {"phase": self.phase, "dic": self.dic, "coupling": self.coupling}
        return StepSettings(processing, calibration, self._others, self._metadata)

    def take(self, message: Any) -> None:
        """Take the published parameters of one node; parameters that this version does not have are left out."""
        recorded = present_parameters(message.node, parameter_values(message))
        if message.node in self._overrides:
            known = self._model(message.node).model_fields
            self._set(message.node, {name: value for name, value in recorded.items() if name in known})
            return
        text = recorded.pop(METADATA_PARAMETER, "")
        if text:
            self._metadata = with_specimen(Metadata.from_text(text), self._of_specimen)
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
            raise ConfigurationError(problems) from error


def parameter_values(message: Any) -> dict[str, Any]:
    """Return the values in a ``fringedic_msgs/NodeParameters`` by their names, as recorded."""
    return {each.name: _value(each.value) for each in message.parameters}


def _value(value: Any) -> Any:
    """Return the value of an ``rcl_interfaces/ParameterValue``."""
    kinds = ("", "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array", "double_array")
    content = getattr(value, f"{(*kinds, 'string_array')[value.type]}_value")
    return content.tolist() if isinstance(content, np.ndarray) else content


def of_specimen(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return the overrides of the specimen by the name of the entry.

    Examples
    --------
    >>> of_specimen({"dic.window": 24, "specimen.force_sign": -1})
    {'force_sign': -1}
    """
    named = {name.partition("."): value for name, value in overrides.items()}
    return {parameter: value for (node, _, parameter), value in named.items() if node == SPECIMEN}


def with_specimen(metadata: Metadata, entries: Mapping[str, Any]) -> Metadata:
    """Return metadata with other entries of the specimen.

    Raises
    ------
    ConfigurationError
        An entry is unknown or not allowed.
    """
    try:
        specimen = SpecimenMetadata.model_validate({**metadata.specimen.model_dump(), **entries})
    except ValidationError as error:
        problems = "; ".join(f"{SPECIMEN}.{each['loc'][0]}: {each['msg']}" for each in error.errors())
        raise ConfigurationError(f"{problems}; known are {', '.join(SpecimenMetadata.model_fields)}") from error
    return metadata.model_copy(update={SPECIMEN: specimen})


def recorded_metadata(messages: Iterable[Any]) -> Metadata:
    """Return the metadata of specimen and hardware from the published parameters of the nodes."""
    metadata = Metadata()
    for message in messages:
        for each in message.parameters:
            if each.name in (METADATA_PARAMETER, _OLD_METADATA_PARAMETER) and each.value.string_value:
                metadata = Metadata.from_text(each.value.string_value)
    return metadata
