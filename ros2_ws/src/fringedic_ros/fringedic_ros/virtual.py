"""The virtual rig as a node parameter: the section `virtual_rig` of a rig file as YAML text."""

from __future__ import annotations

from typing import Annotated

import yaml
from pydantic import AfterValidator, Field

from fringedic.errors import VirtualRigError
from fringedic.virtual_rig import VirtualRigConfiguration
from fringedic.wording.yaml_text import load_yaml


def virtual_configuration(text: str) -> VirtualRigConfiguration:
    """Return the configuration that a YAML text such as `{preset: plate, size: small}` describes.

    Raises
    ------
    VirtualRigError
        The text is not a YAML mapping, or an entry is unknown or out of range.
    """
    try:
        values = load_yaml(text)
    except yaml.YAMLError as error:
        raise VirtualRigError(f"virtual_rig is not valid YAML: {error}") from error
    if not isinstance(values, dict):
        raise VirtualRigError(f"virtual_rig needs entries such as {{preset: plate}}, not {text!r}")
    return VirtualRigConfiguration.from_dict(values)


def _checked(text: str) -> str:
    virtual_configuration(text)
    return text


VirtualRigText = Annotated[
    str,
    AfterValidator(_checked),
    Field(description="The virtual rig as YAML text, as in the section `virtual_rig` of a rig file."),
]
