"""What a laboratory writes on its certificates: a settings file, with the logo."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from fringedic.configuration.yaml_section import load_sections
from fringedic.errors import ConfigurationError
from fringedic.report.templates import base64_text
from fringedic.wording.causes import cause_of

LABORATORY = "laboratory.yaml"
"""Name of the settings file that is found beside a run."""
Detail = Literal["customer", "test_number", "number", "name", "material", "operator", "notes", "experiment", "date"]
LARGEST_LOGO = 500_000  # [byte]; it is part of every report
_DETAILS: dict[str, Detail] = {
    "Customer": "customer",
    "Test number": "test_number",
    "Specimen": "name",
    "Specimen number": "number",
    "Material": "material",
    "Tested by": "operator",
    "Date of the test": "date",
}


class Laboratory(BaseModel):
    """Settings of the certificates of a laboratory."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    name: str = Field("", max_length=200, description="Name of the laboratory.")
    address: list[str] = Field([], max_length=8, description="Lines below the name: address, telephone, accreditation.")
    logo: str = Field("", description="PNG, JPEG or SVG file of the logo, relative to this file.")
    title: str = Field("Test report", max_length=200, description="Heading of the first page.")
    details: dict[str, Detail] = Field(
        _DETAILS,
        max_length=20,
        description=f"Lines about the test: what each is called, and one of {get_args(Detail)}.",
    )
    signatures: list[str] = Field(
        ["Tested by", "Approved by"], max_length=6, description="One field for each, with date and signature."
    )
    statement: str = Field("", max_length=2000, description="Text at the end of the page.")


def load_laboratory(file: Path) -> tuple[Laboratory, str]:
    """Read the settings file of a laboratory.

    Parameters
    ----------
    file
        YAML with the keys of `Laboratory`.

    Returns
    -------
    tuple of Laboratory and str
        The settings, and the logo as a ``data:`` address; "" without one.

    Raises
    ------
    ConfigurationError
        The file cannot be read, a key is unknown or has another form, or the logo is no picture or too large.
    """
    laboratory = load_sections(file, Laboratory)
    return laboratory, _logo(file.parent / laboratory.logo) if laboratory.logo else ""


def _logo(file: Path) -> str:
    """Return a picture as an address. It is shown as an image, in which a browser executes no script of an SVG."""
    try:
        size = file.stat().st_size
        if size > LARGEST_LOGO:
            raise ConfigurationError(
                f"{file}: the logo has {size // 1000} kB, at most {LARGEST_LOGO // 1000} are allowed: make it smaller"
            )
        content = file.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"{file}: the logo cannot be read: {cause_of(error)}") from error
    for begin, kind in ((b"\x89PNG\r\n", "png"), (b"\xff\xd8\xff", "jpeg")):
        if content.startswith(begin):
            return f"data:image/{kind};base64,{base64_text(content)}"
    if content.lstrip(b"\xef\xbb\xbf \r\n\t").startswith((b"<svg", b"<?xml")) and b"<svg" in content:
        return f"data:image/svg+xml;base64,{base64_text(content)}"
    raise ConfigurationError(f"{file}: the logo is no PNG, JPEG or SVG picture")
