"""Recordings that are processed while they are made: the results are those of the complete recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from fringedic.campaign import (
    Campaign,
    CampaignStore,
    Failure,
    Receipt,
    Serial,
    Unit,
    current_plan,
    load_campaign,
    open_campaign,
    process_unit,
    read_plan,
    status_of,
    update_plan,
)
from fringedic.campaign import unit as units
from fringedic.campaign.sentences import plan_sentences, status_sentences
from fringedic.campaign.software import worker_name
from fringedic.errors import CampaignError
from fringedic.recording import BagReader, BagWriter, RawMessage, Split

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
END = 3  # stage of fringedic_msgs/StepStatus
SPLIT = Split(size=200_000)


def campaign_in(folder: Path, **content: object) -> Campaign:
    (folder / "campaign.yaml").write_text(yaml.safe_dump({"recordings": [{"path": "recordings"}], **content}))
    return load_campaign(folder)


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[BagWriter]:
    """A recording in several files that is being made; nothing is written yet."""
    path = tmp_path / "recordings" / "plate" / "bag"
    path.parent.mkdir(parents=True)
    with BagWriter(path, split=SPLIT) as writer:
        for topic in BagReader(RECORDED).topics.values():
            writer.add_recorded_topic(topic)
        yield writer


def steps() -> list[list[RawMessage]]:
    """Messages up to the end of each step."""
    reader, parts = BagReader(RECORDED), [list[RawMessage]()]
    topic = reader.find("experiment/step")["experiment/step"]
    for message in reader.stored():
        parts[-1].append(message)
        if message.topic == topic and reader.decode(topic, message.data).stage == END:
            parts.append([])
    assert len(parts) == 4
    return [*parts[:-2], parts[-2] + parts[-1]]


def write(writer: BagWriter, messages: list[RawMessage]) -> None:
    for message in messages:
        writer.write(*message)
    writer.flush()


def wait_with(writer: BagWriter, condition: Callable[[], object]) -> None:
    """Wait as a recorder without messages."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        writer.flush()
        time.sleep(0.01)


@contextmanager
def followed(unit: Unit) -> Iterator[Callable[[], Receipt]]:
    with ThreadPoolExecutor(1) as worker:
        yield worker.submit(process_unit, unit).result


def state(campaign: Campaign) -> dict[str, int]:
    store = CampaignStore(campaign.store)
    return {name: begun["steps"] for name, begun in status_of(store, read_plan(store)).begun.items()}


def test_each_step_is_measured_when_it_has_ended_and_the_results_are_those_of_the_complete_recording(
    writer: BagWriter, tmp_path: Path
) -> None:
    first, second, third = steps()
    write(writer, first)
    campaign = campaign_in(tmp_path)
    assert "still recorded" in update_plan(campaign).refused["plate"]
    plan = update_plan(campaign, follow=True)
    assert "being recorded: plate" in plan_sentences(plan)
    (unit,) = plan.units
    assert (unit.steps, unit.memory > 0.45e9) == (0, True)
    store = CampaignStore(campaign.store)
    with followed(unit) as result:
        wait_with(writer, lambda: state(campaign) == {"plate": 1})
        words = f"begun: plate by {worker_name()}, 1 step measured while it is recorded"
        assert words in status_sentences(status_of(store, plan))
        write(writer, second)
        wait_with(writer, lambda: state(campaign) == {"plate": 2})
        write(writer, third)
        wait_with(writer, lambda: state(campaign) == {"plate": 3})
        writer.close()
        receipt = result()
    assert len(list(writer.path.glob("*.mcap"))) > 2
    assert (receipt.name, receipt.figures["steps"], state(campaign)) == ("plate", 3, {})
    assert status_of(store, plan).done == {"plate": receipt}  # by the plan of a command that was killed meanwhile
    assert list(open_campaign(campaign.store)[1].index) == ["plate"]
    complete = current_plan(campaign)
    assert [each.key for each in complete.units] == [receipt.key]
    store.remove("receipts")
    again = process_unit(complete.units[0])
    assert again.digest == receipt.digest
    assert (again.figures, again.curve) == (receipt.figures, receipt.curve)
    assert again.figures["largest_force"] > 0  # of samples that come after the images of their step


def test_messages_that_were_overtaken_are_sorted_when_the_recording_is_complete(
    writer: BagWriter, tmp_path: Path
) -> None:
    first, *others = steps()
    before_the_end = [number for number, each in enumerate(first) if each.topic == first[-1].topic][-2]
    late = first.pop(before_the_end)._replace(log_time=others[0][0].log_time)
    write(writer, first)
    campaign = campaign_in(tmp_path)
    (unit,) = update_plan(campaign, follow=True).units
    with followed(unit) as result:
        wait_with(writer, lambda: state(campaign) == {"plate": 1})
        write(writer, [late])
        wait_with(writer, lambda: state(campaign) == {})
        write(writer, others[0] + others[1])
        writer.close()
        receipt = result()
    CampaignStore(campaign.store).remove("receipts")
    assert process_unit(current_plan(campaign).units[0]).digest == receipt.digest
    assert receipt.figures["steps"] == 3


def test_settings_that_need_all_steps_wait_for_them(writer: BagWriter, tmp_path: Path) -> None:
    first, second, third = steps()
    write(writer, first)
    campaign = campaign_in(tmp_path, reference=1)
    (unit,) = update_plan(campaign, follow=True).units
    with followed(unit) as result:
        write(writer, second + third)
        writer.close()
        receipt = result()
    assert receipt.figures["steps"] == 3
    assert [each.key for each in current_plan(campaign).units] == [receipt.key]


def test_a_recorder_that_died_is_named(writer: BagWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(units, "PATIENCE_S", 0.0)
    write(writer, steps()[0])
    campaign = campaign_in(tmp_path)
    plan = update_plan(campaign, follow=True)
    (failure,) = Serial().outcomes(plan.units)
    assert isinstance(failure, Failure)
    assert "plate/bag: its recorder has ended without closing it" in failure.reason
    assert f"'fringedic recover {writer.path}'" in failure.reason
    assert status_of(CampaignStore(campaign.store), plan).waiting == []
    assert not list(Path(campaign.store).glob("recordings/*"))  # nothing was processed in vain


@pytest.mark.usefixtures("writer")
def test_results_of_an_earlier_recording_of_the_same_name_are_refused(tmp_path: Path) -> None:
    campaign = campaign_in(tmp_path)
    CampaignStore(campaign.store).write("receipts/plate.json", {"key": "earlier"})
    with pytest.raises(CampaignError, match=r"other settings, recordings or software for plate"):
        update_plan(campaign, follow=True)
    assert [unit.name for unit in update_plan(campaign, follow=True, recompute=True).units] == ["plate"]


def test_a_recording_without_a_calibration_is_refused_while_it_is_made(writer: BagWriter, tmp_path: Path) -> None:
    calibration = BagReader(RECORDED).find("calibration")["calibration"]
    write(writer, [message for message in steps()[0] if message.topic != calibration])
    assert "contains no calibration" in update_plan(campaign_in(tmp_path), follow=True).refused["plate"]
