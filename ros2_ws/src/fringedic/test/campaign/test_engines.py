"""Engines: the same bytes from every one, also when processes are killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from fringedic.campaign import (
    ONE_THREAD,
    Campaign,
    CampaignStore,
    Dask,
    Engine,
    Failure,
    Plan,
    Processes,
    Receipt,
    Serial,
    current_plan,
    load_campaign,
    run_units,
    status_of,
)
from fringedic.errors import CampaignError

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
NAMES = {"plate-1", "plate-2", "plate-3"}
RUN = """
import sys
from pathlib import Path
from fringedic.campaign import Dask, current_plan, load_campaign
if __name__ == "__main__":
    plan = current_plan(load_campaign(Path(sys.argv[1])))
    for outcome in Dask(1).outcomes(plan.units):
        pass
"""
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")  # of connections to killed processes


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    for name in NAMES:
        shutil.copytree(RECORDED, folder / name)
    return folder


@pytest.fixture(scope="module")
def expected(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Digests of the groups that the serial engine writes."""
    plan = plan_in(campaign_in(tmp_path_factory.mktemp("serial"), recordings))
    return digests(Serial().outcomes(plan.units))


@pytest.fixture
def campaign(recordings: Path, tmp_path: Path) -> Campaign:
    return campaign_in(tmp_path, recordings)


def campaign_in(folder: Path, recordings: Path) -> Campaign:
    (folder / "campaign.yaml").write_text(f"recordings: [{{path: '{recordings}/*'}}]")
    return load_campaign(folder)


def plan_in(campaign: Campaign) -> Plan:
    return current_plan(campaign)


def digests(outcomes: Iterator[Receipt | Failure]) -> dict[str, str]:
    found = list(outcomes)
    assert all(isinstance(outcome, Receipt) for outcome in found), found
    return {outcome.name: outcome.digest for outcome in found if isinstance(outcome, Receipt)}


def receipts(campaign: Campaign) -> dict[str, Receipt]:
    return status_of(CampaignStore(campaign.store), plan_in(campaign)).done


def workers() -> list[psutil.Process]:
    """Worker processes of this one."""
    return [each for each in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(each.cmdline())]


def begun(campaign: Campaign) -> list[str]:
    """Recordings of which the first maps are written, and that have no receipt."""
    store = Path(campaign.store)
    found = {path.parts[-2] for path in store.glob("recordings/*/w")}
    return sorted(found - {path.stem for path in store.glob("receipts/*.json")})


def wait_for(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.01)


def kill_a_worker(campaign: Campaign, killed: list[str]) -> threading.Thread:
    """Kill the process that has written the first maps of a recording, as soon as there is one."""

    def work() -> None:
        wait_for(lambda: begun(campaign))
        killed.extend(begun(campaign))
        for process in workers():
            process.send_signal(signal.SIGKILL)

    thread = threading.Thread(target=work)
    thread.start()
    return thread


@pytest.mark.parametrize("engine", [Processes(2), Dask(2)], ids=["processes", "dask"])
def test_workers_that_are_killed_change_nothing(engine: Engine, campaign: Campaign, expected: dict[str, str]) -> None:
    killed: list[str] = []
    plan = plan_in(campaign)
    thread = kill_a_worker(campaign, killed)
    assert digests(engine.outcomes(plan.units)) == expected
    thread.join()
    assert killed
    assert {name: receipt.digest for name, receipt in receipts(campaign).items()} == expected
    assert str(os.getpid()) not in {receipt.worker.rpartition(":")[2] for receipt in receipts(campaign).values()}
    assert not workers()


def test_shards_share_the_work(campaign: Campaign, expected: dict[str, str]) -> None:
    waiting = list(plan_in(campaign).units)
    first = digests(run_units(waiting, Serial(), (1, 2)))
    second = digests(run_units(waiting, Serial(), (2, 2)))
    assert (len(first), len(second)) == (2, 1)
    assert first | second == expected


def test_after_a_killed_client_only_the_rest_is_processed(campaign: Campaign, expected: dict[str, str]) -> None:
    plan_in(campaign)
    with subprocess.Popen([sys.executable, "-c", RUN, str(Path(campaign.folder))]) as client:
        wait_for(lambda: len(list(Path(campaign.store).glob("receipts/*.json"))) == 1 and begun(campaign))
        below = psutil.Process(client.pid).children(recursive=True)
        client.kill()
    _, alive = psutil.wait_procs(below, timeout=60)
    assert not alive
    before = receipts(campaign)
    waiting = status_of(CampaignStore(campaign.store), plan_in(campaign)).waiting
    again = digests(Serial().outcomes(waiting))
    assert set(again) == NAMES - set(before)
    assert before
    assert again
    assert {name: receipt.digest for name, receipt in receipts(campaign).items()} == expected


def dask(program: str, file: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start a scheduler, or a worker with one thread, which find each other by a file."""
    return subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.dask_{program}", "--scheduler-file", str(file), *options],
        env={**os.environ, **ONE_THREAD},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def test_a_lost_scheduler_is_named_and_a_missing_one_too(campaign: Campaign, expected: dict[str, str]) -> None:
    file = campaign.folder / "scheduler.json"
    with (
        dask(
            "scheduler", file, "--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"
        ) as scheduler,
        dask("worker", file, "--nthreads", "1", "--no-nanny", "--no-dashboard") as worker,
    ):
        wait_for(file.exists)
        address = json.loads(file.read_text())["address"]
        outcomes = Dask(1, address).outcomes(plan_in(campaign).units)
        assert isinstance(next(outcomes), Receipt)
        scheduler.kill()
        with pytest.raises(CampaignError, match=r"the Dask scheduler of .* is lost.*repeat the command"):
            list(outcomes)
        worker.kill()
    waiting = status_of(CampaignStore(campaign.store), plan_in(campaign)).waiting
    assert len(waiting) < len(NAMES)
    digests(Serial().outcomes(waiting))
    assert {name: receipt.digest for name, receipt in receipts(campaign).items()} == expected
    with pytest.raises(CampaignError, match="does not answer: start it"):
        list(Dask(1, address).outcomes(plan_in(campaign).units))
