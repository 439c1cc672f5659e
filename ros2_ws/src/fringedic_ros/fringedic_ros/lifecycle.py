"""Hardware nodes are lifecycle nodes that start by themselves."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from fringedic.errors import FringedicError, ProcessError
from fringedic.settings.base import HardwareNodeSettings
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.parameters import declare
from fringedic_ros.rig_node import RigLifecycleNode

ParametersT = TypeVar("ParametersT", bound=HardwareNodeSettings)


class HardwareNode(RigLifecycleNode, Generic[ParametersT]):
    """A device behind a lifecycle: `open` at configure, `activate`, `deactivate`, `close` at clean-up.

    Subclasses override these four; each may raise a `FringedicError`, whose message is the reason of the refused
    transition. Parameters are declared once and read at the transitions: a change has an effect at the next one.

    Parameters
    ----------
    name
        Node name.
    model
        Model of the parameters, derived from `HardwareNodeSettings`.
    """

    def __init__(self, name: str, model: type[ParametersT], **options: Any) -> None:
        super().__init__(name, **options)
        self._refusal = ""
        self._active = False
        self._opened = False
        self.parameters = declare(self, model)
        self.diagnostics = NodeDiagnostics(self)

    @classmethod
    def started(cls, **options: Any) -> Self:
        """Return the node, which is active when its parameter `autostart` is true.

        Raises
        ------
        ProcessError
            The node cannot be configured or activated; the message gives the reason.
        """
        node = cls(**options)
        if node.parameters.value.autostart:
            for transition in (node.trigger_configure, node.trigger_activate):
                if transition() is not TransitionCallbackReturn.SUCCESS:
                    refusal = node._refusal
                    node.destroy_node()
                    raise ProcessError(refusal)
        return node

    @property
    def active(self) -> bool:
        """Whether the device may be used."""
        return self._active

    def open(self) -> None:
        """Open the device that the parameters select."""

    def activate(self) -> None:
        """Start to work."""

    def deactivate(self) -> None:
        """Stop working; the device stays open."""

    def close(self) -> None:
        """Close the device."""

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Open the device."""
        return self._transition("configure", self._open)

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Start to work."""
        result = self._transition("activate", self.activate)
        self._active = result is TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        self._active = False
        return self._transition("deactivate", self.deactivate)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Close the device."""
        return self._transition("clean up", self._release)

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working and close the device."""
        return self._transition("shut down", self._release)

    def destroy_node(self) -> None:
        """Stop working, close the device and end the node."""
        self._release()
        super().destroy_node()

    def _open(self) -> None:
        self.open()
        self._opened = True

    def _release(self) -> None:
        if self._active:
            self._active = False
            self.deactivate()
        if self._opened:
            self._opened = False
            self.close()

    def _transition(self, verb: str, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except FringedicError as error:
            return self._refuse_transition(verb, str(error))
        except Exception as error:  # of a library of the device; rclpy would drop it
            self.get_logger().error(traceback.format_exc())
            return self._refuse_transition(verb, f"{type(error).__name__}: {error}")
        return TransitionCallbackReturn.SUCCESS

    def _refuse_transition(self, verb: str, reason: str) -> TransitionCallbackReturn:
        self._refusal = f"{self.get_name()} cannot {verb}: {reason}"
        self.get_logger().error(self._refusal)
        self.diagnostics.failure(self._refusal)
        return TransitionCallbackReturn.FAILURE
