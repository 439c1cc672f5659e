"""Settings as the parameters of a node: flat, with values that a ROS parameter can hold.

A field whose value no ROS parameter can hold, such as a mapping, is one line of YAML in its parameter; this is the only
place that converts it. The settings of a device are parameters of its node, by the names that they have in a rig file.
A node has the parameters of the chosen source only, so that sources of different packages may use one name for
different things.
"""

from __future__ import annotations

import enum
import typing
from collections.abc import Mapping
from copy import copy
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from fringedic.errors import ConfigurationError
from fringedic.frames.region import Region
from fringedic.metadata import Metadata
from fringedic.settings.devices import SOURCE, Devices, DeviceSettings, source_of
from fringedic.wording.yaml_text import load_yaml

ModelT = TypeVar("ModelT", bound=BaseModel)
_SCALARS = (bool, int, float, str)


def device_field(model: type[BaseModel]) -> tuple[str, Devices[Any]] | None:
    """Return the name of the field with the settings of a device, and the kinds of the device; None without one."""
    for name, field in model.model_fields.items():
        for each in field.metadata:
            if isinstance(each, Devices):
                return name, each
    return None


def parameter_fields(model: type[BaseModel], device: type[DeviceSettings] | None = None) -> dict[str, FieldInfo]:
    """Return the fields that are parameters of a node, by name.

    Parameters
    ----------
    model
        Settings of the node.
    device
        Settings of its device; by default those of the default source.
    """
    found = device_field(model)
    if found is None:
        return dict(model.model_fields)
    name, devices = found
    fields: dict[str, FieldInfo] = {}
    for own, field in model.model_fields.items():
        if own == name:
            fields |= _fields_of_device(model, device or type(field.default))
            fields[SOURCE] = copy(fields[SOURCE])
            fields[SOURCE].description = devices.base.model_fields[SOURCE].description
        else:
            fields[own] = field
    return fields


def to_parameters(settings: BaseModel) -> dict[str, Any]:
    """Return settings as parameters, without empty lists, which have no type in a parameter file.

    Examples
    --------
    >>> from fringedic.settings.camera import CameraNodeSettings, FilesCamera
    >>> parameters = to_parameters(CameraNodeSettings(device=FilesCamera(files="images")))
    >>> parameters["source"], parameters["files"], parameters["virtual_rig"]
    ('files', 'images', '{preset: plate}')
    """
    return {name: value for name, value in all_parameters(settings).items() if value != []}


def all_parameters(settings: BaseModel) -> dict[str, Any]:
    """Return all settings as parameters."""
    found = device_field(type(settings))
    parameters: dict[str, Any] = {}
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if found is not None and name == found[0]:
            of_device = all_parameters(value)
            parameters |= {each: of_device[each] for each in _fields_of_device(type(settings), type(value))}
        else:
            parameters[name] = parameter_value(field, value)
    return parameters


def default_parameters(settings: BaseModel) -> dict[str, Any]:
    """Return the parameters of a node with these settings, with their default values."""
    found = device_field(type(settings))
    device = None if found is None else type(getattr(settings, found[0]))
    fields = parameter_fields(type(settings), device)
    return {name: default_value(field) for name, field in fields.items()}


def from_parameters(model: type[ModelT], parameters: Mapping[str, Any]) -> ModelT:
    """Return the settings that parameters contain.

    Raises
    ------
    ConfigurationError
        A text is not YAML.
    pydantic.ValidationError
        A value is refused; its place is the name of the parameter.

    Examples
    --------
    >>> from fringedic.settings.camera import CameraNodeSettings
    >>> settings = from_parameters(CameraNodeSettings, {"source": "files", "files": "images", "frame_rate_hz": 2.0})
    >>> settings.device.files, settings.frame_rate_hz
    ('images', 2.0)
    """
    found = device_field(model)
    if found is None:
        return model.model_validate(_field_values(model.model_fields, parameters))
    name, devices = found
    source = parameters.get(SOURCE, model.model_fields[name].default.source)
    kind = devices.model(source)
    own = {each: value for each, value in parameters.items() if each in model.model_fields and each != name}
    device = {each: value for each, value in parameters.items() if each not in own} | {SOURCE: source}
    values = {**_field_values(model.model_fields, own), name: _field_values(kind.model_fields, device)}
    try:
        return model.model_validate(values)
    except ValidationError as error:
        lines = [
            {**each, "loc": each["loc"][1:] if each["loc"][:1] == (name,) else each["loc"]} for each in _lines(error)
        ]
        raise ValidationError.from_exception_data(error.title, typing.cast(Any, lines)) from None


def default_value(field: FieldInfo) -> Any:
    """Return the default value of a field as a ROS parameter can hold it."""
    return parameter_value(field, field.get_default(call_default_factory=True))


def parameter_value(field: FieldInfo, value: Any) -> Any:
    """Return the value of a field as a ROS parameter can hold it."""
    if is_text(field):
        return "" if value is None else to_text(value)
    return plain_value(value)


def is_text(field: FieldInfo) -> bool:
    """Whether no ROS parameter can hold the value of a field, so that it is one line of YAML."""
    return scalar_type(field) not in _SCALARS


def to_text(value: Any) -> str:
    """Return a structured value as one line of YAML; empty without entries."""
    if isinstance(value, Region | Metadata):
        return value.to_text()
    plain = value.model_dump(mode="json", exclude_defaults=True) if isinstance(value, BaseModel) else value
    return yaml.safe_dump(plain, default_flow_style=True, allow_unicode=True, width=10**9).strip() if plain else ""


def plain_value(value: Any) -> Any:
    """Return a value with enumerations as their texts, and tuples as lists."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, list | tuple):
        return [plain_value(element) for element in value]
    return value


def choices(annotation: Any) -> list[Any]:
    """Return the values of a literal or an enumeration; empty for another type."""
    if typing.get_origin(annotation) is typing.Literal:
        return list(typing.get_args(annotation))
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return [member.value for member in annotation]
    return []


def element_type(field: FieldInfo) -> tuple[Any, bool]:
    """Return the type of the elements of a field, and whether the field is a list."""
    annotation: Any = field.annotation
    if typing.get_origin(annotation) in (list, tuple):
        element = typing.get_args(annotation)[0]
        return (typing.get_args(element)[0] if typing.get_origin(element) is typing.Annotated else element), True
    return annotation, False


def scalar_type(field: FieldInfo) -> Any:
    """Return the type of a field, or of the elements of a list, with the type of the values of a choice."""
    element, _ = element_type(field)
    return type(values[0]) if (values := choices(element)) else element


def _fields_of_device(model: type[BaseModel], device: type[DeviceSettings]) -> dict[str, FieldInfo]:
    """Return the fields of a device that are parameters of its node, whose settings are `model`."""
    fields = {name: field for name, field in device.model_fields.items() if name not in device.of_another_node}
    if taken := sorted(fields.keys() & model.model_fields.keys()):
        raise ConfigurationError(
            f"source {source_of(device)}: {', '.join(taken)} of {device.__module__}.{device.__name__} is the name of a "
            "parameter that the node has for every device; rename it"
        )
    return fields


def _field_values(fields: Mapping[str, FieldInfo], parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return values as the fields of a model take them."""
    values = dict(parameters)
    for name, value in parameters.items():
        if name in fields and is_text(fields[name]) and isinstance(value, str):
            try:
                values[name] = load_yaml(value) if value else None
            except yaml.YAMLError as error:
                raise ConfigurationError(f"{name} is not valid YAML: {error}") from error
    return values


def _lines(error: ValidationError) -> list[dict[str, Any]]:
    """Return the errors in the form from which an error can be made again."""
    return [
        {
            "type": PydanticCustomError("setting", "{sentence}", {"sentence": each["msg"]}),
            "loc": each["loc"],
            "input": each["input"],
        }
        for each in error.errors()
    ]
