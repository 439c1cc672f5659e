"""Node parameters from one declaration: a pydantic model with names, types, defaults, ranges and descriptions.

class FilterParameters(BaseModel):
    window: int = Field(32, ge=8, le=128, description="Width of the window [px].")

parameters = declare(node, FilterParameters)
parameters.value.window

A model with the settings of a device has the parameters of the chosen source only (`fringedic.settings.parameters`).
"""

from __future__ import annotations

import math
import time
import typing
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fringedic.errors import ConfigurationError
from fringedic.settings.devices import SOURCE, DeviceSettings
from fringedic.settings.parameters import (
    all_parameters,
    choices,
    default_value,
    device_field,
    element_type,
    from_parameters,
    is_text,
    parameter_fields,
    scalar_type,
)
from fringedic_msgs.msg import NodeParameters
from fringedic_ros.qos import LATCHED
from fringedic_ros.stamps import to_msg

ModelT = TypeVar("ModelT", bound=BaseModel)

_SCALARS = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}
_ARRAYS = {
    bool: Parameter.Type.BOOL_ARRAY,
    int: Parameter.Type.INTEGER_ARRAY,
    float: Parameter.Type.DOUBLE_ARRAY,
    str: Parameter.Type.STRING_ARRAY,
}
_INTEGER_LIMIT = 2**63 - 1


class Parameters(Generic[ModelT]):
    """The declared parameters of a node; `value` is the current, validated model."""

    def __init__(self, node: Node, value: ModelT, on_change: Callable[[ModelT], None] | None) -> None:
        self.value = value
        self._node = node
        self._on_change = on_change
        self._publisher = node.create_publisher(NodeParameters, "node_parameters", LATCHED)
        node.add_pre_set_parameters_callback(self._to_declared_types)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._accept)
        self._publish()

    def _to_declared_types(self, changes: list[Parameter]) -> list[Parameter]:
        fields = _fields_of(self.value)
        return [
            Parameter(change.name, _ros_type(fields[change.name]), _widened(change.value, fields[change.name]))
            if change.name in fields and _fits(change.value, fields[change.name])
            else change
            for change in changes
        ]

    def _changed(self, changes: list[Parameter]) -> ModelT:
        fields = _fields_of(self.value)
        new = {change.name: change.value for change in changes if change.name in fields}
        return _validated(self._node.get_name(), type(self.value), fields, {**all_parameters(self.value), **new})

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._changed(changes)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, changes: list[Parameter]) -> None:
        value = self._changed(changes)
        if value != self.value:
            self.value = value
            self._publish()
            if self._on_change is not None:
                self._on_change(value)

    def _publish(self) -> None:
        self._publisher.publish(parameters_message(self._node.get_name(), self.value))


def parameters_message(node: str, value: BaseModel) -> NodeParameters:
    """Return the message with the parameters of a node, from the model that declares them."""
    message = NodeParameters(node=node)
    message.header.stamp = to_msg(time.time_ns())
    fields = _fields_of(value)
    message.parameters = [
        Parameter(name, _ros_type(fields[name]), _widened(each, fields[name])).to_parameter_msg()
        for name, each in all_parameters(value).items()
    ]
    return message


def declare(node: Node, model: type[ModelT], on_change: Callable[[ModelT], None] | None = None) -> Parameters[ModelT]:
    """Declare every field of a model as a parameter and keep a validated model of their values.

    Values come from the command line, from a parameter file, or from the default of the field. Whole numbers are
    accepted for floats. A later change is refused with a reason unless the model accepts it; NaN and infinity are never
    accepted. The node publishes all values on `node_parameters` (latched) now and after every change.

    Parameters
    ----------
    node
        Owner of the parameters; it calls this function once.
    model
        Model whose fields have a default and a description: bool, int, float, str, enumerations of str, or lists of
        these, the settings of one device, or others that are parameters as one line of YAML.
    on_change
        Called with the new model after each change.

    Raises
    ------
    ConfigurationError
        The model refuses a value; the message names node, parameter and value.
    """
    device = _device(node, model)
    fields = parameter_fields(model, device)
    raw: dict[str, Any] = {}
    for name, field in fields.items():
        if not node.has_parameter(name):
            # declared with any type first: the messages of the model are better than those of the middleware
            start = ParameterDescriptor(description=field.description or "", dynamic_typing=True)
            node.declare_parameter(name, default_value(field), start)
        raw[name] = node.get_parameter(name).value
    value = _validated(node.get_name(), model, fields, raw)
    plain = all_parameters(value)
    for name, field in fields.items():
        typed = Parameter(name, _ros_type(field), _widened(plain[name], field))
        descriptor = _descriptor(name, field)
        # the source of a device selects which parameters the node has, so it stays as it is
        descriptor.read_only = name == SOURCE and device is not None
        node.set_descriptor(name, descriptor, typed.to_parameter_msg().value)
    return Parameters(node, value, on_change)


def report_unknown_parameters(node: Node) -> None:
    """Log the parameters of the command line and of parameter files that a node does not have.

    Parameters
    ----------
    node
        Complete, so that all of its parameters are declared.
    """
    with node.handle:
        given = node.handle.get_parameters(Parameter)
    unknown = sorted(name for name in given if not node.has_parameter(name))
    if unknown:
        known = sorted(name for name in node.get_parameters_by_prefix("") if not name.startswith("qos_overrides."))
        node.get_logger().warning(
            f"{node.get_name()} has no parameter {', '.join(unknown)}, which is ignored; it has {', '.join(known)}"
        )


def parameter_table(model: type[BaseModel]) -> str:
    """Return the Markdown table of the parameters of a model: name, type, default, range, description.

    Of the settings of a device, the table of all sources is followed by one for each source of the project.
    """
    found = device_field(model)
    if found is None:
        return _table(model.model_fields)
    name, devices = found
    source = model.model_fields[name].default.source
    common = {**parameter_fields(model, devices.base)}
    shown = [_table(common, {SOURCE: (source, ", ".join(f"`{each}`" for each in devices.own))})]
    for each, kind in devices.own.items():
        base = devices.base.model_fields
        fields = {
            key: field
            for key, field in kind.model_fields.items()
            if key != SOURCE and (key not in base or field.default != base[key].default)
        }
        if fields:
            sentence = (kind.__doc__ or "").partition("\n")[0]
            shown += [f"Source `{each}`: {sentence[:1].lower()}{sentence[1:]}", _table(fields)]
    return "\n\n".join(shown)


def _table(fields: Mapping[str, FieldInfo], replaced: Mapping[str, tuple[str, str]] | None = None) -> str:
    """Return the table of fields; `replaced` has default and range of those that a type does not contain."""
    lines = ["| parameter | type | default | range | what |", "|---|---|---|---|---|"]
    for name, field in fields.items():
        default, limits = (replaced or {}).get(name) or (default_value(field), _range_text(field))
        shown = (
            f'"{default}"'
            if isinstance(default, str)
            else str(default).lower()
            if isinstance(default, bool)
            else str(default)
        )
        kind = f"{_kind(field)} (YAML)" if is_text(field) else _kind(field)
        lines.append(f"| `{name}` | {kind} | `{shown}` | {limits} | {field.description or ''} |")
    return "\n".join(lines)


def _device(node: Node, model: type[BaseModel]) -> type[DeviceSettings] | None:
    """Declare the source of the device of a node, and return the settings that it selects; None without a device."""
    found = device_field(model)
    if found is None:
        return None
    name, devices = found
    start = ParameterDescriptor(description="", dynamic_typing=True)
    source = node.declare_parameter(SOURCE, model.model_fields[name].default.source, start).value
    try:
        return devices.model(str(source))
    except ConfigurationError as error:
        raise ConfigurationError(f"{node.get_name()}: {error}") from None


def _fields_of(value: BaseModel) -> dict[str, FieldInfo]:
    """Return the fields that are parameters of a node with these settings."""
    found = device_field(type(value))
    return parameter_fields(type(value), None if found is None else type(getattr(value, found[0])))


def _validated(
    node_name: str, model: type[ModelT], fields: Mapping[str, FieldInfo], values: Mapping[str, Any]
) -> ModelT:
    for name, value in values.items():
        field = fields[name]
        if not _fits(value, field):
            raise ConfigurationError(f"{node_name}.{name} = {value!r}: needs a value of type {_kind(field)}")
        if not all(math.isfinite(number) for number in _elements(value) if isinstance(number, float)):
            raise ConfigurationError(f"{node_name}.{name} = {value}: must be a finite number")
    try:
        return from_parameters(model, {name: _widened(value, fields[name]) for name, value in values.items()})
    except ConfigurationError as error:
        raise ConfigurationError(f"{node_name}: {error}") from None
    except ValidationError as error:
        complaints = []
        for detail in error.errors():
            where = ".".join(str(part) for part in (node_name, *detail["loc"]))
            given = f" = {detail['input']!r}" if detail["loc"] else ""
            complaints.append(f"{where}{given}: {detail['msg'][:1].lower()}{detail['msg'][1:]}")
        raise ConfigurationError("; ".join(complaints)) from None


def _descriptor(name: str, field: FieldInfo) -> ParameterDescriptor:
    kind = _ros_type(field)
    descriptor = ParameterDescriptor(
        name=name, type=kind.value, description=field.description or "", additional_constraints=_range_text(field)
    )
    low, high, _, _ = _bounds(field)
    if (low, high) != (-math.inf, math.inf):
        if kind is Parameter.Type.INTEGER:
            descriptor.integer_range = [
                IntegerRange(
                    from_value=-_INTEGER_LIMIT if low == -math.inf else int(low),
                    to_value=_INTEGER_LIMIT if high == math.inf else int(high),
                    step=1,
                )
            ]
        elif kind is Parameter.Type.DOUBLE:
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    return descriptor


def _bounds(field: FieldInfo) -> tuple[float, float, bool, bool]:
    """Return the lowest and highest value of a field, and whether each is excluded."""
    low, high, low_open, high_open = -math.inf, math.inf, False, False
    for constraint in field.metadata:
        if isinstance(constraint, Ge):
            low = typing.cast(float, constraint.ge)
        elif isinstance(constraint, Gt):
            low, low_open = typing.cast(float, constraint.gt), True
        elif isinstance(constraint, Le):
            high = typing.cast(float, constraint.le)
        elif isinstance(constraint, Lt):
            high, high_open = typing.cast(float, constraint.lt), True
    return low, high, low_open, high_open


def _range_text(field: FieldInfo) -> str:
    values = choices(element_type(field)[0])
    if values:
        return ", ".join(f"`{value}`" if value != "" else "empty" for value in values)
    low, high, low_open, high_open = _bounds(field)
    if low != -math.inf and high != math.inf:
        return f"{'over' if low_open else 'from'} {low:g} {'to below' if high_open else 'to'} {high:g}"
    if low != -math.inf:
        return f"{'over' if low_open else 'at least'} {low:g}"
    if high != math.inf:
        return f"{'below' if high_open else 'at most'} {high:g}"
    return ""


def _ros_type(field: FieldInfo) -> Parameter.Type:
    if is_text(field):
        return Parameter.Type.STRING
    kinds = _ARRAYS if element_type(field)[1] else _SCALARS
    return kinds[scalar_type(field)]


def _kind(field: FieldInfo) -> str:
    return _ros_type(field).name.lower().replace("_", " ")


def _elements(value: Any) -> list[Any]:
    return [value] if isinstance(value, bool | int | float | str) or value is None else list(value)


def _fits(value: Any, field: FieldInfo) -> bool:
    is_array = element_type(field)[1] and not is_text(field)
    scalar = str if is_text(field) else scalar_type(field)
    accepted = (int, float) if scalar is float else (scalar,)
    if is_array is (isinstance(value, bool | int | float | str) or value is None):
        return False
    return all(
        isinstance(element, accepted) and (scalar is bool or not isinstance(element, bool))
        for element in _elements(value)
    )


def _widened(value: Any, field: FieldInfo) -> Any:
    """Return the value, with whole numbers as floats for a float field."""
    convert = float if scalar_type(field) is float else lambda element: element
    is_array = element_type(field)[1] and not is_text(field)
    return [convert(element) for element in _elements(value)] if is_array else convert(value)
