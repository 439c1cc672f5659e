"""The printable grid: what the files hold is read back and drawn by other means."""

import math
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from fringedic.camera.grid import measure_distortion
from fringedic.camera.target import PAGES, Target
from fringedic.errors import GridError

SVG = "{http://www.w3.org/2000/svg}"
DOTS_PER_MM = 4.0


def rectangles_of_svg(path: Path) -> tuple[list[list[float]], list[list[float]], list[float]]:
    """Rectangles (x, y, width, height) of the grid and of the marks, and the numbers of the grid's turn."""
    root = ElementTree.parse(path).getroot()
    groups = {group.get("id"): group for group in root.iter(f"{SVG}g")}
    read = {
        name: [[float(each.get(key)) for key in ("x", "y", "width", "height")] for each in groups[name]]
        for name in ("grid", "marks")
    }
    turn = [float(word) for word in re.findall(r"[-\d.]+", groups["grid"].get("transform"))]
    return read["grid"], read["marks"], turn


@pytest.mark.parametrize("page", list(PAGES))
def test_svg_has_the_pitch_the_turn_and_a_true_ruler(tmp_path: Path, page: str) -> None:
    Target(2e-3, page, math.radians(3.0)).save(tmp_path / "grid.svg")
    root = ElementTree.parse(tmp_path / "grid.svg").getroot()
    width, height = {"A4": (297, 210), "A3": (420, 297)}[page]
    size = (f"{width}mm", f"{height}mm", f"0 0 {width} {height}")
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == size
    grid, marks, turn = rectangles_of_svg(tmp_path / "grid.svg")
    upright = np.array([each for each in grid if each[3] > each[2]])
    level = np.array([each for each in grid if each[2] > each[3]])
    assert np.allclose(np.diff(upright[:, 0]), 2.0)
    assert np.allclose(np.abs(np.diff(level[:, 1])), 2.0)
    assert np.allclose(upright[:, 2], 1.0)
    assert np.allclose(level[:, 3], 1.0)
    assert turn[0] == pytest.approx(-3.0), "SVG turns clockwise, the grid shall turn counter-clockwise"
    centre = np.array(turn[1:])
    assert np.min(np.abs(upright[:, 0] + 0.5 - centre[0])) < 1e-6, "a line passes the centre"
    lengths = sorted(each[2] for each in marks)
    assert lengths[-1] == 100.0
    words = root.find(f"{SVG}text").text
    assert "2 mm" in words
    assert "100 %" in words


def dots_around(rectangle: list[float], matrix: np.ndarray, height: float) -> tuple[slice, slice]:
    """Rows and columns of the canvas, `height` [mm] high, that a rectangle (left, low, width, height) can reach."""
    left, low, wide, high = rectangle
    x, y = (matrix @ [[left, left + wide] * 2, [low, low, low + high, low + high], [1.0] * 4])[:2] / 72 * 25.4
    edges = [each * DOTS_PER_MM for each in (height - y, x)]
    row, column = (slice(max(0, int(each.min()) - 2), max(0, int(each.max()) + 3)) for each in edges)
    return row, column


def within(place: np.ndarray, start: float, length: float) -> np.ndarray:
    """Part of each dot that is between two edges."""
    near, far = (place - start) * DOTS_PER_MM + 0.5, (start + length - place) * DOTS_PER_MM + 0.5
    return np.clip(near, 0, 1) * np.clip(far, 0, 1)


def drawn_pdf(path: Path) -> np.ndarray:
    """The page's content on a canvas of 4 dots per mm, the black part of each dot, by reading its few operators."""
    text = path.read_bytes().decode("latin-1")
    content = text[text.index("stream\n") + 7 : text.index("\nendstream")]
    box = [float(word) for word in re.search(r"/MediaBox \[([^\]]*)\]", text).group(1).split()]
    size = np.array(box[2:]) / 72 * 25.4
    row, column = np.mgrid[: round(size[1] * DOTS_PER_MM), : round(size[0] * DOTS_PER_MM)]
    x, y = (column + 0.5) / DOTS_PER_MM, size[1] - (row + 0.5) / DOTS_PER_MM
    white = np.ones(x.shape)
    points = np.stack([x, y, np.ones_like(x)]).reshape(3, -1) * np.array([[72 / 25.4], [72 / 25.4], [1.0]])
    state = [(np.eye(3), np.ones(x.shape))]
    u, v = points[0].reshape(x.shape), points[1].reshape(x.shape)
    for line in content.splitlines():
        words = line.split()
        matrix, clip = state[-1]
        if words[-1] in ("cm", "Q"):
            if words[-1] == "cm":
                a, b, c, d, e, f = (float(word) for word in words[:6])
                state[-1] = (matrix @ np.array([[a, c, e], [b, d, f], [0, 0, 1]]), clip)
            else:
                state.pop()
            u, v = (np.linalg.inv(state[-1][0]) @ points)[:2].reshape(2, *x.shape)
        elif words[-1] == "q":
            state.append(state[-1])
        elif "re" in words:
            left, low, width, height = (float(word) for word in words[:4])
            part = dots_around([left, low, width, height], matrix, size[1])
            inside = within(u[part], left, width) * within(v[part], low, height)
            if words[-1] == "f":
                white[part] *= 1 - inside * clip[part]
            else:
                assert words[-2:] == ["W", "n"]
                clipped = np.zeros_like(clip)
                clipped[part] = clip[part] * inside
                state[-1] = (matrix, clipped)
    return 1 - white


def test_pdf_measures_as_it_should(tmp_path: Path) -> None:
    """The page drawn at 4 dots per mm is itself measured by the grid method: scale, turn, straightness."""
    page, target = "A4", Target(2e-3, "A4", math.radians(2.0))
    target.save(tmp_path / "grid.pdf")
    canvas = drawn_pdf(tmp_path / "grid.pdf")
    x, y, width, height = target.area
    top = PAGES[page][1] - y - height
    cut = [slice(round(a * DOTS_PER_MM) + 1, round((a + b) * DOTS_PER_MM) - 1) for a, b in ((top, height), (x, width))]
    found = measure_distortion(200.0 - 180.0 * canvas[tuple(cut)], pitch=2e-3)
    assert found.plane.pixel_size == pytest.approx(1e-3 / DOTS_PER_MM, rel=2e-5)
    assert found.plane.pixel_aspect == pytest.approx(1.0, abs=2e-5)
    assert math.degrees(found.turn) == pytest.approx(2.0, abs=0.005)
    assert found.magnitude < 0.05
    assert found.warnings == ()
    ruler = canvas[round((PAGES[page][1] - 12.15) * DOTS_PER_MM)]
    assert (ruler > 0.3).sum() / DOTS_PER_MM == pytest.approx(100.0, abs=0.6)


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="needs poppler")
def test_pdf_is_drawn_alike_by_poppler(tmp_path: Path) -> None:
    Target(4e-3).save(tmp_path / "grid.pdf")
    dots = str(DOTS_PER_MM * 25.4)
    subprocess.run(["pdftoppm", "-gray", "-r", dots, tmp_path / "grid.pdf", tmp_path / "page"], check=True)
    raw = next(tmp_path.glob("page*.pgm")).read_bytes()
    header = re.match(rb"P5\s+(\d+)\s+(\d+)\s+255\s", raw)
    columns, rows = int(header.group(1)), int(header.group(2))
    page = np.frombuffer(raw[header.end() :], np.uint8).reshape(rows, columns) < 128
    mine = drawn_pdf(tmp_path / "grid.pdf")
    area = np.s_[60:500, 60:1100]
    assert np.mean(page[area] == (mine[area] > 0.5)) > 0.97


def test_a_pdf_s_table_of_contents_is_right(tmp_path: Path) -> None:
    Target(2e-3).save(tmp_path / "grid.pdf")
    data = (tmp_path / "grid.pdf").read_bytes()
    place = int(re.search(rb"startxref\n(\d+)", data).group(1))
    assert data[place:].startswith(b"xref")
    offsets = [int(each) for each in re.findall(rb"(\d{10}) 00000 n", data)]
    for number, offset in enumerate(offsets, start=1):
        assert data[offset:].startswith(f"{number} 0 obj".encode())
    length = data.index(b"\nendstream") - data.index(b"stream\n") - len(b"stream\n")
    assert int(re.search(rb"/Length (\d+)", data).group(1)) == length


def test_impossible_pages_are_named(tmp_path: Path) -> None:
    for wrong, says in (
        ({"page": "A5"}, "A4, A3"),
        ({"pitch": 0.1e-3}, "0.2 mm is the finest"),
        ({"pitch": 30e-3}, "too coarse"),
        ({"pitch": math.nan}, "finest"),
        ({"turn": 1.0}, "45"),
    ):
        with pytest.raises(GridError, match=says):
            Target(**{"pitch": 2e-3, **wrong})
    with pytest.raises(GridError, match=r"\.pdf or \.svg"):
        Target(2e-3).save(tmp_path / "grid.png")
