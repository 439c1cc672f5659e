"""Drawing a region: polygons from clicks, a real window on a virtual display, and the mask in a measurement."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pygame
import pytest
import xarray as xr
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.command.region_window import BAR, GREEN, RED, Drawing, draw_region
from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import ConfigurationError, ImageError
from fringedic.frames.region import Polygon, Region, mask_of
from fringedic_bringup.launch.graph import rig_graph

CONFIG = Path(__file__).parent.parent / "config"
WIDTH, HEIGHT = 768, 576  # of the picture: 0.9 of the display's 800 rows, less both bars


def test_clicks_make_polygons() -> None:
    drawing = Drawing(200, 100)
    assert drawing.begin(hole=True) == "draw a part before the hole in it"
    for point in ((10, 10), (150, 10), (150, 300), (80, 50)):
        drawing.add(point)
    assert drawing.points[2] == (150, 99), "outside the image means its edge"
    drawing.undo()
    drawing.move(0, (5.5, 12))
    assert drawing.nearest((8, 12), reach=4) == 0
    assert drawing.nearest((8, 30), reach=4) is None
    assert not drawing.begin(hole=True)
    drawing.add((100, 20))
    drawing.add((110, 20))
    assert "three corners" in drawing.begin(hole=False)
    with pytest.raises(ImageError, match="three corners"):
        drawing.region()
    drawing.add((110, 30))
    first = Polygon(((5.5, 12), (150, 10), (150, 99)))
    hole = Polygon(((100, 20), (110, 20), (110, 30)), hole=True)
    assert drawing.region() == Region((first, hole), 200, 100)
    for _ in range(4):
        drawing.undo()
    assert (drawing.hole, len(drawing.points), drawing.finished) == (False, 3, []), "the previous polygon is open again"


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    read_end, write_end = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write_end), "-screen", "0", "1000x800x24"],
        pass_fds=[write_end],
        stderr=subprocess.DEVNULL,
    )
    os.close(write_end)
    with open(read_end) as answer:
        monkeypatch.setenv("DISPLAY", f":{answer.readline().strip()}")
    yield
    server.terminate()
    server.wait()


class Person(threading.Thread):
    """Clicks and presses keys in the window, each after the previous action is visible."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.seen: list[np.ndarray] = []

    def run(self) -> None:
        try:
            self._draw()
        finally:
            if pygame.display.get_init():  # otherwise the window would wait for ever
                pygame.event.post(pygame.event.Event(pygame.QUIT))

    def _draw(self) -> None:
        self._until(lambda: pygame.display.get_init() and pygame.display.get_surface() is not None)
        for place in ((100, 80), (300, 80), (300, 200), (100, 200), (99, 330)):
            self._click(place)
        self._click((50, 50), button=3)  # removes the last corner
        self._until(lambda: self._colour(100, 80) == GREEN)
        self._drag((300, 200), (340, 240))
        self._key(pygame.K_h)
        for place in ((150, 110), (200, 110), (200, 150)):
            self._click(place)
        self._until(lambda: self._colour(200, 150) == RED)
        self.seen.append(pygame.surfarray.array3d(pygame.display.get_surface()))
        self._click((int(0.7 * WIDTH), HEIGHT + BAR + 20))  # the button "done"

    def _until(self, predicate: object, timeout_s: float = 300.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not predicate():  # type: ignore[operator]
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def _colour(self, column: int, row: int) -> tuple[int, ...]:
        return tuple(pygame.display.get_surface().get_at((column, row)))[:3]

    def _click(self, place: tuple[int, int], button: int = 1) -> None:
        for kind in (pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP):
            pygame.event.post(pygame.event.Event(kind, pos=place, button=button))

    def _drag(self, begin: tuple[int, int], end: tuple[int, int]) -> None:
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=begin, button=1))
        pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, pos=end, rel=(0, 0), buttons=(1, 0, 0)))
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONUP, pos=end, button=1))

    def _key(self, key: int) -> None:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


@pytest.mark.hardware
@pytest.mark.usefixtures("display")
def test_window_takes_mouse_keys_and_buttons() -> None:
    """The image of 320x240 px is shown as large as the display allows."""
    image = np.random.default_rng(1).integers(40, 200, (240, 320)).astype(np.uint8)
    person = Person()
    person.start()
    region = draw_region(image)
    person.join(30)
    assert region is not None

    def corners(*places: tuple[int, int]) -> np.ndarray:
        return (np.array(places) + 0.5) * (240 / HEIGHT) - 0.5

    part, hole = region.polygons
    assert not part.hole
    assert hole.hole
    np.testing.assert_allclose(part.points, corners((100, 80), (300, 80), (340, 240), (100, 200)))
    np.testing.assert_allclose(hole.points, corners((150, 110), (200, 110), (200, 150)))
    picture = person.seen[0]
    inside, outside = picture[240:280, 100:180].mean(), picture[400:500, 100:180].mean()
    assert outside < 0.6 * inside, "the part outside the region is shaded"


def test_no_display_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ImageError, match="no display"):
        draw_region(np.zeros((40, 60), np.uint8))


REGION = Region((Polygon(((40, 30), (150, 30), (150, 120), (40, 120))),), 200, 160)


def command(*words: object) -> BaseException | None:
    """Run `fringedic region` and return its error."""
    return CliRunner().invoke(app, ["region", *map(str, words)]).exception


def test_mask_and_polygons_replace_no_other_file_unasked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fringedic.command.region_window.draw_region", lambda _: REGION)
    image, polygons = tmp_path / "image.png", tmp_path / "plate.yaml"
    cv2.imwrite(str(image), np.full((160, 200), 90, np.uint8))
    polygons.write_text("a rig file")
    assert "image.png: would replace" in str(command(image, "--output", image, "--overwrite"))
    assert "plate.png: would replace" in str(command(polygons, "--output", tmp_path / "plate.png", "--overwrite"))
    assert "plate.yaml exists already" in str(command(image, "--output", tmp_path / "plate.png"))
    assert cv2.imread(str(image)).max() == 90
    assert polygons.read_text() == "a rig file"
    assert command(image, "--output", tmp_path / "plate.png", "--overwrite") is None
    assert Region.load(polygons) == REGION


def test_measure_takes_mask_and_polygons(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    noise = cv2.GaussianBlur(rng.normal(size=(160, 204)), (0, 0), 1.5)
    grey = np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
    images = [str(tmp_path / name) for name in ("a.png", "b.png")]
    for name, first in zip(images, (2, 0), strict=True):
        cv2.imwrite(name, grey[:, first : first + 200])
    picture, polygons = REGION.save(tmp_path / "region.png")
    maps = []
    for mask in (picture, polygons):
        folder = tmp_path / mask.suffix
        options = ["--mask", str(mask), "--window", "16", "--spacing", "4", "--output", str(folder)]
        done = CliRunner().invoke(app, ["measure", *images, *options])
        assert done.exit_code == 0, done.exception
        with xr.open_dataset(folder / "displacement.nc", engine="h5netcdf") as dataset:
            maps.append(dataset.displacement_x.values[1])
    measured = np.isfinite(maps[0])
    assert not measured[~REGION.mask()[::4, ::4]].any()
    assert measured[10:28, 14:34].all()
    assert np.nanmedian(maps[0]) == pytest.approx(2.0, abs=0.01)
    np.testing.assert_array_equal(*maps)
    other = Region(REGION.polygons, 640, 480).save(tmp_path / "other.png")[1]
    refused = CliRunner().invoke(
        app, ["measure", *images, "--region", f"hole={other}", "--output", str(tmp_path / "refused")]
    )
    assert isinstance(refused.exception, ImageError)
    assert "--region hole: " in str(refused.exception)
    assert "640x480 px, this one has 200x160 px" in str(refused.exception)
    assert not (tmp_path / "refused").exists(), "refused before the measurement"
    with pytest.raises(ImageError, match=r"region\.yaml: .*200x160"):
        mask_of(polygons, (100, 200))
    with pytest.raises(ImageError, match="200x160"):
        mask_of(picture, (100, 200))
    with pytest.raises(ImageError, match="none"):
        mask_of(tmp_path / "none.png", (160, 200))


def test_nodes_get_the_region_of_the_rig_file(tmp_path: Path) -> None:
    region = Region(REGION.polygons, 160, 120)
    region.save(tmp_path / "region.png")
    path = tmp_path / "rig.yaml"
    path.write_text((CONFIG / "tiny.yaml").read_text() + "region_file: region.yaml\n")
    graph = rig_graph(load_rig_file(path), path, tmp_path / "out")
    for name in ("phase", "dic"):
        parameters = next(node.parameters for node in graph.nodes if node.name == name)
        assert Region.from_text(parameters["region"]) == region
    REGION.save(tmp_path / "region.png")
    with pytest.raises(ConfigurationError, match=r"region.yaml: the region was drawn in an image of 200x160 px"):
        rig_graph(load_rig_file(path), path, tmp_path / "out")
