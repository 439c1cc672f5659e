"""Legacy VTK files (ASCII) whose fields VTK does not read, because their headings differ from the format.

Plane solvers write vectors of two components under ``VECTORS``, which has three, and leave out the ``LOOKUP_TABLE``
that follows ``SCALARS``. VTK drops such a field with a message.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import pyvista

_SECTION = re.compile(r"(?=^\s*[A-Z_]{5,}\b)", re.MULTILINE)  # a heading; not nan, inf or a number
_COUNT = re.compile(r"\s*POINT_DATA\s+(\d+)")
_VECTORS = re.compile(r"\s*VECTORS\s+(\S+)\s+(\S+)\s")
_SCALARS = re.compile(r"\s*SCALARS\s+\S+\s+\S+(?:[ \t]+\d+)?[ \t]*\r?\n")


def read_legacy(source: Path) -> pyvista.DataSet:
    """Read a legacy VTK file; where VTK reports an error, with the headings of its fields corrected."""
    with pyvista.VtkErrorCatcher(send_to_logging=False) as caught:
        mesh = pyvista.read(source)
    with source.open("rb") as stream:
        coded = [stream.readline().strip() for _ in range(3)][-1]
    if not caught.events or coded != b"ASCII":
        return mesh
    with tempfile.TemporaryDirectory() as folder:
        corrected = Path(folder) / source.name
        corrected.write_text(_correct(source.read_text("utf-8", "replace")), "utf-8")
        return pyvista.read(corrected)


def _correct(text: str) -> str:
    r"""Return the text with vectors of two components as scalars of two, and the table that belongs to scalars.

    Examples
    --------
    >>> print(_correct("POINT_DATA 2\nVECTORS u float\n1 2\n3 4\nSCALARS t float\n5 6"))
    POINT_DATA 2
    SCALARS u float 2
    LOOKUP_TABLE default
    1 2
    3 4
    SCALARS t float
    LOOKUP_TABLE default
    5 6
    """
    sections, points = _SECTION.split(text), 0
    for place, section in enumerate(sections):
        if found := _COUNT.match(section):
            points = int(found[1])
        elif (found := _VECTORS.match(section)) and len(section[found.end() :].split()) == 2 * points:
            sections[place] = f"SCALARS {found[1]} {found[2]} 2\nLOOKUP_TABLE default\n{section[found.end() :]}"
        elif (found := _SCALARS.match(section)) and section[found.end() :].strip():  # no table is the next section
            sections[place] = f"{found[0]}LOOKUP_TABLE default\n{section[found.end() :]}"
    return "".join(sections)
