"""Node parameters from one declaration: a pydantic model with names, types, defaults, ranges and descriptions.

class FilterParameters(BaseModel):
    window: int = Field(32, ge=8, le=128, description="Width of the window [px].")

parameters = declare(node, FilterParameters)
parameters.value.window
"""

from __future__ import annotations

import enum
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
        fields = type(self.value).model_fields
        return [
            Parameter(change.name, _ros_type(fields[change.name]), _widened(change.value, fields[change.name]))
            if change.name in fields and _fits(change.value, fields[change.name])
            else change
            for change in changes
        ]

    def _changed(self, changes: list[Parameter]) -> ModelT:
        fields = type(self.value).model_fields
        new = {change.name: change.value for change in changes if change.name in fields}
        return _validated(self._node.get_name(), type(self.value), {**_plain(self.value), **new})

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
    plain = _plain(value)
    message.parameters = [
        Parameter(name, _ros_type(field), _widened(plain[name], field)).to_parameter_msg()
        for name, field in type(value).model_fields.items()
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
        Flat model whose fields are bool, int, float, str, enumerations of str, or lists of these; each with a default
        and a description.
    on_change
        Called with the new model after each change.

    Raises
    ------
    ConfigurationError
        The model refuses a value; the message names node, parameter and value.
    """
    raw: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        # declared with any type first: the messages of the model are better than those of the middleware
        start = ParameterDescriptor(description=field.description or "", dynamic_typing=True)
        raw[name] = node.declare_parameter(
            name, _plain_value(field.get_default(call_default_factory=True)), start
        ).value
    value = _validated(node.get_name(), model, raw)
    plain = _plain(value)
    for name, field in model.model_fields.items():
        typed = Parameter(name, _ros_type(field), _widened(plain[name], field))
        node.set_descriptor(name, _descriptor(name, field), typed.to_parameter_msg().value)
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
    """Return the Markdown table of the parameters of a model: name, type, default, range, description."""
    lines = ["| parameter | type | default | range | what |", "|---|---|---|---|---|"]
    for name, field in model.model_fields.items():
        default = _plain_value(field.get_default(call_default_factory=True))
        shown = (
            f'"{default}"'
            if isinstance(default, str)
            else str(default).lower()
            if isinstance(default, bool)
            else str(default)
        )
        kind = _ros_type(field).name.lower().replace("_", " ")
        lines.append(f"| `{name}` | {kind} | `{shown}` | {_range_text(field)} | {field.description or ''} |")
    return "\n".join(lines)


def _validated(node_name: str, model: type[ModelT], values: Mapping[str, Any]) -> ModelT:
    for name, value in values.items():
        field = model.model_fields[name]
        if not _fits(value, field):
            kind = _ros_type(field).name.lower().replace("_", " ")
            raise ConfigurationError(f"{node_name}.{name} = {value!r}: needs a value of type {kind}")
        if not all(math.isfinite(number) for number in _elements(value) if isinstance(number, float)):
            raise ConfigurationError(f"{node_name}.{name} = {value}: must be a finite number")
    try:
        return model.model_validate({name: _widened(value, model.model_fields[name]) for name, value in values.items()})
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
    choices = _choices(_element_type(field)[0])
    if choices:
        return ", ".join(f"`{choice}`" for choice in choices)
    low, high, low_open, high_open = _bounds(field)
    if low != -math.inf and high != math.inf:
        return f"{'over' if low_open else 'from'} {low:g} {'to below' if high_open else 'to'} {high:g}"
    if low != -math.inf:
        return f"{'over' if low_open else 'at least'} {low:g}"
    if high != math.inf:
        return f"{'below' if high_open else 'at most'} {high:g}"
    return ""


def _choices(annotation: Any) -> list[str]:
    if typing.get_origin(annotation) is typing.Literal:
        return [str(choice) for choice in typing.get_args(annotation)]
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return [str(member.value) for member in annotation]
    return []


def _element_type(field: FieldInfo) -> tuple[Any, bool]:
    """Return the type of the elements of a field, and whether the field is a list."""
    annotation: Any = field.annotation
    if typing.get_origin(annotation) in (list, tuple):
        return typing.get_args(annotation)[0], True
    return annotation, False


def _scalar_type(field: FieldInfo) -> type:
    element, _ = _element_type(field)
    return str if _choices(element) else element


def _ros_type(field: FieldInfo) -> Parameter.Type:
    kinds = _ARRAYS if _element_type(field)[1] else _SCALARS
    return kinds[_scalar_type(field)]


def _elements(value: Any) -> list[Any]:
    return [value] if isinstance(value, bool | int | float | str) or value is None else list(value)


def _fits(value: Any, field: FieldInfo) -> bool:
    is_array = _element_type(field)[1]
    scalar = _scalar_type(field)
    accepted = (int, float) if scalar is float else (scalar,)
    if is_array is (isinstance(value, bool | int | float | str) or value is None):
        return False
    return all(
        isinstance(element, accepted) and (scalar is bool or not isinstance(element, bool))
        for element in _elements(value)
    )


def _widened(value: Any, field: FieldInfo) -> Any:
    """Return the value, with whole numbers as floats for a float field."""
    convert = float if _scalar_type(field) is float else lambda element: element
    return [convert(element) for element in _elements(value)] if _element_type(field)[1] else convert(value)


def _plain_value(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, list | tuple):
        return [_plain_value(element) for element in value]
    return value


def _plain(model: BaseModel) -> dict[str, Any]:
    return {name: _plain_value(getattr(model, name)) for name in type(model).model_fields}
