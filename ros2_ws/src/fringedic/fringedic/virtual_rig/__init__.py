"""Digital twin of a rig: it renders what camera and projector would see, and knows the truth.

It imports nothing from the measuring modules: matrices and ray tracing are its own. What is listed here is loaded when
it is first used: a simulated load frame needs no ray tracing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fringedic.virtual_rig.configuration import VirtualRigConfiguration, preset
    from fringedic.virtual_rig.load_frame import LoadMode, LoadSample, SimulatedLoadFrame
    from fringedic.virtual_rig.projector_timing import pattern_weights
    from fringedic.virtual_rig.rig import VirtualRig

_HOMES = {
    "LoadMode": "load_frame",
    "LoadSample": "load_frame",
    "SimulatedLoadFrame": "load_frame",
    "VirtualRig": "rig",
    "VirtualRigConfiguration": "configuration",
    "pattern_weights": "projector_timing",
    "preset": "configuration",
}

__all__ = [
    "LoadMode",
    "LoadSample",
    "SimulatedLoadFrame",
    "VirtualRig",
    "VirtualRigConfiguration",
    "pattern_weights",
    "preset",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"fringedic.virtual_rig.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
