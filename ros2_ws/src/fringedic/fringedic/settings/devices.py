"""Kinds of a device: one model of settings for each source, of the project or of an installed package."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Generic, Self, TypeVar

from pydantic import Field, GetCoreSchemaHandler, ValidationError, ValidationInfo, model_validator
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from fringedic.errors import ConfigurationError
from fringedic.settings.base import Settings

SOURCE = "source"
LEAST_SIZE = 16  # of an image [px]
UNKNOWN_KEY = "unknown_key"  # type of an error of a validation


class DeviceSettings(Settings):
    """Settings of one kind of a device; `source` is its name.

    Attributes
    ----------
    driver
        Callable that opens the device, as ``package.module:name``; it is imported when the device is opened. It is
        called with the settings and the node.
    elsewhere
        Where a user finds settings that this kind does not have.
    of_another_node
        Fields of the section of the rig file that are no parameters of the node of the device.
    """

    driver: ClassVar[str] = ""
    elsewhere: ClassVar[str] = "it has only the settings of its own driver"
    of_another_node: ClassVar[frozenset[str]] = frozenset()

    source: str = Field(description="Kind of the device.")

    def open(self, node: Any = None) -> Any:
        """Open the device.

        Parameters
        ----------
        node
            The node of the device.

        Raises
        ------
        ConfigurationError
            The driver cannot be imported.
        FringedicError
            The device cannot be opened, or does not accept a setting.
        """
        module, _, name = self.driver.partition(":")
        try:
            driver = getattr(importlib.import_module(module), name)
        except Exception as error:  # code of another package may raise anything
            raise ConfigurationError(
                f"source {self.source}: its driver {self.driver} cannot be imported ({_words(error)}); repair or "
                "reinstall its package"
            ) from error
        return driver(self, node)


class ImageDeviceSettings(DeviceSettings):
    """Settings of one kind of a device that takes or shows images."""

    width: int = Field(0, ge=0, le=32768, description="Image width [px]; 0: the whole width of the device.")
    height: int = Field(0, ge=0, le=32768, description="Image height [px]; 0: the whole height of the device.")

    @model_validator(mode="after")
    def _size_is_possible(self) -> Self:
        for name, size in (("width", self.width), ("height", self.height)):
            if 0 < size < LEAST_SIZE:
                raise ValueError(f"{name} is {size}; at least {LEAST_SIZE} px are needed")
        return self

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the images [px]; None: those of the device."""
        return (self.width, self.height) if self.width and self.height else None


DeviceT = TypeVar("DeviceT", bound=DeviceSettings)


class Devices(Generic[DeviceT]):
    """All kinds of a device: those of the project, and those of installed packages.

    Written into an annotation, it makes a field a union of all kinds that `source` discriminates::

        Camera = Annotated[SerializeAsAny[CameraSettings], CAMERAS]

    Parameters
    ----------
    group
        Group of the entry points of other packages: the name of an entry point is the source, its object the model.
    base
        Base class of the models.
    own
        Models of the project.
    default
        Source when none is given; None: it has to be given.
    """

    def __init__(
        self, group: str, base: type[DeviceT], own: Sequence[type[DeviceT]], default: str | None = None
    ) -> None:
        self.group = group
        self.base = base
        self.own = {source_of(model): model for model in own}
        self.default = default

    @property
    def sources(self) -> list[str]:
        """Names of all kinds."""
        return list(dict.fromkeys([*self.own, *(each.name for each in installed_sources(self.group))]))

    def model(self, source: str) -> type[DeviceT]:
        """Return the model of a source.

        Raises
        ------
        ConfigurationError
            There is no such source, two packages have it, or its package cannot be used.
        """
        found = [each for each in installed_sources(self.group) if each.name == source]
        packages = ["fringedic"] * (source in self.own) + [_package(each) for each in found]
        if len(packages) > 1:
            raise ConfigurationError(
                f"source {source} is that of the packages {' and '.join(packages)}; rename it in {packages[-1]}, or "
                "uninstall this package"
            )
        if not packages:
            raise ConfigurationError(f"source {source!r} is unknown; known are {', '.join(self.sources)}")
        return self.own[source] if source in self.own else self._load(found[0])

    def _load(self, entry: EntryPoint) -> type[DeviceT]:
        """Return the model of an installed package."""
        package = _package(entry)
        try:
            model = entry.load()
        except Exception as error:  # code of another package may raise anything
            raise ConfigurationError(
                f"source {entry.name}: the package {package} cannot be imported ({_words(error)}); repair or reinstall "
                "it, or use another source"
            ) from error
        if not (isinstance(model, type) and issubclass(model, self.base)):
            raise ConfigurationError(
                f"source {entry.name}: {entry.value} of the package {package} is no {self.base.__name__}; let its "
                "entry point name the model of the settings"
            )
        if source_of(model) != entry.name:
            raise ConfigurationError(
                f"source {entry.name}: {entry.value} of the package {package} has the source {source_of(model)!r}; "
                "give its entry point the same name"
            )
        return model

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a field with this annotation."""
        return core_schema.with_info_before_validator_function(self._validate, handler(source))

    def _validate(self, values: Any, info: ValidationInfo) -> Any:
        """Return the settings of the source that the values name."""
        if not isinstance(values, Mapping):
            return values
        source = values.get(SOURCE, self.default)
        if source is None:
            raise _error(self.base, "missing", SOURCE, values)
        try:
            model = self.model(source) if isinstance(source, str) else None
        except ConfigurationError as error:
            raise ValueError(str(error)) from None
        if model is None:
            raise _error(self.base, "string_type", SOURCE, source)
        return model.model_validate(self._without_others(model, source, dict(values)), context=info.context)

    def _without_others(self, model: type[DeviceT], source: str, values: dict[str, Any]) -> dict[str, Any]:
        """Return values without the defaults of other sources, which change nothing; refuse their other values."""
        unused = []
        for name in [name for name in values if name not in model.model_fields]:
            others = [each.model_fields[name] for each in self.own.values() if name in each.model_fields]
            if any(values[name] == each.default for each in others):
                del values[name]
            elif others:
                unused.append(name)
            else:
                known = ", ".join(model.model_fields)
                raise _error(
                    model,
                    PydanticCustomError(UNKNOWN_KEY, "unknown key; known are {known}", {"known": known}),
                    name,
                    None,
                )
        if unused:
            them = "it" if len(unused) == 1 else "them"
            raise ValueError(f"source: {source} does not use {', '.join(unused)}; remove {them}: {model.elsewhere}")
        return values


def source_of(model: type[DeviceSettings]) -> str:
    """Return the source of a model."""
    return str(model.model_fields[SOURCE].default)


@cache
def installed_sources(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of the installed packages in a group."""
    return tuple(entry_points(group=group))


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.module


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _error(model: type[Settings], kind: str | PydanticCustomError, name: str, value: Any) -> ValidationError:
    details = InitErrorDetails(type=kind, loc=(name,), input=value)
    return ValidationError.from_exception_data(model.__name__, [details])
