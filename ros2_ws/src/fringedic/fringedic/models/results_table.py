"""Results of a finite-element model at its nodes as CSV, one file for each load step."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fringedic.errors import ModelError

_LABEL = re.compile(r"(node ?)?(label|number|id)|node", re.I)
DISPLACEMENT = [  # names of its components: U1, UX, u_x, U-U1, u, displacement_x
    re.compile(rf"(.*[^a-z0-9])?(u|displacement)[_ ]?({number}|{axis})|{letter}", re.I)
    for number, (axis, letter) in enumerate(zip("xyz", "uvw", strict=True), 1)
]
_STRAIN = [re.compile(rf"(.*[^a-z0-9])?l?e[_ ]?{number}", re.I) for number in (11, 22, 33, 12, 23, 13)]
_NODE_KEYWORD = re.compile(r"\*node(\s*,|\s*$)", re.I)


class NodalResults(NamedTuple):
    """Results of one load step at the nodes of a mesh, in the units of their file.

    Attributes
    ----------
    displacement : (node, 3)
    strain : (node, 6) or None
        xx, yy, zz, xy, yz, xz, with the tensor shear.
    """

    displacement: np.ndarray
    strain: np.ndarray | None


def node_labels(mesh: Path) -> list[int]:
    """Return the labels of the nodes of an Abaqus input file in their order."""
    labels, in_nodes = [], False
    with mesh.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.startswith("**"):
                continue
            if line.startswith("*"):
                in_nodes = bool(_NODE_KEYWORD.match(line.strip()))
            elif in_nodes and line.strip():
                label = line.split(",")[0].strip()
                if not label.isdigit():
                    raise ModelError(f"{mesh.name}: the node label {label[:20]!r} is no number; write the file again")
                labels.append(int(label))
    return labels


def read_results(file: Path, labels: Sequence[int]) -> NodalResults:
    """Read displacement and strain of the nodes with these labels from a table.

    The table has a heading, a column of node labels (``Node Label``, ``node``), the displacement (``U1``, ``U2``,
    ``U3`` or ``UX`` ..., also ``U-U1``, ``U.U1``, ``u``; two components are in the plane z = 0) and, if wanted, the
    strain (``E11``, ``E22``, ``E12`` ... or ``LE11`` ..., with the engineering shear, as Abaqus writes them).

    Raises
    ------
    ModelError
        The file is no such table, or lacks a node.
    """
    heading, rows = read_table(file)
    node, moved, strained = (find_columns(heading, wanted) for wanted in ([_LABEL], DISPLACEMENT, _STRAIN))
    if not node or {0, 1} - moved.keys():
        raise ModelError(
            f"{file.name}: has the columns {', '.join(heading)[:200]}; it needs the node's label and U1, U2, U3"
        )
    places = [*node.values(), *moved.values(), *strained.values()]
    table = np.empty((len(rows), len(places)))
    for index, (line, row) in enumerate(rows.items()):
        try:
            table[index] = [float(row[place]) for place in places]
        except ValueError as error:
            raise ModelError(
                f"{file.name}: line {line} has no number in a column of the heading; write it again"
            ) from error
        if not table[index, 0].is_integer():
            raise ModelError(f"{file.name}: line {line} has the node label {row[places[0]][:20]}; write whole numbers")
    row_of = {int(label): row for row, label in enumerate(table[:, 0].tolist())}
    if len(row_of) < len(table):
        raise ModelError(f"{file.name}: contains a node twice; write one file for each load step, and one part")
    missing = [label for label in labels if label not in row_of]
    if missing:
        raise ModelError(
            f"{file.name}: lacks {len(missing)} of the {len(labels)} nodes of the mesh, such as {missing[0]}; write "
            "the results of all nodes"
        )
    table = table[np.array([row_of[label] for label in labels])]
    displacement, strain = np.zeros((len(labels), 3)), np.zeros((len(labels), 6))
    displacement[:, list(moved)] = table[:, 1 : 1 + len(moved)]
    strain[:, list(strained)] = table[:, 1 + len(moved) :]
    strain[:, 3:] /= 2  # the tensor shear
    return NodalResults(displacement, None if {0, 1, 3} - strained.keys() else strain)


def read_table(file: Path) -> tuple[list[str], dict[int, list[str]]]:
    """Return the heading of a CSV file and its rows by the numbers of their lines; empty lines are left out.

    Raises
    ------
    ModelError
        The file cannot be read, is empty, or a row has another number of cells than the heading.
    """
    rows = {}
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            for row in reader:
                if any(row):
                    rows[reader.line_num] = [cell.strip() for cell in row]
    except (OSError, ValueError, csv.Error) as error:  # ValueError: another encoding
        raise ModelError(f"{file.name}: cannot be read as a table; write CSV with a heading") from error
    if not rows:
        raise ModelError(f"{file.name}: cannot be read as a table, it is empty; write CSV with a heading")
    heading = rows.pop(min(rows))
    for line, row in rows.items():
        if len(row) != len(heading):
            raise ModelError(
                f"{file.name}: line {line} has {len(row)} cells, the heading has {len(heading)}; write numbers with a "
                "decimal point, and commas only between the cells"
            )
    return heading, rows


def find_columns(heading: Sequence[str], wanted: Sequence[re.Pattern[str]]) -> dict[int, int]:
    """Return the column of each quantity by its number, where there is one."""
    found = {}
    for number, name in enumerate(wanted):
        columns = [place for place, title in enumerate(heading) if name.fullmatch(title)]
        if columns:
            found[number] = columns[0]
    return found
