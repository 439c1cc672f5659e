"""Bad input at the door of the commands: one sentence on the error stream and exit code 1, and nothing was started."""

from __future__ import annotations

import shutil
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

from fringedic.command.main import main
from fringedic.errors import ImageError
from fringedic.frames.files import read_grey

SOURCES = Path(__file__).parents[2]
RIGS = SOURCES / "fringedic_bringup" / "config"
RECORDED = SOURCES / "fringedic" / "test" / "recordings" / "version_0_1"
Refusal = Callable[..., str]


@pytest.fixture
def refusal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refusal:
    """Return the function that runs the command and returns the sentence with which it ends."""

    def run(*words: str | Path) -> str:
        monkeypatch.setattr(sys, "argv", ["fringedic", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 1
        [sentence] = capsys.readouterr().err.strip().splitlines()
        assert len(sentence) <= 500 + max(len(str(word)) for word in words)
        return sentence

    return run


def run_command(monkeypatch: pytest.MonkeyPatch, *words: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["fringedic", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return three images of a speckle that moves by a pixel each."""
    folder = tmp_path_factory.mktemp("images")
    speckle = gaussian_filter(np.random.default_rng(5).normal(size=(110, 120)), 1.5)
    grey = np.clip(128 + 40 * speckle / speckle.std(), 0, 255).astype(np.uint8)
    files = [folder / f"image_{number}.tif" for number in range(3)]
    for number, file in enumerate(files):
        cv2.imwrite(str(file), grey[5:101, 10 - number : 106 - number])
    return files


@pytest.fixture(scope="module")
def fringes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of four shifted fringe images with their description."""
    folder = tmp_path_factory.mktemp("fringes")
    noise = np.random.default_rng(6).normal(size=(4, 100, 120))
    names = [f"shift-{number}.png" for number in range(4)]
    for number, name in enumerate(names):
        wave = 128 + 80 * np.cos(2 * np.pi * (np.arange(120) / 40 - number / 4))
        cv2.imwrite(str(folder / name), np.round(wave + noise[number]).astype(np.uint8))
    (folder / "phase.yaml").write_text(
        f"projector_px: 120\nfringes: [{{pitch_px: 120.0, images: [{', '.join(names)}]}}]\n"
    )
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ("run", RIGS / "tiny.yaml"),
        ("calibrate", RIGS / "tiny.yaml"),
        ("check", RIGS / "tiny.yaml"),
        ("timing", RIGS / "tiny.yaml"),
        ("response", RIGS / "tiny.yaml"),
        ("noise", RIGS / "tiny.yaml"),
        ("noise", "--images", "a.png", "--images", "b.png", "--images", "c.png"),
        ("measure", "a.png", "b.png"),
        ("target", "--pitch-mm", "0.5"),
        ("region", "a.png"),
        ("replay", RECORDED / "bag"),
        ("demo",),
    ],
)
@pytest.mark.parametrize("place", ["a file", "read-only"])
def test_output_that_cannot_be_written(
    words: tuple[str | Path, ...], place: str, refusal: Refusal, tmp_path: Path
) -> None:
    """The kernel's folder /proc is read-only for everybody."""
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" if place == "a file" else Path("/proc/sys/kernel")
    output = folder / ({"target": "grid.pdf", "region": "region.png"}.get(str(words[0]), "new"))
    sentence = refusal(*words, "--output", output)
    assert str(folder) in sentence
    assert "choose another" in sentence


@pytest.mark.parametrize("command", ["run", "calibrate", "info", "process", "report", "export", "region", "measure"])
def test_path_of_300_characters(command: str, refusal: Refusal) -> None:
    long = Path("x" * 300)
    sentence = refusal(command, long, *([long] if command == "measure" else []))
    assert "x" * 300 in sentence
    assert "name too long" in sentence.lower()


def test_existing_results_are_not_replaced_unasked(
    images: list[Path], refusal: Refusal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    measured = ("measure", *images, "--spacing", "8", "--output", tmp_path / "measured")
    assert run_command(monkeypatch, *measured) == 0
    before = (tmp_path / "measured" / "displacement.nc").read_bytes()
    assert "displacement.nc exists already" in refusal(*measured)
    assert run_command(monkeypatch, *measured, "--window", "24", "--overwrite") == 0
    assert (tmp_path / "measured" / "displacement.nc").read_bytes() != before
    (tmp_path / "again.pdf").write_text("previous")
    report = ("report", tmp_path / "measured" / "displacement.nc", "--output", tmp_path / "again.html", "--pdf")
    assert "again.pdf exists already" in refusal(*report)
    assert (tmp_path / "again.pdf").read_text() == "previous"
    (tmp_path / "measured" / "displacement.nc").unlink()
    assert "report.html exists already" in refusal(*measured)
    assert not (tmp_path / "measured" / "displacement.nc").exists()
    target = ("target", "--pitch-mm", "0.5", "--output", tmp_path / "new" / "grid.pdf")
    assert run_command(monkeypatch, *target) == 0
    assert "grid.pdf exists already" in refusal(*target)
    assert run_command(monkeypatch, *target, "--overwrite") == 0


@pytest.mark.parametrize("existing", ["phase.nc", "phase.png"])
def test_phase_replaces_neither_dataset_nor_picture(
    existing: str, fringes: Path, refusal: Refusal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "phases" / existing
    file.parent.mkdir()
    file.write_text("previous")
    words = ("phase", fringes, "--output", file.parent)
    assert f"{existing} exists already" in refusal(*words)
    assert file.read_text() == "previous"
    assert run_command(monkeypatch, *words, "--overwrite") == 0
    assert file.read_bytes() != b"previous"


def test_recordings_of_the_same_name_have_datasets_of_their_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bags = [tmp_path / folder / "plate" / "bag" for folder in ("spring", "autumn")]
    for bag in bags:
        shutil.copytree(RECORDED / "bag", bag)
    assert run_command(monkeypatch, "process", *bags, "--output", tmp_path / "again") == 0
    assert {file.name for file in (tmp_path / "again").iterdir()} == {"spring_plate.nc", "autumn_plate.nc"}


@pytest.mark.parametrize("command", ["export", "report"])
def test_results_of_another_kind(command: str, refusal: Refusal, tmp_path: Path) -> None:
    xr.Dataset({"a": ("b", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    assert "is no experiment" in refusal(command, tmp_path / "other.nc", "--output", tmp_path / "out")
    (tmp_path / "text.nc").write_text("text")
    assert "cannot be read as NetCDF" in refusal(command, tmp_path / "text.nc", "--output", tmp_path / "out")


def test_results_of_images_are_exported_and_reported(
    images: list[Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scale = ("--pixel-size-mm", "0.05", "--spacing", "8")
    scale += ("--strain-measure", "engineering")
    assert run_command(monkeypatch, "measure", *images, *scale, "--output", tmp_path / "measured") == 0
    dataset = tmp_path / "measured" / "displacement.nc"
    formats = [word for name in ("vtk", "csv", "mat", "png") for word in ("--to", name)]
    assert run_command(monkeypatch, "export", dataset, *formats, "--output", tmp_path / "out") == 0
    assert (tmp_path / "out" / "displacement_vtk" / "step_002.vtp").exists()
    heading = (tmp_path / "out" / "displacement_csv" / "step_002.csv").read_text("utf-8-sig").splitlines()[0]
    assert "u [µm]" in heading
    assert "e_xx [µstrain] engineering" in heading
    page = tmp_path / "page.html"
    gauge = ("--extensometer", "middle=20,48,80,48")
    assert run_command(monkeypatch, "report", dataset, *gauge, "--output", page) == 0
    assert "middle: (20, 48) to (80, 48)" in page.read_text("utf-8")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "bench.yaml: no such rig file"),
        ("camera: [", "bench.yaml: is not YAML: line 1"),
        ("camera: {source: webcam}", "bench.yaml: camera: source 'webcam' is unknown; known are virtual, files"),
    ],
)
def test_page_of_a_rig_that_is_missing_or_wrong(
    content: str | None, words: str, refusal: Refusal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / "bench.yaml").write_text(content)
    assert words in refusal("operate", "bench.yaml")


@pytest.mark.parametrize("command", ["process", "measure"])
def test_full_disk(
    command: str, images: list[Path], refusal: Refusal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100_000))
    options = (RECORDED / "bag", "--step", "1", "--output", tmp_path / "new.nc")
    sentence = refusal(command, *(options if command == "process" else (*images, "--output", tmp_path / "measured")))
    assert "the disk is full, step" in sentence
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == []


def test_phase_on_a_full_disk_keeps_the_previous_dataset(
    fringes: Path, refusal: Refusal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100_000))
    (tmp_path / "phase.nc").write_text("previous")
    assert "the disk is full" in refusal("phase", fringes, "--output", tmp_path, "--overwrite")
    assert [file.name for file in tmp_path.iterdir()] == ["phase.nc"]
    assert (tmp_path / "phase.nc").read_text() == "previous"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("step,load\n0,0\n1,100,5\n", "line 3 has 3 cells, the heading has 2"),
        ("step;load\n0;0\n", "is no table of loads; write a CSV with the columns step,load"),
        ("step,load\n0.5,0\n", "line 2 has no number of a step and load"),
        ("step,load\n0,nan\n", "line 2 repeats step 0, or its load nan is not finite"),
        ("step,load\n1,5\n1,7\n", "line 3 repeats step 1"),
        ("step,load\n", "contains no load"),
        (f"step,load\n1,{'5' * 200_000}\n", "cannot be read as a table"),
    ],
)
def test_load_table_that_cannot_be_read(table: str, words: str, refusal: Refusal, tmp_path: Path) -> None:
    (tmp_path / "loads.csv").write_text(table)
    options = ("--unit", "mm", "--load-table", tmp_path / "loads.csv", "--output", tmp_path / "compared")
    assert words in refusal("compare-model", RECORDED / "bag", "m.stl", *options)


def png_header(width: int, height: int) -> bytes:
    """Return a PNG file that promises an image of 16 bits and contains almost none of it."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("size", [(30_000, 30_000), (2**31 - 1, 2**31 - 1), (0, 0), (2**31 - 1, 1)])
def test_image_with_a_huge_header(size: tuple[int, int], tmp_path: Path) -> None:
    file = tmp_path / "huge.png"
    file.write_bytes(png_header(*size))
    with pytest.raises(ImageError, match=r"huge\.png") as refused:
        read_grey(file)
    assert len(str(refused.value)) <= 500 + len(str(file))


def test_image_of_several_pages(images: list[Path], refusal: Refusal, tmp_path: Path) -> None:
    pages = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in images]
    cv2.imwritemulti(str(tmp_path / "stack.tif"), pages)
    sentence = refusal("measure", images[0], tmp_path / "stack.tif", "--output", tmp_path / "measured")
    assert "stack.tif has 3 pages" in sentence


@pytest.mark.parametrize(
    "setting", ["dic.window=2026-02-30", "dic.window=[", "dic.window={a: 1, a: 2}", "dic.window=x"]
)
def test_settings_that_are_no_values(setting: str, refusal: Refusal, tmp_path: Path) -> None:
    sentence = refusal("process", RECORDED / "bag", "--set", setting, "--output", tmp_path / "new.nc")
    assert "dic.window" in sentence
