"""Named evaluations of a recorded run: beside the results, listed, previewed, in the log, with a report."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fringedic.audit.results import datasets_of
from fringedic.command.main import app
from fringedic.datasets import open_experiment, process_bag
from fringedic.datasets.attributes import image_size
from fringedic.errors import ConfigurationError, DatasetError
from fringedic.evaluation import EvaluationSettings, evaluate, evaluations
from fringedic.evidence import begin_log, read_log
from fringedic.frames.region import Region

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A signed run with an evaluation 'coarse', made by the command."""
    folder = tmp_path_factory.mktemp("named")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(folder / "configuration"))
        run = folder / "plate-7"
        shutil.copytree(RECORDED, run / "bag")
        process_bag(run / "bag", output=run / "results.nc")
        begin_log(run, "run", details={})
        (run / "part.yaml").write_text(part_of(run).to_text())
        words = ["evaluate", str(run), "--name", "coarse", "--set", "dic.window=40", "--reference", "1"]
        words += ["--region", str(run / "part.yaml"), "--extensometer", "own=40,60,90,60", "--why", "less noise"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    return run


def part_of(run: Path) -> Region:
    """The left part of the image."""
    with open_experiment(run) as dataset:
        width, height = image_size(dataset) or (0, 0)
    return replace(Region.rectangle((0, 0), (0.7 * width, height - 1)), width=width, height=height)


def test_evaluation_is_measured_with_its_settings_and_the_results_stay(run: Path) -> None:
    [found] = evaluations(run)
    assert (found.name, found.dataset) == ("coarse", run / "evaluations" / "coarse" / "coarse.nc")
    assert found.settings.overrides == {"dic.window": 40}
    assert found.settings.reference == 1
    with open_experiment(run) as original, open_experiment(found.dataset) as dataset:
        assert set(original.reference_step.values) == {0}
        assert set(dataset.reference_step.values) == {1}
        assert 'window": 40' in dataset.attrs["parameters"]
        right = dataset.column.values > 0.7 * dataset.column.values[-1] + 2
        assert np.isfinite(original.displacement_x.isel(column=right)).any()
        assert not np.isfinite(dataset.displacement_x.isel(column=right)).any()
        assert np.isfinite(dataset.displacement_x.isel(column=~right)).any()
    page = found.report.read_text("utf-8")
    assert (
        "Evaluation coarse: dic.window = 40; reference step 1; another region; other extensometers; less noise" in page
    )
    assert "own: (40, 60) to (90, 60)" in page
    assert not (run / "report.html").exists()


def test_log_and_audit_contain_the_evaluation(run: Path) -> None:
    last = [entry for entry in read_log(run).entries if entry.action == "evaluation"][-1]
    assert last.why == "less noise"
    assert last.details["evaluation"]["coarse"]["overrides"] == {"dic.window": 40}
    assert "evaluations/coarse/coarse.nc" in last.files
    assert run / "evaluations" / "coarse" / "coarse.nc" in datasets_of(run, run / "bag")


def test_preview_keeps_nothing_and_compares_with_the_measured_step(run: Path, tmp_path: Path) -> None:
    entries = len(read_log(run).entries)
    words = ["evaluate", str(run), "--set", "dic.window=40", "--preview", "1", "--output", str(tmp_path / "seen")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    content = json.loads((tmp_path / "seen" / "preview.json").read_text())
    rows = {row["quantity"]: row for row in content["rows"]}
    assert rows["mean w"]["before"] != rows["mean w"]["after"]
    assert (tmp_path / "seen" / "after.png").is_file()
    assert [each.name for each in evaluations(run)] == ["coarse"]
    assert len(read_log(run).entries) == entries


@pytest.mark.parametrize("name", ["../up", "", "results", "a b", "x" * 61, "coarse"])
def test_names_that_are_none_or_in_use_are_refused(run: Path, name: str) -> None:
    with pytest.raises(DatasetError, match=r"give letters, digits|not replaced, choose another name"):
        evaluate(run, name, EvaluationSettings())


def test_an_evaluation_that_fails_leaves_nothing(run: Path) -> None:
    with pytest.raises(ConfigurationError, match="windw"):
        evaluate(run, "broken", EvaluationSettings(overrides={"dic.windw": 3}))
    assert not (run / "evaluations" / "broken").exists()
    done = CliRunner().invoke(app, ["evaluate", str(run)])
    assert done.exit_code == 0
    assert "coarse: {" in done.output
