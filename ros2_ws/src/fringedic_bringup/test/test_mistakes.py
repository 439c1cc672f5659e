"""Mistakes that beginners make with the command: exit code, a sentence of two lines at most, what stays on the disk.

Every command runs in a folder of its own with images, a recording, a damaged one and results; nothing of that may
change. A mistake that leaves files has their names in its row.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

from fringedic.command.main import main
from fringedic.images import measure_images

SOURCES = Path(__file__).parents[2]
RECORDED = SOURCES / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
LINE = 250  # characters of a line on a wide terminal
UNUSABLE, MISWRITTEN = 1, 2  # exit codes


class Mistake(NamedTuple):
    """What is typed, how it ends, part of the sentence, and the files that are left."""

    typed: str
    code: int
    sentence: str
    left: frozenset[str] = frozenset()


ANSWERS = "--camera aravis --camera-address 1 --display 1 --projector-size 800x600 --grid-pitch-mm 0.5 --operator Ada"
MISTAKES = [
    # the command line
    Mistake("mesure a.tif b.tif", MISWRITTEN, "No such command 'mesure'. Did you mean 'measure'?"),
    Mistake("measure", MISWRITTEN, "'IMAGES'"),
    Mistake("measure a.tif b.tif --windw 24", MISWRITTEN, "--windw"),
    Mistake("measure a.tif b.tif --window wide", MISWRITTEN, "integer"),
    Mistake("measure a.tif b.tif --window 24.5", MISWRITTEN, "integer"),
    Mistake("measure a.tif b.tif --window 4", MISWRITTEN, "8"),
    Mistake("measure a.tif b.tif --spacing 0", MISWRITTEN, "1"),
    Mistake("measure a.tif b.tif --window", MISWRITTEN, "--window"),
    Mistake("target", MISWRITTEN, "pitch"),
    Mistake("process", MISWRITTEN, "BAGS"),
    Mistake("live plate --pattern stripes", MISWRITTEN, "'stripes'"),
    Mistake("report run --static first", MISWRITTEN, "integer"),
    Mistake("info run bag", MISWRITTEN, "unexpected extra argument"),
    # images alone
    Mistake("measure a.tif", UNUSABLE, "give a reference image and at least one deformed image"),
    Mistake("measure a.tif missing.tif", UNUSABLE, "missing.tif: no such image or folder of images"),
    Mistake("measure nowhere", UNUSABLE, "nowhere: no such image or folder of images"),
    Mistake("measure empty", UNUSABLE, "empty: contains no images"),
    Mistake("measure load_*.png", UNUSABLE, "load_*.png: contains no images"),
    Mistake("measure a.tif notes.txt", UNUSABLE, "notes.txt is not an image"),
    Mistake("measure notes.txt a.tif", UNUSABLE, "notes.txt is not an image"),
    Mistake("measure a.tif other.tif", UNUSABLE, "does not correlate with the reference"),
    Mistake("measure a.tif small.tif", UNUSABLE, "small.tif has 60x50 px, a.tif has 120x100 px"),
    Mistake("measure a.tif stack.tif", UNUSABLE, "has 2 pages"),
    Mistake("measure flat.tif a.tif", UNUSABLE, "constant"),
    Mistake("measure float.tif a.tif", UNUSABLE, "float.tif has float32 values from 0"),
    Mistake("measure a.tif b.tif --window 200", UNUSABLE, "window"),
    Mistake("measure a.tif b.tif --spacing 200", UNUSABLE, "spacing"),
    Mistake("measure a.tif b.tif --strain-window 5 --spacing 8", UNUSABLE, "window"),
    Mistake("measure a.tif b.tif --pixel-size-mm 0", UNUSABLE, "such as 0.05"),
    Mistake("measure a.tif b.tif --pixel-size-mm -0.05", UNUSABLE, "such as 0.05"),
    Mistake("measure a.tif b.tif --pixel-size-mm 50µm", MISWRITTEN, "number"),
    Mistake("measure a.tif b.tif --scale-length-mm 20", UNUSABLE, "no display"),
    Mistake("measure a.tif b.tif --scale-length-mm -20", UNUSABLE, "--scale-length-mm"),
    Mistake("measure a.tif b.tif --scale-length-mm 20 --pixel-size-mm 0.05", UNUSABLE, "give one of them"),
    Mistake("measure a.tif b.tif --mask missing.png", UNUSABLE, "missing.png"),
    Mistake("measure a.tif b.tif --mask small.tif", UNUSABLE, "the mask has 60x50 px"),
    Mistake("measure a.tif b.tif --mask black.png", UNUSABLE, "black everywhere"),
    Mistake("measure a.tif b.tif --mask rig.yaml", UNUSABLE, "rig.yaml"),
    Mistake("measure a.tif b.tif --extensometer 1,2,3", UNUSABLE, "such as 200,480,1000,480"),
    Mistake("measure a.tif b.tif --extensometer edge=1,2,3,x", UNUSABLE, "such as 200,480,1000,480"),
    Mistake("measure a.tif b.tif --region hole=missing.yaml", UNUSABLE, "missing.yaml"),
    Mistake("measure a.tif b.tif --output notes.txt", UNUSABLE, "notes.txt is a file"),
    Mistake("measure a.tif b.tif --output earlier", UNUSABLE, "exists already"),
    Mistake("advise a.tif b.tif", MISWRITTEN, "'STATIC_2'"),
    Mistake("advise a.tif b.tif other.tif", UNUSABLE, "correlate"),
    Mistake("advise a.tif b.tif a.tif --wanted-noise-px -1", UNUSABLE, "noise"),
    Mistake("noise", UNUSABLE, "give a rig file, or with --images at least three images"),
    Mistake("noise --images a.tif --images b.tif", UNUSABLE, "at least 3 steps at rest"),
    Mistake("noise plate --images a.tif --images b.tif --images a.tif", UNUSABLE, "give a rig file, or"),
    Mistake("noise --images a.tif --images b.tif --steps 9", UNUSABLE, "--steps: with --images every image is a step"),
    Mistake(
        "noise nowhere.yaml --window 24 --spacing 2", UNUSABLE, "--window, --spacing: with a rig file they are nodes"
    ),
    Mistake("region missing.png", UNUSABLE, "missing.png"),
    Mistake("region a.tif", UNUSABLE, "no display"),
    Mistake("region a.tif --output mask.yaml", UNUSABLE, "--output mask.yaml: is no name of an image; take a name"),
    # recordings
    Mistake("info nowhere", UNUSABLE, "nowhere: no such recording"),
    Mistake("info empty", UNUSABLE, "empty: holds no .mcap file"),
    Mistake("info a.tif", UNUSABLE, "a.tif"),
    Mistake("verify nowhere", UNUSABLE, "no such recording"),
    Mistake("recover nowhere", UNUSABLE, "no such recording"),
    Mistake("recover run --output run/bag", UNUSABLE, "exists already"),
    Mistake("process nowhere", UNUSABLE, "no such recording"),
    Mistake("process run --set window=24", UNUSABLE, "node.parameter=value"),
    Mistake("process run --set dic.windw=24 --output new.nc", UNUSABLE, "dic.windw"),
    Mistake("process run --set dic.window=big --output new.nc", UNUSABLE, "dic.window"),
    Mistake("process run --set dic.window=4 --output new.nc", UNUSABLE, "dic.window"),
    Mistake("process run --set camera.gain=1 --output new.nc", UNUSABLE, "camera"),
    Mistake("process run --step 99 --output new.nc", UNUSABLE, "has no step 99"),
    Mistake("process run --reference 99 --output new.nc", UNUSABLE, "has no step 99"),
    Mistake("process run --output new.csv", UNUSABLE, ".nc (NetCDF) or .zarr (Zarr)"),
    Mistake("process run --output earlier/displacement.nc", UNUSABLE, "exists already"),
    Mistake("process run --calibration missing.yaml", UNUSABLE, "no such calibration"),
    Mistake("process run --calibration rig.yaml", UNUSABLE, "rig.yaml"),
    Mistake("replay nowhere", UNUSABLE, "no such recording"),
    Mistake("replay run --set camera.gain=1", UNUSABLE, "a replay starts phase, dic, coupling, not camera"),
    Mistake("calibrate --from run", UNUSABLE, "experiment/plane"),
    Mistake(
        "calibrate --from run --angles-deg 0,5", UNUSABLE, "--angles-deg: --from takes the angles from the recording"
    ),
    # results
    Mistake("export nowhere", UNUSABLE, "nowhere: no such recording"),
    Mistake("export earlier --to xls", UNUSABLE, "there is no format xls; known are netcdf"),
    Mistake("export earlier --to csv --step 9", UNUSABLE, "the dataset has no step 9; it has 0, 1"),
    Mistake("export earlier --to csv --output notes.txt", UNUSABLE, "notes.txt"),
    Mistake("export notes.txt", UNUSABLE, "notes.txt"),
    Mistake("export other.nc", UNUSABLE, "is no experiment"),
    Mistake("export unscaled --to vtk --output out", UNUSABLE, "formats were not written", frozenset({"out"})),
    Mistake("report nowhere", UNUSABLE, "no such recording"),
    Mistake("report earlier --extensometer 1,2,3,4,5", UNUSABLE, "such as 200,480,1000,480"),
    Mistake("report earlier --static 7 --output new.html", UNUSABLE, "has no step 7"),
    Mistake("report earlier", UNUSABLE, "report.html exists already"),
    Mistake("report earlier --output nowhere/new.html --region a=b.yaml", UNUSABLE, "b.yaml"),
    Mistake("compare-model earlier m.stl", MISWRITTEN, "--unit"),
    Mistake("compare-model earlier m.stl --unit furlong", UNUSABLE, "give one of m, mm"),
    Mistake("compare-model earlier m.stl --unit mm --pair 1,2=3,4", UNUSABLE, "--pair 1,2=3,4: give COLUMN,ROW=X,Y,Z"),
    Mistake("compare-model earlier m.stl --unit mm --hole 1,2=3,4,nan", UNUSABLE, "--hole 1,2=3,4,nan: give COLUMN"),
    Mistake("compare-model earlier m.stl --unit mm --edge 1,2=3,4,5", UNUSABLE, "--edge 1,2=3,4,5: give COLUMN,ROW;"),
    Mistake("compare-model earlier m.stl --unit mm --load-table notes.txt", UNUSABLE, "is no table of loads; write"),
    Mistake("compare-model earlier m.stl --unit mm --shape --step 1 --step 2", UNUSABLE, "give --step once"),
    Mistake("compare-model earlier m.stl --unit mm --shape", UNUSABLE, "m.stl: no such model file"),
    Mistake(
        "compare-model earlier m.stl --unit mm --shape --by position --by-displacement --reference-image a.tif "
        "--load-table loads.csv --strain E --results results.csv",
        UNUSABLE,
        "--by, --by-displacement, --reference-image, --results, --strain, --load-table: --shape compares the shape",
    ),
    # rigs
    Mistake("run nowhere.yaml", UNUSABLE, "no such rig file; installed with fringedic are"),
    Mistake("run notes.txt", UNUSABLE, "notes.txt"),
    Mistake("run wrong.yaml", UNUSABLE, "camera.expsure_ms: unknown key"),
    Mistake("run tabs.yaml", UNUSABLE, "tabs.yaml: is not YAML"),
    Mistake("run plate --programme missing.yaml", UNUSABLE, "missing.yaml"),
    Mistake("run plate --programme wrong.yaml", UNUSABLE, "unknown key"),
    Mistake("run plate --images .", UNUSABLE, "only 'files' takes images"),
    Mistake("run open_hole_tension --images nowhere", UNUSABLE, "give their folder with --images"),
    Mistake("run plate --output run", UNUSABLE, "contains a recording already"),
    Mistake("calibrate", UNUSABLE, "give a rig file, or with --from"),
    Mistake("calibrate tiny --angles-deg 0.1,0.2", UNUSABLE, "need at least 4"),
    Mistake("calibrate tiny --angles-deg 0,ten", UNUSABLE, "numbers separated by commas"),
    Mistake("calibrate tiny --angles-deg 0,-95,95", UNUSABLE, "80"),
    Mistake("init new.yaml --camera webcam", MISWRITTEN, "'webcam'"),
    Mistake(f"init new.yaml --image-size 1280 {ANSWERS}", UNUSABLE, "image size 1280: give width and height in px"),
    Mistake(f"init new.yaml --image-size 8x8 {ANSWERS}", UNUSABLE, "camera: width is 8; at least 16 px"),
    Mistake(f"init rig.yaml --image-size 1280x960 {ANSWERS}", UNUSABLE, "rig.yaml exists already"),
    Mistake("check rig.yaml", UNUSABLE, "nothing to check"),
    Mistake(
        "check rig.yaml --vdi --distance-mm 5", UNUSABLE, "--distance-mm: --vdi measures artefacts, not a distance"
    ),
    Mistake("live tiny --region 3,4,5", UNUSABLE, "such as 320,240,640,480"),
    Mistake("show tiny stripes", UNUSABLE, "use one of crosshair"),
    Mistake("target --pitch-mm 0", UNUSABLE, "pitch"),
    Mistake("target --pitch-mm 0.5 --page A7", UNUSABLE, "A4"),
    Mistake("target --pitch-mm 0.5 --output grid.docx", UNUSABLE, "pdf"),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what a beginner has: images, a recording, results, and files of other kinds."""
    folder = tmp_path_factory.mktemp("beginner")
    rng = np.random.default_rng(5)

    def speckle() -> np.ndarray:
        spots = gaussian_filter(rng.normal(size=(110, 130)), 1.5)
        return np.clip(128 + 40 * spots / spots.std(), 0, 255).astype(np.uint8)

    surface, other = speckle(), speckle()
    images = {
        "a.tif": surface[:100, 4:124],
        "b.tif": surface[:100, 3:123],
        "other.tif": other[:100, :120],
        "small.tif": surface[:50, :60],
        "flat.tif": np.full((100, 120), 7, np.uint8),
        "float.tif": surface[:100, :120] / np.float32(255),
        "black.png": np.zeros((100, 120), np.uint8),
    }
    for name, image in images.items():
        cv2.imwrite(str(folder / name), image)
    cv2.imwritemulti(str(folder / "stack.tif"), [surface, surface])
    (folder / "empty").mkdir()
    (folder / "notes.txt").write_text("nothing to see")
    (folder / "wrong.yaml").write_text("camera: {source: files, files: a.tif, expsure_ms: 10}\n")
    (folder / "rig.yaml").write_text("camera: {source: files, files: 'a.tif', width: 120, height: 100}\n")
    (folder / "tabs.yaml").write_text("camera:\n\tsource: files\n")
    xr.Dataset({"a": ("b", [1.0])}).to_netcdf(folder / "other.nc", engine="h5netcdf")
    shutil.copytree(RECORDED, folder / "run" / "bag")
    both = [folder / "a.tif", folder / "b.tif"]
    for name, scale in (("earlier", 5e-5), ("unscaled", None)):
        (folder / name).mkdir()
        measure_images(both, folder / name / "displacement.nc", pixel_size=scale)
    (folder / "earlier" / "report.html").write_text("the report of yesterday")
    return folder


def content(folder: Path) -> dict[str, int]:
    """Return the files of a folder with their times of change, and its folders."""
    return {str(file.relative_to(folder)): file.is_file() and file.stat().st_mtime_ns for file in folder.rglob("*")}


def test_there_are_at_least_75() -> None:
    assert len({mistake.typed for mistake in MISTAKES}) >= 75


@pytest.mark.parametrize("mistake", MISTAKES, ids=[mistake.typed for mistake in MISTAKES])
def test_a_mistake_is_answered_by_one_sentence(
    mistake: Mistake, place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "argv", ["fringedic", *mistake.typed.split()])
    before = content(place)
    capfd.readouterr()
    with pytest.raises(SystemExit) as ended:
        main()
    printed = capfd.readouterr()
    after = content(place)
    for name in mistake.left:
        shutil.rmtree(place / name)
    sentence = printed.err.strip()
    assert ended.value.code == mistake.code, printed
    assert mistake.sentence in sentence, printed
    assert "Traceback" not in printed.err
    assert len(sentence.splitlines()) == 1, sentence
    assert len(sentence) <= 2 * LINE, sentence
    new = {name.split(os.sep)[0] for name in after.keys() - before.keys()}
    assert new == mistake.left
    assert {name: after[name] for name in before} == before
