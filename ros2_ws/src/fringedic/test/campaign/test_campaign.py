"""Campaigns: the results are those of the desk, whatever happens on the way."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rewritten import copy_topics

import fringedic
from fringedic.campaign import (
    Campaign,
    CampaignStore,
    Failure,
    Plan,
    Receipt,
    Serial,
    current_plan,
    forget_failures,
    load_campaign,
    process_unit,
    read_plan,
    status_of,
    unit,
    update_plan,
)
from fringedic.campaign.group_store import GroupStore
from fringedic.campaign.opening import open_group
from fringedic.campaign.plan import plan_of, predicted_memory
from fringedic.campaign.recordings import Found, summarise
from fringedic.campaign.run import damaged
from fringedic.campaign.sentences import (
    CampaignProgress,
    plan_sentences,
    status_sentences,
    verification_sentences,
)
from fringedic.campaign.settings import RecordingEntry
from fringedic.datasets.processing import process_into
from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import CampaignError, ConfigurationError, DatasetError
from fringedic.recording import BagReader, BagWriter
from fringedic.steps.recorded_parameters import RecordedParameters

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
NAMES = ["plate-1", "plate-2"]


def written(folder: Path, **content: object) -> Campaign:
    """A campaign over all recordings of a folder."""
    entries = {"recordings": [{"path": "recordings", "group": "batch 7"}], **content}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(entries))
    return load_campaign(folder)


def copied(folder: Path, *names: str) -> Path:
    for name in names:
        shutil.copytree(RECORDED, folder / "recordings" / name / "bag")
    return folder


def run(campaign: Campaign, *, recompute: bool = False) -> dict[str, Receipt | Failure]:
    plan = current_plan(campaign, recompute=recompute)
    waiting = status_of(CampaignStore(campaign.store), plan).waiting
    return {outcome.name: outcome for outcome in Serial().outcomes(waiting)}


def objects(campaign: Campaign) -> dict[str, tuple[int, int]]:
    """Size and time of writing of every object of the results."""
    files = [path for path in Path(campaign.store, "recordings").rglob("*") if path.is_file()]
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in files}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = copied(tmp_path_factory.mktemp("campaign"), *NAMES)
    campaign = written(folder, title="plates", settings={"dic.window": 24})
    assert set(run(campaign)) == set(NAMES)
    return campaign


def test_results_are_those_of_the_desk_bit_by_bit(done: Campaign, tmp_path: Path) -> None:
    file = fringedic.process_bag(RECORDED, output=tmp_path / "desk.nc", overrides={"dic.window": 24})
    tree, _ = fringedic.open_campaign(done.folder)
    with fringedic.open_experiment(file) as desk:
        for name in NAMES:
            found = tree[name].to_dataset()
            assert found.identical(desk.load())
            assert np.isfinite(found.w).mean() > 0.5


def test_every_chunk_is_one_map_of_one_step(done: Campaign) -> None:
    tree, _ = fringedic.open_campaign(done.store)
    maps = [variable for variable in tree["plate-1"].data_vars.values() if variable.ndim == 3]
    assert len(maps) > 30
    assert {variable.encoding["chunks"] for variable in maps} == {(1, 120, 160)}


def test_catalogue_has_labels_and_figures_with_their_uncertainty(done: Campaign) -> None:
    _, catalogue = fringedic.open_campaign(done.folder / "campaign.yaml")
    assert catalogue.index.tolist() == NAMES
    row = catalogue.loc["plate-1"]
    assert (row["group"], row["experiment"], row["steps"], row["failed_steps"]) == ("batch 7", "tiny", 3, 0)
    assert (row["reference_step"], row["reference_steps"]) == (0, "0")
    assert 0 < row["sigma_largest_strain"] < 0.1 * row["largest_strain"]
    assert abs(row["poisson_ratio"] - 0.33) < 3 * row["sigma_poisson_ratio"] < 0.03
    assert np.isnan(row["modulus"])  # the recording contains no section
    assert row["software"] == f"fringedic {fringedic.__version__}"


def test_the_example_of_the_page_draws_all_specimens(
    done: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[5] / "docs" / "campaigns.md").read_text("utf-8")
    code = page.split("```python\n", 1)[1].split("```", 1)[0]
    (tmp_path / "batch-7").symlink_to(done.folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, Any] = {}
    exec(compile(code, "campaigns.md", "exec"), names)
    assert (tmp_path / "batch-7.png").stat().st_size > 5000
    assert len(names["pyplot"].gca().get_legend().get_texts()) == 2
    names["pyplot"].close()


def test_a_second_run_writes_nothing(done: Campaign) -> None:
    before = objects(done)
    assert run(done) == {}
    plan = current_plan(done)
    assert process_unit(plan.units[0]) == status_of(CampaignStore(done.store), plan).done["plate-1"]
    assert objects(done) == before


def test_without_receipts_the_same_bytes_are_written_again(done: Campaign) -> None:
    store, plan = CampaignStore(done.store), current_plan(done)
    before = status_of(store, plan).done
    store.remove("receipts")
    unit = plan.units[0]
    with ThreadPoolExecutor(2) as two:
        first, second = two.map(process_unit, [unit, unit])
    assert first.digest == second.digest == before[unit.name].digest
    assert first.objects > 100
    again = run(done)
    assert set(again) == {"plate-2"}
    assert status_of(store, plan).done["plate-2"] == again["plate-2"]
    assert status_of(store, plan).done["plate-2"].digest == before["plate-2"].digest


def test_a_reader_sees_an_object_as_a_whole_while_a_worker_writes_it(tmp_path: Path) -> None:
    store = CampaignStore(str(tmp_path))
    store.write("plan.json", {"title": "first"})
    with (tmp_path / "plan.json").open() as opened:
        store.write("plan.json", {"title": "second"})
        assert json.load(opened)["title"] == "first"
    assert store.read("plan.json") == {"title": "second"}
    assert [file.name for file in tmp_path.iterdir()] == ["plan.json"]


def test_segments_differ_far_less_than_the_uncertainty(done: Campaign, tmp_path: Path) -> None:
    """Without the steps that are measured before a segment the difference would be 0.2 sigma."""
    shutil.copytree(done.folder / "recordings" / "plate-1", tmp_path / "recordings" / "plate-1")
    campaign = written(tmp_path, settings={"dic.window": 24}, segments=2)
    (unit,) = update_plan(campaign).units
    store = CampaignStore(campaign.store)
    parts = [process_unit(part) for part in unit.parts]
    assert [part.figures["steps"] for part in parts] == [1, 2]
    joined = process_unit(unit)
    assert [each.name for each in Path(campaign.store, "recordings").iterdir()] == ["plate-1"]  # the parts are removed
    store.remove("receipts")
    assert process_unit(unit).digest == joined.digest  # it has processed the parts itself
    whole, segmented = (fringedic.open_campaign(each.folder)[0]["plate-1"].to_dataset() for each in (done, campaign))
    assert segmented.attrs == whole.attrs
    assert segmented.isel(step=[0]).identical(whole.isel(step=[0]))
    for name in ("u", "v", "w", "e_11", "e_22"):
        ratio = ((segmented[name] - whole[name]) / whole[f"sigma_{name}"]).isel(step=2)
        assert float(np.sqrt((ratio**2).mean())) < 0.01, name
    assert segmented.w.isel(step=2).notnull().equals(whole.w.isel(step=2).notnull())


def test_parts_of_a_campaign_share_its_units_whenever_they_start(done: Campaign, tmp_path: Path) -> None:
    shutil.copytree(done.folder / "recordings", tmp_path / "recordings")
    campaign = written(copied(tmp_path, "plate-3"), settings={"dic.window": 24})
    plan = update_plan(campaign)
    store = CampaignStore(campaign.store)
    first = digests(Serial().outcomes(status_of(store, plan).share(1, 2)))
    second = digests(Serial().outcomes(status_of(store, plan).share(2, 2)))
    assert (set(first), set(second)) == ({"plate-1", "plate-3"}, {"plate-2"})
    before = status_of(CampaignStore(done.store), current_plan(done)).done
    assert {name: (first | second)[name] for name in NAMES} == {name: before[name].digest for name in NAMES}


def digests(outcomes: Iterable[Receipt | Failure]) -> dict[str, str]:
    return {outcome.name: outcome.digest for outcome in outcomes if isinstance(outcome, Receipt)}


def test_images_of_another_size_are_unusual(done: Campaign) -> None:
    summary = summarise(str(RECORDED))
    found = [(Found(name, name, RecordingEntry(path="")), summary) for name in ("a", "b")]
    other = (Found("c", "c", RecordingEntry(path="")), replace(summary, image_shape=(60, 80)))
    plan = plan_of(done, [*found, other])
    assert plan.unusual_shapes == {"c": (60, 80)}
    assert Plan.from_document(json.loads(json.dumps(plan.to_document()))) == plan
    assert "odd: c has images of 80x60 px, unlike most recordings" in plan_sentences(plan)


def test_a_receipt_that_a_killed_process_left_unfinished_counts_as_none(done: Campaign) -> None:
    receipt = Path(done.store, "receipts", "plate-2.json")
    receipt.write_text(receipt.read_text()[:-10])
    with pytest.raises(CampaignError, match=r"receipts/plate-2\.json is missing or not complete.* campaign run"):
        fringedic.open_campaign(done.store)
    assert set(run(done)) == {"plate-2"}
    assert "plate-2" in fringedic.open_campaign(done.store)[1].index


@pytest.mark.parametrize("reason", ["it is being processed", "it failed", "it is not processed yet"])
def test_a_removed_receipt_is_named_unless_the_recording_waits(done: Campaign, tmp_path: Path, reason: str) -> None:
    store = CampaignStore(str(shutil.copytree(done.store, tmp_path / "store")))
    store.remove("receipts/plate-2.json")
    with pytest.raises(CampaignError, match=r"receipts/plate-2\.json is missing"):
        fringedic.open_campaign(store.address)
    if reason == "it is not processed yet":
        store.remove("recordings/plate-2/zarr.json")
    else:
        folder = "begun" if reason == "it is being processed" else "failures"
        store.write(f"{folder}/plate-2.json", {"name": "plate-2"})
    assert list(fringedic.open_campaign(store.address)[1].index) == ["plate-1"]


def test_damage_of_a_store_is_named(done: Campaign, tmp_path: Path) -> None:
    store = CampaignStore(str(shutil.copytree(done.store, tmp_path / "store")))
    status = status_of(store, read_plan(store))
    assert damaged(store, status) == []
    chunk = tmp_path / "store" / "recordings" / "plate-2" / "w" / "c" / "2" / "0" / "0"
    chunk.unlink()
    assert damaged(store, status) == ["plate-2"]
    assert "plate-2" in verification_sentences(status, ["plate-2"])[0]
    tree, _ = fringedic.open_campaign(store.address)
    with pytest.raises(DatasetError, match=r"plate-2 is damaged: map 'w' of step 2 .* is missing"):
        tree["plate-2"].to_dataset()["w"].load()
    receipt = tmp_path / "store" / "receipts" / "plate-1.json"
    text = receipt.read_text()
    for changed in (text.replace('"steps": 3', '"steps": 8'), text.replace('"steps": 3', '"steps": x')):
        receipt.write_text(changed)
        with pytest.raises(CampaignError, match=r"receipts/plate-1\.json is damaged"):
            fringedic.open_campaign(store.address)


def test_bad_recordings_are_named_and_the_others_finish(tmp_path: Path) -> None:
    campaign = written(copied(tmp_path, "good", "cut", "uncalibrated", "changing"))
    cut = tmp_path / "recordings" / "cut" / "bag" / "bag_0.mcap"
    cut.write_bytes(cut.read_bytes()[:-5000])
    bag = tmp_path / "recordings" / "uncalibrated" / "bag"
    without("calibration", bag)
    plan = update_plan(campaign)
    assert set(plan.refused) == {"cut", "uncalibrated"}
    assert "recover" in plan.refused["cut"]
    assert "calibration" in plan.refused["uncalibrated"]
    with (tmp_path / "recordings" / "changing" / "bag" / "bag_0.mcap").open("ab") as file:
        file.write(b"more")
    waiting = status_of(CampaignStore(campaign.store), plan).waiting
    outcomes = {outcome.name: outcome for outcome in Serial().outcomes(waiting)}
    assert isinstance(outcomes["good"], Receipt)
    assert isinstance(outcomes["changing"], Failure)
    assert "changing" in outcomes["changing"].reason
    status = status_of(CampaignStore(campaign.store), plan)
    assert (set(status.done), set(status.failed), status.waiting) == ({"good"}, {"changing"}, [])
    assert not status.complete
    forget_failures(CampaignStore(campaign.store))
    assert [unit.name for unit in status_of(CampaignStore(campaign.store), plan).waiting] == ["changing"]


def without(topic: str, bag: Path) -> None:
    """Write a recording again without one of its topics."""
    new = copy_topics(bag, bag.with_name("new"), without=[topic])
    shutil.rmtree(bag)
    new.rename(bag)


def test_a_recording_that_changes_while_it_is_read_is_not_committed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = written(copied(tmp_path, "plate"))
    (planned,) = update_plan(campaign).units

    def process_and_change(*arguments: Any) -> None:
        process_into(*arguments)
        with (Path(planned.path) / "bag_0.mcap").open("ab") as file:
            file.write(b"more")

    monkeypatch.setattr(unit, "process_into", process_and_change)
    (failure,) = Serial().outcomes([planned])
    assert isinstance(failure, Failure)
    assert "bag_0.mcap has no index" in failure.reason
    assert not list(Path(campaign.store).glob("receipts/*"))


def test_the_plan_of_a_thousand_recordings_takes_little_memory(done: Campaign) -> None:
    summary = summarise(str(RECORDED))

    def peak(count: int) -> int:
        found = ((Found(f"plate-{number}", str(RECORDED), RecordingEntry(path="")), summary) for number in range(count))
        tracemalloc.start()
        plan = plan_of(done, found)
        _, largest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(plan.units) == count
        return largest

    assert peak(1000) - peak(100) < 900 * 3000  # [byte]


def test_an_interrupted_recording_is_begun_again_and_says_so(done: Campaign) -> None:
    store, plan = CampaignStore(done.store), current_plan(done)
    store.remove("receipts/plate-2.json")
    key = plan.units[1].settings_key
    store.write("begun/plate-2.json", {"key": key, "attempts": 1, "steps": 0, "worker": "computer:1"})
    assert "begun: plate-2 by computer:1" in status_sentences(status_of(store, plan))
    receipt = run(done)["plate-2"]
    assert isinstance(receipt, Receipt)
    assert receipt.attempts == 2
    assert CampaignProgress([]).sentence(receipt, 1.0).endswith(", 1 retried")
    assert status_of(store, plan).begun == {}


def test_changed_settings_are_refused_or_computed_again(done: Campaign, tmp_path: Path) -> None:
    folder = copied(tmp_path, "plate-1")
    shutil.copytree(done.store, folder / "store")
    changed = written(folder, settings={"dic.window": 32})
    before = objects(changed)
    with pytest.raises(CampaignError, match=r"other settings.*plate-1.*--recompute"):
        run(changed)
    assert objects(changed) == before
    assert set(run(changed, recompute=True)) == {"plate-1"}
    tree, _ = fringedic.open_campaign(folder)
    file = fringedic.process_bag(RECORDED, output=tmp_path / "desk.nc", overrides={"dic.window": 32})
    with fringedic.open_experiment(file) as desk:
        assert tree["plate-1"].to_dataset().identical(desk.load())


def test_a_calibration_replaces_the_recorded_one(tmp_path: Path) -> None:
    reader = BagReader(RECORDED)
    _, message, _ = next(reader.messages(reader.find("calibration").values()))
    calibration = tmp_path / "calibration.yaml"
    replace(fringedic.RigModel.from_message(message), projector_rotation=(0.0, 0.0, 0.001)).to_yaml(calibration)
    entries = [{"path": "recordings/plate", "calibration": "calibration.yaml"}, {"path": "recordings/recorded"}]
    campaign = written(copied(tmp_path, "plate", "recorded"), recordings=entries, reference=1)
    assert [bool(unit.settings.calibration) for unit in update_plan(campaign).units] == [True, False]
    campaign = written(tmp_path, recordings=entries[:1], reference=1)
    run(campaign)
    model = fringedic.RigModel.from_yaml(calibration)
    file = fringedic.process_bag(RECORDED, output=tmp_path / "desk.nc", calibration=model, reference=1)
    tree, _ = fringedic.open_campaign(tmp_path)
    with fringedic.open_experiment(file) as desk:
        assert tree["plate"].to_dataset().identical(desk.load())


def test_a_recording_that_was_continued_is_another_one(done: Campaign, tmp_path: Path) -> None:
    """The campaign was said to be complete without its later steps."""
    campaign = written(copied(tmp_path, *NAMES), settings={"dic.window": 24})
    shutil.copytree(Path(done.store), Path(campaign.store))
    assert run(campaign) == {}
    bag = tmp_path / "recordings" / "plate-2" / "bag"
    shutil.rmtree(bag)
    with BagWriter(bag, compression="none") as writer:
        for topic in BagReader(RECORDED).topics.values():
            writer.add_recorded_topic(topic)
        for message in BagReader(RECORDED).stored():
            writer.write(*message)
    with pytest.raises(CampaignError, match=r"plate-2.*--recompute"):
        current_plan(campaign)


def test_corrected_labels_take_effect_without_a_computation(done: Campaign, tmp_path: Path) -> None:
    settings = {"dic.window": 24}
    campaign = written(copied(tmp_path, *NAMES), settings=settings)
    shutil.copytree(Path(done.store), Path(campaign.store))
    assert run(campaign) == {}
    before = objects(campaign)
    corrected = [{"path": "recordings", "group": "batch 8", "material": "PMMA"}]
    campaign = written(tmp_path, settings=settings, recordings=corrected)
    assert run(campaign) == {}
    assert objects(campaign) == before
    status = status_of(CampaignStore(campaign.store), current_plan(campaign))
    assert [receipt.labels["group"] for receipt in status.done.values()] == ["batch 8"] * 2
    _, catalogue = fringedic.open_campaign(tmp_path)
    assert set(zip(catalogue.group, catalogue.material, strict=True)) == {("batch 8", "PMMA")}


@pytest.mark.parametrize("growing", [False, True], ids=["complete", "being made"])
def test_results_of_recordings_that_are_not_planned_are_not_opened(
    growing: bool, done: Campaign, tmp_path: Path
) -> None:
    """A specimen that had been removed from the file of the campaign stayed in its catalogue and means."""
    settings = {"dic.window": 24}
    left = [{"path": "recordings/plate-1"}]
    campaign = written(copied(tmp_path, *NAMES), settings=settings, recordings=left)
    shutil.copytree(Path(done.store), Path(campaign.store))
    plan = update_plan(campaign)
    store = CampaignStore(campaign.store)
    if growing:
        store.write("plan.json", replace(plan, units=(replace(plan.units[0], fingerprint={}),)).to_document())
    tree, catalogue = fringedic.open_campaign(tmp_path)
    assert (list(tree), list(catalogue.index)) == (["plate-1"], ["plate-1"])
    status = status_of(store, plan)
    assert (list(status.done), status.unplanned, status.complete) == (["plate-1"], ["plate-2"], True)
    assert status_sentences(status)[-1] == (
        "not opened: results of 1 recording that the plan does not contain, such as plate-2; 'fringedic campaign run "
        "--recompute' removes them"
    )
    assert run(campaign, recompute=True) == {}
    assert status_of(store, plan).unplanned == []
    assert not (tmp_path / "store" / "recordings" / "plate-2").exists()


def test_nothing_of_an_earlier_attempt_is_in_the_results(tmp_path: Path) -> None:
    """Maps of an interrupted attempt with other settings appeared in failed steps, and under other settings."""
    store = CampaignStore(str(tmp_path))
    settings = RecordedParameters({"dic.spacing": 1}).settings(None)

    def write(values: list[dict[str, float]]) -> None:
        with DatasetWriter(GroupStore(store, "plate"), {"experiment": "plate", "source": "bag"}) as writer:
            for step, each in enumerate(values):
                maps = {name: np.full((4, 4), value, np.float32) for name, value in each.items()}
                writer.add(Row(step, step, error="" if maps else "failed", maps=maps), settings)
            assert len(values) < 4, "interrupted"

    with pytest.raises(AssertionError, match="interrupted"):
        write([{"displacement_x": step, "e_11": step} for step in range(4)])
    write([{"displacement_x": 10}, {}, {"displacement_x": 12}])
    found = open_group(store, "plate")
    np.testing.assert_array_equal(found.displacement_x.values[:, 0, 0], [10, np.nan, 12])
    assert np.isnan(found.e_11).all()


def test_other_software_is_refused(done: Campaign, tmp_path: Path) -> None:
    unit = replace(
        current_plan(done).units[0],
        store=str(tmp_path),
        software={**current_plan(done).units[0].software, "numpy": "1"},
    )
    with pytest.raises(CampaignError, match=r"has numpy .* instead of 1: install"):
        process_unit(unit)


def test_a_unit_that_needs_more_memory_than_there_is_is_refused(done: Campaign, tmp_path: Path) -> None:
    unit = replace(current_plan(done).units[0], store=str(tmp_path), memory=1e15)
    (failure,) = Serial().outcomes([unit])
    assert isinstance(failure, Failure)
    assert "needs about 1000000.0 GB of memory" in failure.reason


def test_a_disk_that_fills_up_keeps_what_is_committed(
    done: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(done.folder / "recordings", tmp_path / "recordings")
    campaign = written(tmp_path)
    plan = update_plan(campaign)
    assert all(isinstance(outcome, Receipt) for outcome in Serial().outcomes(plan.units[:1]))
    usage = shutil.disk_usage(tmp_path)
    with monkeypatch.context() as full:
        full.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100_000))
        failure = run(campaign)["plate-2"]
    assert isinstance(failure, Failure)
    assert "the disk is full, step 0 needs" in failure.reason
    status = status_of(CampaignStore(campaign.store), plan)
    assert (set(status.done), set(status.failed)) == ({"plate-1"}, {"plate-2"})
    forget_failures(CampaignStore(campaign.store))
    assert set(run(campaign)) == {"plate-2"}


def test_kept_steps_need_memory() -> None:
    summary = replace(summarise(str(RECORDED)), frames=1200)
    assert (
        predicted_memory(summary, {"dic.kept_steps": 100})
        > predicted_memory(summary)
        > predicted_memory(replace(summary, image_shape=(60, 80)))
    )


def test_a_store_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "store").write_text("a file")
    campaign = written(copied(tmp_path, "plate"))
    with pytest.raises(CampaignError, match=f"the store {tmp_path}/store cannot be"):
        update_plan(campaign)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ({"recordings": []}, "recordings"),
        ({"settings": {"dic.windows": 3}}, "there is no parameter 'dic.windows'"),
        ({"stores": "x"}, "stores: unknown key"),
        ({"recordings": [{"path": "recordings", "colour": "red"}]}, "colour"),
        ({"elasticity": {"region_px": [[1, 2]]}}, "region_px has one corner: give two"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, content: dict[str, object], sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        written(tmp_path, **content)


def test_entries_have_to_name_recordings_once(tmp_path: Path) -> None:
    copied(tmp_path, "plate")
    twice: list[dict[str, object]] = [{"path": "recordings"}, {"path": "recordings/plate"}]
    with pytest.raises(CampaignError, match="is named by two entries"):
        update_plan(written(tmp_path, recordings=twice))
    twice[0]["exclude"] = ["recordings/pl*"]
    assert list(update_plan(written(tmp_path, recordings=twice)).refused) == ["recordings"]


def test_a_recording_above_the_campaign_stays_inside_the_store(tmp_path: Path) -> None:
    shutil.copytree(RECORDED, tmp_path / "plate-7" / "bag")
    folder = tmp_path / "plate-7" / "batch"
    folder.mkdir()
    campaign = written(folder, recordings=[{"path": "../bag"}])
    assert set(run(campaign)) == {"plate-7"}
    assert sorted(path.name for path in folder.iterdir()) == ["campaign.yaml", "store"]
    assert {path.name for path in Path(campaign.store).iterdir()} == {"begun", "plan.json", "receipts", "recordings"}
    tree, _ = fringedic.open_campaign(folder)
    assert list(tree.children) == ["plate-7"]


@pytest.mark.parametrize("name", ["recordings/..", "recordings/../../x", "/etc/x", "", "a//b", "."])
def test_nothing_is_written_outside_a_store(tmp_path: Path, name: str) -> None:
    store = CampaignStore(str(tmp_path / "store"))
    for write in (lambda: store.write(name, {}), lambda: store.remove(name), lambda: store.zarr_store(f"../{name}")):
        with pytest.raises(CampaignError, match="is no name in a store"):
            write()
    assert not list(tmp_path.iterdir())


def test_entries_have_their_own_settings_and_a_missing_one_is_told(tmp_path: Path) -> None:
    copied(tmp_path, *NAMES, "plate-3")
    entries: list[dict[str, object]] = [
        {"path": "recordings/plate-*", "exclude": ["recordings/plate-[23]", "recordings/plate-4"]},
        {"path": "recordings/plate-2", "settings": {"dic.window": 24}},
        {"path": "recordings/plat-9"},
    ]
    campaign = written(tmp_path, recordings=entries, settings={"dic.window": 40, "dic.spacing": 2})
    assert set(run(campaign)) == set(NAMES)
    tree, _ = fringedic.open_campaign(tmp_path)
    used = [json.loads(tree[name].attrs["parameters"])[0]["parameters"]["dic"] for name in NAMES]
    assert [(each["window"], each["spacing"]) for each in used] == [(40, 2), (24, 2)]
    store = CampaignStore(campaign.store)
    status = status_of(store, read_plan(store))
    cause = "there is no recording; correct the entry in the file of the campaign"
    assert status_sentences(status) == [
        "2 of 4 recordings complete, 0 failed, 0 waiting, 2 refused",
        f"refused: {tmp_path}/recordings/plat-9: {cause}",
        f"refused: {tmp_path}/recordings/plate-4: leaves out none of the entry's recordings ('exclude'); correct the "
        "entry in the file of the campaign",
    ]
    assert run(campaign) == {}
    assert Plan.from_document(json.loads(json.dumps(status.plan.to_document()))) == status.plan


def test_a_plan_of_an_earlier_version_has_one_processing_of_all_units(done: Campaign) -> None:
    plan = read_plan(CampaignStore(done.store))
    document = plan.to_document()
    document["processing"] = document["processing"][0]
    for each in document["units"]:
        del each["processing"]
    assert Plan.from_document({**document, "settings_hash": "0"}) == plan


def test_names_are_the_shortest_that_distinguish(tmp_path: Path) -> None:
    for batch in ("a", "b"):
        copied(tmp_path / batch, "plate 1")
    campaign = written(tmp_path, recordings=[{"path": "*/recordings/*"}])
    names = [unit.name for unit in update_plan(campaign).units]
    assert names == ["a_recordings_plate-1", "b_recordings_plate-1"]


def test_objects_that_are_removed_while_a_folder_is_read_are_left_out(tmp_path: Path) -> None:
    store = CampaignStore(str(tmp_path))
    store.write("begun/one.json", {"steps": 1})
    (tmp_path / "begun" / "removed.json").symlink_to(tmp_path / "nowhere")  # is listed and cannot be opened
    assert store.documents("begun") == {"one": {"steps": 1}}


def test_a_store_without_plan_is_no_campaign(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="is no campaign"):
        fringedic.open_campaign(tmp_path)
    with pytest.raises(CampaignError, match="is no folder and no known kind of address"):
        fringedic.open_campaign("nowhere://campaign")
