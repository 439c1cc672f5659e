"""Engines of campaigns: the same bytes from every one, also when processes are killed."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import dask
import distributed
import psutil
import pytest
from certificate import write_certificate
from running_system import ROOT

import fringedic
from fringedic.campaign import (
    ONE_THREAD,
    Campaign,
    CampaignStore,
    Dask,
    Failure,
    Receipt,
    Serial,
    Unit,
    current_plan,
    load_campaign,
    status_of,
)
from fringedic.errors import CampaignError

RECORDED = ROOT / "ros2_ws" / "src" / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
ENDING = """import socket, sys
listening = socket.socket(fileno=int(sys.argv[1]))
while True:
    listening.accept()[0].close()"""
NAMES = {f"plate-{number}" for number in range(1, 5)}
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # of connections to killed processes
    pytest.mark.usefixtures("collected_from_module", "collected"),
]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    for name in NAMES:
        shutil.copytree(RECORDED, folder / name)
    return folder


@pytest.fixture(scope="module")
def expected(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Digests of the groups that the serial engine writes: they contain the SHA-256 of every chunk."""
    return digests(Serial().outcomes(units(campaign_in(tmp_path_factory.mktemp("serial"), recordings))))


@pytest.fixture
def campaign(recordings: Path, tmp_path: Path) -> Campaign:
    return campaign_in(tmp_path, recordings)


def campaign_in(folder: Path, recordings: Path) -> Campaign:
    (folder / "campaign.yaml").write_text(f"recordings: [{{path: '{recordings}/*'}}]")
    return load_campaign(folder)


def units(campaign: Campaign) -> list[Unit]:
    """Units that are neither complete nor failed."""
    return status_of(CampaignStore(campaign.store), current_plan(campaign)).waiting


def digests(outcomes: Iterator[Receipt | Failure]) -> dict[str, str]:
    found = list(outcomes)
    assert all(isinstance(outcome, Receipt) for outcome in found), found
    assert len({outcome.name for outcome in found}) == len(found), "a recording was processed twice"
    return {outcome.name: outcome.digest for outcome in found if isinstance(outcome, Receipt)}


def receipts(campaign: Campaign) -> dict[str, Receipt]:
    return status_of(CampaignStore(campaign.store), current_plan(campaign)).done


def written(campaign: Campaign) -> dict[str, str]:
    """Digests of the receipts in the store."""
    return {name: receipt.digest for name, receipt in receipts(campaign).items()}


def workers(process: psutil.Process) -> list[psutil.Process]:
    return [each for each in process.children(recursive=True) if "spawn_main" in command_of(each)]


def command_of(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:  # it has just ended
        return ""


def processing(campaign: Campaign) -> set[str]:
    """Recordings of which the first maps are written, and that have no receipt."""
    store = Path(campaign.store)
    begun = {path.parts[-2] for path in store.glob("recordings/*/w")}
    return begun - {path.stem for path in store.glob("receipts/*.json")}


def wait_for(condition: Callable[[], object], process: subprocess.Popen[bytes] | None = None) -> None:
    end = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        assert process is None or process.poll() is None, "the process has ended"
        time.sleep(0.01)


def kill(process: psutil.Process) -> None:
    with suppress(psutil.NoSuchProcess):
        process.send_signal(signal.SIGKILL)
        process.wait(300)


@contextmanager
def started(campaign: Campaign) -> Iterator[subprocess.Popen[bytes]]:
    """Start the command with two workers, and kill what is left of them in the end."""
    words = ["fringedic", "campaign", "run", str(campaign.folder), "--workers", "2"]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, start_new_session=True) as command:
        try:
            yield command
        finally:
            with suppress(ProcessLookupError):
                os.killpg(command.pid, signal.SIGKILL)


def test_a_killed_process_changes_nothing(campaign: Campaign, expected: dict[str, str]) -> None:
    with started(campaign) as command:
        wait_for(lambda: processing(campaign), command)
        client = psutil.Process(command.pid)
        for process in (client, *workers(client)):
            assert not process.net_connections(), "other users of the computer reach a port"
        kill(random.Random(1).choice(workers(client)))
        assert command.wait(300) == 0
    assert written(campaign) == expected


def test_an_interrupted_command_does_not_wait_for_its_workers(campaign: Campaign, expected: dict[str, str]) -> None:
    """The interrupt reaches the command alone, and a worker would never end."""
    with started(campaign) as command:
        wait_for(lambda: processing(campaign), command)
        below = workers(psutil.Process(command.pid))
        below[0].suspend()
        command.send_signal(signal.SIGINT)
        assert command.wait(300) == 130
        _, alive = psutil.wait_procs(below, timeout=300)
        assert not alive
    list(Serial().outcomes(units(campaign)))
    assert written(campaign) == expected


def test_after_killed_workers_and_a_killed_command_only_the_rest_is_processed(
    campaign: Campaign, expected: dict[str, str]
) -> None:
    """Two workers are killed while they write, then the command."""
    random_moment = random.Random(2)
    with started(campaign) as command:
        client = psutil.Process(command.pid)
        for _ in range(2):
            wait_for(lambda: processing(campaign), command)
            time.sleep(random_moment.uniform(0, 0.2))
            wait_for(lambda: workers(client), command)  # after a death all of them are started again
            kill(random_moment.choice(workers(client)))
        wait_for(lambda: receipts_in(campaign) and processing(campaign), command)
        below = client.children(recursive=True)
        command.kill()
        _, alive = psutil.wait_procs(below, timeout=300)
        assert not alive
    before = receipts(campaign)
    waiting = units(campaign)
    assert {unit.name for unit in waiting} == NAMES - before.keys()
    assert waiting
    assert digests(Serial().outcomes(waiting)) == {unit.name: expected[unit.name] for unit in waiting}
    assert written(campaign) == expected
    assert before.items() <= receipts(campaign).items()
    tree, _ = fringedic.open_campaign(campaign.folder)
    assert all(tree[name].w.notnull().mean() > 0.5 for name in NAMES)


def receipts_in(campaign: Campaign) -> list[Path]:
    return list(Path(campaign.store).glob("receipts/*.json"))


class Cluster:
    """A Dask scheduler with workers of one thread, whose connections are encrypted.

    Parameters
    ----------
    folder
        Of their files.
    """

    def __init__(self, folder: Path, processes: ExitStack) -> None:
        self._folder, self._processes = folder, processes
        certificate, key = map(str, write_certificate(folder))
        self._tls = ["--tls-ca-file", certificate, "--tls-cert", certificate, "--tls-key", key]
        files = {"ca-file": certificate, "client.cert": certificate, "client.key": key}
        self.settings = {f"distributed.comm.tls.{name}": file for name, file in files.items()}
        self.scheduler = self._start(
            "scheduler", "--host", "tls://127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"
        )
        wait_for(self._is_described, self.scheduler)
        self.address = json.loads(self._file.read_text())["address"]

    @property
    def _file(self) -> Path:
        return self._folder / "scheduler.json"

    def _is_described(self) -> bool:
        """Whether the scheduler has written its file completely: it exists while it is still empty."""
        try:
            return "address" in json.loads(self._file.read_text())
        except (OSError, ValueError):
            return False

    def add_worker(self) -> None:
        self._start("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def _start(self, program: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", "--scheduler-file", str(self._file)]
        process = subprocess.Popen(
            [*command, *options, *self._tls],
            env={**os.environ, **ONE_THREAD},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._processes.enter_context(process)
        self._processes.callback(process.kill)
        return process


def test_one_two_and_three_workers_of_an_encrypted_cluster_write_the_same(
    recordings: Path, expected: dict[str, str], tmp_path: Path
) -> None:
    with ExitStack() as processes:
        cluster = Cluster(tmp_path, processes)
        assert cluster.address.startswith("tls://127.0.0.1:")
        with pytest.raises(CampaignError, match=r"tls://.* cannot be reached: .*distributed.comm.tls"):
            list(Dask(cluster.address).outcomes([]))
        with dask.config.set(cluster.settings):
            for count in (1, 2, 3):
                folder = tmp_path / str(count)
                folder.mkdir()
                campaign = campaign_in(folder, recordings)
                cluster.add_worker()
                with distributed.Client(cluster.address) as client:
                    client.wait_for_workers(count, timeout=300)
                assert digests(Dask(cluster.address).outcomes(units(campaign))) == expected


@pytest.mark.parametrize("proxy", [False, True])
def test_a_lost_scheduler_is_told_in_one_sentence(campaign: Campaign, tmp_path: Path, *, proxy: bool) -> None:
    """A proxy still accepts connections in place of the scheduler, and ends them at once."""
    with ExitStack() as processes:
        cluster = Cluster(tmp_path, processes)
        cluster.add_worker()
        settings = {
            f"DASK_{name.upper().replace('.', '__').replace('-', '_')}": file for name, file in cluster.settings.items()
        }
        command = subprocess.Popen(
            ["fringedic", "campaign", "run", str(campaign.folder), "--scheduler", cluster.address],
            env=os.environ | settings,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.enter_context(command)
        processes.callback(command.kill)
        wait_for(lambda: receipts(campaign), command)
        command.send_signal(signal.SIGSTOP)
        cluster.scheduler.kill()
        cluster.scheduler.wait(300)
        if proxy:
            with socket.create_server(("127.0.0.1", int(cluster.address.rpartition(":")[2]))) as listening:
                ending = [sys.executable, "-c", ENDING, str(listening.fileno())]
                process = processes.enter_context(subprocess.Popen(ending, pass_fds=[listening.fileno()]))
            processes.callback(process.kill)
        command.send_signal(signal.SIGCONT)
        said = command.communicate(timeout=300)[1]
    assert command.returncode == 1
    assert re.fullmatch(r"the connection to the Dask scheduler of tls://\S+ is lost: repeat the command.*\n", said)
    assert 0 < len(units(campaign)) < len(NAMES)
