"""The subcommands of a campaign: what they print, and their exit codes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import fsspec
import pytest
from typer.testing import CliRunner

from fringedic.command import main
from fringedic.errors import CampaignError, ConfigurationError

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


def command(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(main.app, ["campaign", *words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, " ".join(done.output.split())


def test_a_campaign_from_its_file_to_its_catalogue(tmp_path: Path) -> None:
    folder = tmp_path / "batch"
    code, said = command("init", str(folder))
    assert (code, (folder / "campaign.yaml").is_file()) == (0, True)
    with pytest.raises(ConfigurationError, match="exists already"):
        command("init", str(folder))
    for name in ("plate-1", "plate-2"):
        shutil.copytree(RECORDED, folder / "recordings" / name)
    cut = folder / "recordings" / "plate-2" / "bag_0.mcap"
    whole = cut.read_bytes()
    cut.write_bytes(whole[:-9])
    code, said = command("plan", str(folder))
    assert code == 1
    assert "1 of 2 recordings, about 3 steps" in said
    assert "plate-2: bag_0.mcap has no index" in said
    with pytest.raises(CampaignError, match=r"--shard 3/2: write I/N"):
        command("run", str(folder), "--shard", "3/2")
    with pytest.raises(ConfigurationError, match="engine dask needs the --scheduler of a cluster; use processes"):
        command("run", str(folder), "--engine", "dask", "--workers", "2")
    refusing = [folder / "store" / name for name in ("begun", "failures")]  # as a disk that became read-only
    for each in refusing:
        each.write_text("")
    code, said = command("run", str(folder))
    assert code == 1
    assert "0 failed, 1 waiting" in said
    assert f"failed, and the store {folder / 'store'} cannot be written: make it writable and repeat" in said
    for each in refusing:
        each.unlink()
    code, said = command("run", str(folder))
    assert code == 1
    assert "1 of 1: plate-1: 3 steps" in said
    cut.write_bytes(whole)
    code, said = command("retry", str(folder))
    assert code == 0
    assert "1 of 1: plate-2: 3 steps" in said
    assert command("status", str(folder))[1].endswith("2 of 2 recordings complete, 0 failed, 0 waiting, 0 refused")
    code, said = command("open", str(folder))
    assert "fringedic.open_campaign" in said
    assert "batch 7" in said
    page = (folder / "campaign.html").read_text()
    assert page.count('alt="w of step 2') == 2
    assert "2 of 2 recordings complete" in page
    assert "<td>batch 7</td>" in page
    assert "mean axial strain" in page
    summary = json.loads((folder / "store" / "data-summary.json").read_text())["Campaign"]
    assert list(summary) == ["GeneralData", "Samples", "Diagnostics", "CampaignDescription"]
    assert summary["Samples"]["Materials"] == {"plate-1": "PMMA", "plate-2": "PMMA"}
    assert summary["Diagnostics"]["DigitalImageCorrelation (DIC)"]["plate-1"]["CameraResolution"] == "160x120"
    test = summary["CampaignDescription"]["plate-2"]
    assert (folder / "store" / test["Directories"]["Tests"]["Results"]).is_dir()
    assert test["Files"]["Recording"] == str(folder / "recordings" / "plate-2")
    compared(folder)
    file = folder / "campaign.yaml"
    file.write_text(file.read_text().replace("plate-*", "plate-1"))
    command("plan", str(folder))
    for name in ("open", "status"):
        assert "not opened: results of 1 recording that the plan does not contain" in command(name, str(folder))[1]


def compared(campaign: Path) -> None:
    """The datasets in a store are compared as a group."""
    recordings = sorted(str(each) for each in (campaign / "store" / "recordings").iterdir())
    words = ["compare", *recordings, recordings[0], "--output", str(campaign / "group.html")]
    done = CliRunner().invoke(main.app, words, catch_exceptions=False)
    assert "e_22: the spread of the specimens at a point is 0.00 times the uncertainty" in " ".join(done.output.split())
    assert (campaign / "group.html").is_file()
    for wrong, sentence in (([str(campaign), recordings[0]], "is a campaign"), (recordings[:1], "two or more")):
        with pytest.raises(ConfigurationError, match=sentence):
            CliRunner().invoke(main.app, ["compare", *wrong], catch_exceptions=False)


def test_a_scheduler_without_certificates_is_used_with_a_warning(tmp_path: Path) -> None:
    command("init", str(tmp_path / "batch"))
    shutil.copytree(RECORDED, tmp_path / "batch" / "recordings" / "plate-1")
    words = ["campaign", "run", str(tmp_path / "batch"), "--scheduler", "tcp://127.0.0.1:9"]
    done = CliRunner().invoke(main.app, words)
    assert "warning: whoever reaches tcp://127.0.0.1:9 can run programs as its user" in " ".join(done.output.split())
    assert "the Dask scheduler tcp://127.0.0.1:9 does not answer" in str(done.exception)


def test_recordings_in_an_object_store_have_addresses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = fsspec.filesystem("memory")
    files.put(str(RECORDED), "/laboratory/plate-1/bag", recursive=True)
    monkeypatch.chdir(tmp_path)
    try:
        for words in (["info"], ["process", "--set", "dic.spacing=8"]):
            done = CliRunner().invoke(main.app, [*words, "memory://laboratory/plate-1"], catch_exceptions=False)
            assert done.exit_code == 0
            assert "memory://laboratory/plate-1" in " ".join(done.output.split())
    finally:
        files.rm("/laboratory", recursive=True)
    assert (tmp_path / "plate-1.nc").is_file()
