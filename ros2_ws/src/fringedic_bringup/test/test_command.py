"""The command for real: the tiny virtual rig runs, is recorded, replayed and processed; every error is a sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import fringedic
from fringedic.recording import BagReader

CONFIG = Path(__file__).parent.parent / "config"
TINY = CONFIG / "tiny.yaml"


def fringedic_command(*words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    program = "from fringedic_bringup.command import main; main()"
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, words)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=240,
    )


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "tiny"
    ran = fringedic_command("run", TINY, "--output", folder)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    print(ran.stdout)
    return folder


@pytest.mark.slow
def test_a_run_leaves_recording_dataset_truth_and_pictures(recorded: Path) -> None:
    names = {path.name for path in recorded.iterdir()}
    assert {"bag", "results.nc", "report.html", "truth.nc", "calibration.yaml", "logs"} <= names
    assert {"step_002.png", "step_002_errors.png"} <= names
    counts = {name.removeprefix("/rig/"): count for name, count in BagReader(recorded / "bag").counts.items()}
    assert counts["camera/image_raw"] == counts["camera/exposure"] == 3 * 12
    assert counts["experiment/step"] == 3 * (12 + 3)
    assert counts["coupling/displacement"] == counts["coupling/status"] == 3
    with fringedic.open_experiment(recorded / "results.nc") as dataset:
        errors = fringedic.compare_with_truth(dataset, recorded / "truth.nc")
        assert list(dataset.step.values) == [0, 1, 2]
        moved = [float(abs(dataset.v.sel(step=step)).mean()) for step in (0, 1, 2)]
    assert moved[0] == 0 < moved[1] < moved[2]
    print({name: np.round(errors[name].values, 2) for name in errors.data_vars}, "µm RMS at 400 µm/px")
    assert float(errors.error_v.sel(step=2)) < 8  # 1/50 px


@pytest.mark.slow
def test_info_export_and_recover(recorded: Path, tmp_path: Path) -> None:
    shown = fringedic_command("info", recorded / "bag")
    assert shown.returncode == 0 and "/rig/camera/image_raw" in shown.stdout and "36" in shown.stdout
    exported = fringedic_command("export", recorded / "bag", "--output", tmp_path / "exported")
    assert exported.returncode == 0, exported.stderr
    assert (tmp_path / "exported" / "tiny.nc").exists()
    assert (tmp_path / "exported" / "tiny_png" / "step_001.png").exists()
    words = ("export", recorded / "results.nc", "--to", "csv", "--to", "netcdf", "--step", 1)
    again = fringedic_command(*words, "--output", tmp_path / "exported")
    assert again.returncode == 1 and "tiny.nc exists already" in again.stdout and "1 of 2 formats" in again.stderr
    assert (tmp_path / "exported" / "tiny_csv" / "step_001.csv").exists()
    saved = fringedic_command("recover", recorded / "bag", "--output", tmp_path / "saved")
    assert saved.returncode == 0, saved.stderr
    assert BagReader(tmp_path / "saved").counts == BagReader(recorded / "bag").counts


@pytest.mark.slow
def test_several_recordings_are_processed_and_the_bad_one_is_named(recorded: Path, tmp_path: Path) -> None:
    words = ("process", tmp_path / "nowhere", recorded / "bag", "--step", "1", "--reference", "2")
    done = fringedic_command(*words, "--output", tmp_path / "desk")
    assert done.returncode == 1
    assert "nowhere: no such recording" in done.stdout and done.stderr.strip() == f"not done: {tmp_path / 'nowhere'}"
    with fringedic.open_experiment(tmp_path / "desk" / "tiny.nc") as dataset:
        assert dataset.step.values.tolist() == [1, 2] and set(dataset.reference_step.values.tolist()) == {2}
        desk = dataset.load()
    words = ("replay", recorded / "bag", "--step", "1", "--reference", "2", "--output", tmp_path / "again")
    replayed = fringedic_command(*words)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert "2 steps, 24 frames, 0 problems" in replayed.stdout
    with fringedic.open_experiment(tmp_path / "again" / "bag") as dataset:
        for name in ("phase", "displacement_y", "w", "reference_step"):
            assert np.array_equal(dataset[name].values, desk[name].values, equal_nan=True), name
    assert fringedic_command(*words[:4], "--reference", "7", "--output", tmp_path / "x").returncode == 1


@pytest.mark.slow
def test_interrupting_a_run_closes_the_bag_and_leaves_nothing_behind(tmp_path: Path) -> None:
    process, say = start_run(tmp_path / "run", "--output", tmp_path / "run")
    wait_until(lambda: "step 2 of 3" in say(), "the second step", process)
    pids = [node_pid(tmp_path / "run", name) for name in ("recorder", "camera", "dic", "experiment")]
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert not BagReader(tmp_path / "run" / "bag").lost


@pytest.mark.slow
def test_nodes_do_not_outlive_a_killed_command(tmp_path: Path) -> None:
    process, say = start_run(tmp_path / "run", "--output", tmp_path / "run")
    wait_until(lambda: "step 1 of 3" in say(), "the first step", process)
    pids = [node_pid(tmp_path / "run", name) for name in ("recorder", "camera", "dic", "experiment")]
    process.kill()
    process.wait()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "the nodes' end")
    assert not BagReader(tmp_path / "run" / "bag").lost


def test_measuring_images_finds_their_shift(tmp_path: Path) -> None:
    import cv2
    from scipy.ndimage import gaussian_filter

    texture = gaussian_filter(np.random.default_rng(3).normal(size=(120, 160)), 1.5)
    image = np.clip(128 + 300 * texture, 0, 255).astype(np.uint8)
    for name, shift in (("a", 0), ("b", 2), ("c", 4)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.roll(image, shift, axis=1))
    words = [tmp_path / f"{name}.png" for name in "abc"]
    done = fringedic_command("measure", *words, "--window", "24", "--spacing", "4", "--output", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    import xarray as xr

    with xr.open_dataset(tmp_path / "out" / "displacement.nc", engine="h5netcdf") as field:
        medians = [float(field.displacement_x.isel(step=step).median()) for step in (0, 1)]
    assert np.allclose(medians, [2, 4], atol=0.02), medians
    assert (tmp_path / "out" / "c.png").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("run", "nowhere.yaml"), "no such rig file"),
        (("info", "nowhere"), "no such recording"),
        (("replay", "nowhere"), "no such recording"),
        (("process", "nowhere"), "no such recording"),
        (("measure", "one.png"), "at least one deformed image"),
        (("replay", "nowhere", "--set", "window"), "node.parameter=value"),
        (("run", "open_hole_tension.yaml", "--images", "nowhere"), "no images"),
    ],
)
def test_errors_are_one_sentence_and_exit_code_1(words: tuple[str, ...], sentence: str) -> None:
    done = fringedic_command(*words)
    assert done.returncode == 1
    assert sentence in done.stderr and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_every_command_helps_with_an_example() -> None:
    for name in ("run", "demo", "replay", "process", "info", "recover", "measure", "target", "export", "report"):
        shown = fringedic_command(name, "--help", COLUMNS="200")
        assert shown.returncode == 0 and f"Example: fringedic {name}" in shown.stdout, name


def start_run(folder: Path, *words: str | Path) -> tuple[subprocess.Popen[str], Callable[[], str]]:
    """Start a run; the second value returns what it has said."""
    output, errors = folder.with_name("output"), folder.with_name("errors")
    program = "from fringedic_bringup.command import main; main()"
    with output.open("w") as said, errors.open("w") as complaints:
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", program, "run", str(TINY), *map(str, words)],
            stdout=said,
            stderr=complaints,
            text=True,
        )
    return process, output.read_text


def node_pid(folder: Path, name: str) -> int:
    """Return the process of a node, known by its parameter file."""
    marker = str(folder / "logs" / f"{name}.yaml").encode()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if marker in (entry / "cmdline").read_bytes():
                    return int(entry.name)
            except OSError:
                continue
    raise AssertionError(f"no process of {name}")


def wait_until(done: Callable[[], bool], what: str, process: subprocess.Popen[str] | None = None) -> None:
    end = time.monotonic() + 90
    while not done():
        assert time.monotonic() < end, f"{what} did not come"
        assert process is None or process.poll() is None, "the command has ended"
        time.sleep(0.05)
