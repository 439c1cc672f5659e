"""Without the packages of the extras everything is measured, and what they are needed for says so."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

RECORDING = Path(__file__).parent / "recordings" / "version_0_1" / "bag"
SCRIPT = """
    import json, sys
    from pathlib import Path

    for package in ("matplotlib", "plotly", "pyvista", "zarr", "jinja2", "PIL"):
        sys.modules[package] = None

    import fringedic

    recording, folder = map(Path, sys.argv[1:])
    file = fringedic.process_bag(recording, output=folder / "results.nc", steps=[1])
    said = {}
    with fringedic.open_experiment(file) as dataset:
        found = {"measured": float(dataset.w.sel(step=1).notnull().mean())}
        gauge = dataset.fringedic.extensometer((40, 60), (120, 60), subset=9)
        found["strain"] = float(gauge.strain.sel(step=1))
        formats = ["netcdf", "csv", "ply", "mat", "tiff", "r3xa", "zarr", "vtk", "png", "gif"]
        done = dataset.fringedic.export(folder / "exported", formats)
        found["written"] = [each.format for each in done if each.path is not None]
        said |= {each.format: each.problems[0] for each in done if each.path is None}
    for name, task in {
        "report": lambda: fringedic.write_report(file),
        "zarr dataset": lambda: fringedic.process_bag(recording, output=folder / "results.zarr"),
    }.items():
        try:
            task()
        except fringedic.FringedicError as error:
            said[name] = str(error)
    print(json.dumps({**found, "said": said}))
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    folder = tmp_path_factory.mktemp("bare")
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT), str(RECORDING), str(folder)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_recording_is_measured_and_probed(found: dict[str, float]) -> None:
    assert found["measured"] > 0.5
    assert abs(found["strain"]) < 0.05


def test_formats_that_need_no_extra_are_written(found: dict[str, list[str]]) -> None:
    assert found["written"] == ["netcdf", "csv", "ply", "mat", "tiff", "r3xa"]


@pytest.mark.parametrize(
    ("task", "sentence"),
    [
        ("zarr", "a Zarr dataset needs zarr: pip install 'fringedic[zarr]'"),
        ("zarr dataset", "a Zarr dataset needs zarr: pip install 'fringedic[zarr]'"),
        ("vtk", "a file for ParaView needs pyvista: pip install 'fringedic[paraview]'"),
        ("png", "drawing needs matplotlib: pip install 'fringedic[figures]'"),
        ("gif", "drawing needs PIL: pip install 'fringedic[figures]'"),
        ("report", "a report needs plotly: pip install 'fringedic[report]'"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(found: dict[str, dict[str, str]], task: str, sentence: str) -> None:
    assert found["said"][task] == sentence
