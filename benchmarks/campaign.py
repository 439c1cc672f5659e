"""Campaigns: efficiency, overhead, time to resume, time to plan, memory, and what killed processes cost.

The recordings are copies of the small one of the tests (3 steps of 160x120 px, 0.6 s of processor time); `--recording`
takes another one for the engines and the memory.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import psutil

from fringedic.campaign import (
    ONE_THREAD,
    Campaign,
    CampaignStore,
    Failure,
    Plan,
    Processes,
    Receipt,
    Serial,
    load_campaign,
    read_plan,
    status_of,
    update_plan,
)
from fringedic.campaign.plan import plan_of, predicted_memory
from fringedic.campaign.recordings import Found, summarise
from fringedic.campaign.settings import RecordingEntry

RECORDED = Path(__file__).parents[1] / "ros2_ws/src/fringedic/test/recordings/version_0_1/bag"
TARGETS = {
    "efficiency of 2 workers": 0.9,  # at least
    "overhead over fringedic process [%]": 5.0,  # the others at most
    "resume 1000 units [s]": 10.0,
    "plan 1000 summaries [s]": 10.0,
}
ON_PAPER = (1000, 100)  # recordings, steps of each
DESK = """
    import sys, time
    from pathlib import Path
    import fringedic

    bags, folder = sys.argv[2:], Path(sys.argv[1])
    fringedic.process_bag(bags[0], output=folder / "warm.nc")
    start = time.process_time()
    for number, bag in enumerate(bags):
        fringedic.process_bag(bag, output=folder / f"{number}.nc")
    print(time.process_time() - start)
"""
MEMORY = """
    import sys, time
    from pathlib import Path
    from fringedic.campaign import load_campaign, process_unit, update_plan

    unit = update_plan(load_campaign(Path(sys.argv[1]))).units[0]
    start = time.perf_counter()
    receipt = process_unit(unit)
    seconds = (time.perf_counter() - start) / receipt.figures["steps"]
    status = dict(line.split(":", 1) for line in open("/proc/self/status"))
    print(int(status["VmHWM"].split()[0]) * 1024, seconds, receipt.size / receipt.figures["steps"])
"""


def campaign_of(folder: Path, count: int, recording: Path = RECORDED) -> Campaign:
    """A campaign of `count` recordings, which share the bytes on the disk."""
    for number in range(count):
        bag = folder / "recordings" / f"plate-{number:04d}"
        bag.mkdir(parents=True)
        for file in recording.iterdir():
            os.link(file, bag / file.name) if folder.stat().st_dev == file.stat().st_dev else shutil.copy(file, bag)
    (folder / "campaign.yaml").write_text("recordings: [{path: recordings}]")
    return load_campaign(folder)


def empty(campaign: Campaign) -> Plan:
    """Remove all results and plan again."""
    shutil.rmtree(campaign.store, ignore_errors=True)
    return update_plan(campaign)


def seconds_with(campaign: Campaign, workers: int) -> tuple[float, float]:
    """Time and processor time for one recording with worker processes that have loaded the library."""
    plan = empty(campaign)
    started = busy = ended = 0.0
    names = set()
    done = first = 0
    for outcome in Processes(workers).outcomes(plan.units):
        assert isinstance(outcome, Receipt), outcome
        done += 1
        names.add(outcome.worker)
        if not started and len(names) == workers:  # the first unit of each worker loads the library
            started, busy, first = time.perf_counter(), processor_seconds(), done
        if done == len(plan.units):
            ended, busy = time.perf_counter(), processor_seconds() - busy
    return (ended - started) / (done - first), busy / (done - first)


def processor_seconds() -> float:
    """Processor time of this process and the workers."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def desk_seconds(campaign: Campaign, folder: Path) -> float:
    """Processor time of `process_bag` for one recording, in one process with one thread."""
    bags = [unit.path for unit in read_plan(CampaignStore(campaign.store)).units]
    with tempfile.TemporaryDirectory(dir=folder) as target:
        return run(DESK, target, *bags)[0] / len(bags)


def run(code: str, *words: str) -> list[float]:
    """Numbers that a program prints in a fresh process with one thread."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *words],
        env={**os.environ, **ONE_THREAD},
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(word) for word in done.stdout.split()]


def engine_figures(folder: Path, recording: Path, count: int, repeats: int) -> dict[str, float]:
    """Efficiency and overhead, medians over runs that follow each other.

    Processor time tells the overhead on a computer with other work, too; the efficiency needs one without.
    """
    campaign = campaign_of(folder / "engines", count, recording)
    empty(campaign)
    found = []
    for _ in range(repeats):
        desk, one, two = desk_seconds(campaign, folder), seconds_with(campaign, 1), seconds_with(campaign, 2)
        found.append((one[0] / two[0] / 2, 100 * (one[1] / desk - 1), one[1] / two[1]))
    efficiency, overhead, work = (statistics.median(values) for values in zip(*found, strict=True))
    return {
        "load of the computer": os.getloadavg()[0],
        "efficiency of 2 workers": efficiency,
        "processor time with 1 worker over 2": work,
        "overhead over fringedic process [%]": overhead,
    }


def equal_figures(folder: Path, recording: Path, count: int = 8) -> dict[str, float]:
    """Digests of the groups by every engine: they contain the SHA-256 of every chunk."""
    campaign = campaign_of(folder / "equal", count, recording)
    found = {}
    engines = {"serial": Serial(), **{f"processes {n}": Processes(n) for n in (1, 2, 3)}}
    for name, engine in engines.items():
        found[name] = digests(engine.outcomes(empty(campaign).units))
    status = status_of(CampaignStore(campaign.store), empty(campaign))
    found["shards"] = {
        name: digest for part in (1, 2, 3) for name, digest in digests(Serial().outcomes(status.share(part, 3))).items()
    }
    different = [name for name, each in found.items() if each != found["serial"] or len(each) != count]
    assert not different, f"other bytes than the serial engine: {different}"
    return {"engines with equal results": len(found), "recordings": count}


def digests(outcomes: Iterable[Receipt | Failure]) -> dict[str, str]:
    found = list(outcomes)
    assert all(isinstance(outcome, Receipt) for outcome in found), found
    return {outcome.name: outcome.digest for outcome in found if isinstance(outcome, Receipt)}


def resume_figures(folder: Path, count: int) -> dict[str, float]:
    """Time to plan real recordings, and of a run of a finished campaign, in fresh processes."""
    campaign = campaign_of(folder / "resume", count)
    start = time.perf_counter()
    plan = update_plan(campaign)
    planned = time.perf_counter() - start
    store = CampaignStore(campaign.store)
    example = next(iter(Processes(1).outcomes(plan.units[:1])))
    assert isinstance(example, Receipt), example
    for unit in plan.units:
        receipt = replace(example, name=unit.name, key=unit.key)
        store.write(f"receipts/{unit.name}.json", asdict(receipt))
    start = time.perf_counter()
    subprocess.run(["fringedic", "campaign", "run", str(campaign.folder)], check=True, capture_output=True)
    return {"resume 1000 units [s]": time.perf_counter() - start, "plan 1000 recordings [s]": planned}


def planner_figures(folder: Path, count: int) -> dict[str, float]:
    """Time to plan synthetic summaries, and the memory per recording."""
    campaign = load_campaign(folder / "resume")
    summary = summarise(str(RECORDED))
    found = (Found(f"plate-{number}", str(RECORDED), RecordingEntry(path="")) for number in range(count))
    before = psutil.Process().memory_info().rss
    start = time.perf_counter()
    plan = plan_of(campaign, ((each, summary) for each in found))
    seconds = time.perf_counter() - start
    assert len(plan.units) == count
    grown = psutil.Process().memory_info().rss - before
    return {"plan 1000 summaries [s]": seconds, "memory per planned recording [kB]": 1e-3 * grown / count}


def memory_figures(folder: Path, recording: Path) -> dict[str, float]:
    """Memory of a worker beside its prediction, and rates for the table on paper."""
    place = folder / "memory"
    place.mkdir()
    (place / "campaign.yaml").write_text(json.dumps({"recordings": [{"path": str(recording.absolute())}]}))
    used, seconds, size = run(MEMORY, str(place))
    summary = summarise(str(recording))
    return {
        "memory of a worker [GB]": 1e-9 * used,
        "predicted [GB]": 1e-9 * predicted_memory(summary),
        "seconds per step": seconds,
        "MB read per step": 1e-6 * summary.size / summary.steps,
        "MB written per step": 1e-6 * size,
    }


def on_paper(figures: dict[str, float]) -> Iterator[str]:
    """Yield the table for a large campaign: time of the processors, and the rate that the store has to take."""
    recordings, steps = ON_PAPER
    for cores in (32, 256):
        rounds = -(-recordings // cores)  # chains are not divided
        hours = rounds * steps * figures["seconds per step"] / 3600
        moved = recordings * steps * (figures["MB read per step"] + figures["MB written per step"])
        yield (
            f"{recordings} recordings x {steps} steps on {cores} cores: {hours:.2f} h in {rounds} rounds of one "
            f"recording per core, {1e-6 * moved:.2f} TB moved, {1e-3 * moved / (3600 * hours):.2f} GB/s on average"
        )


def killed(folder: Path, count: int, kills: int, seed: int) -> dict[str, float]:
    """Kill a worker, or the whole command, at random moments until the campaign is complete; count the units."""
    campaign = campaign_of(folder / "killed", count)
    plan = empty(campaign)
    store = CampaignStore(campaign.store)
    expected = next(iter(Processes(1).outcomes(plan.units[:1])))
    assert isinstance(expected, Receipt), expected
    generator, done = random.Random(seed), {expected.name: expected}
    performed = 0
    for kill in range(kills):
        if len(done) == count:
            break
        with subprocess.Popen(
            ["fringedic", "campaign", "run", str(campaign.folder), "--workers", "2"], stdout=subprocess.DEVNULL
        ) as command:
            while len(status_of(store, plan).done) <= len(done) and command.poll() is None:
                time.sleep(0.02)
            time.sleep(generator.uniform(0, 1.5))
            if command.poll() is None:
                kill_one(command, client=bool(kill % 2))
                performed += 1
        now = status_of(store, plan).done
        assert all(now[name] == receipt for name, receipt in done.items()), "a complete unit was computed again"
        done = now
    subprocess.run(["fringedic", "campaign", "run", str(campaign.folder), "--workers", "2"], check=True)
    done = status_of(store, plan).done
    assert len(done) == count
    assert len({(receipt.objects, receipt.size) for receipt in done.values()}) == 1, "something is missing"
    return {"kills": performed, "units": count, "complete": len(done)}


def kill_one(command: subprocess.Popen[bytes], *, client: bool) -> None:
    """Kill the command, or one of its workers and wait for the command."""
    process = psutil.Process(command.pid)
    workers = [each for each in process.children(recursive=True) if "spawn_main" in " ".join(each.cmdline())]
    if client or not workers:
        command.kill()
    else:
        random.choice(workers).send_signal(signal.SIGKILL)
        time.sleep(2)
        command.kill()
    psutil.wait_procs(workers, timeout=60)


@contextmanager
def place() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        for name in ("engines", "equal", "resume", "killed"):
            Path(folder, name).mkdir()
        yield Path(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=40, help="of the measurement of the engines")
    parser.add_argument("--units", type=int, default=1000, help="of planning and resuming")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--recording", type=Path, default=RECORDED, help="for the engines, memory and rates")
    parts = ["memory", "resume", "engines", "equal", "killed"]
    parser.add_argument("--only", nargs="+", choices=parts, default=parts, help="parts of the measurement")
    options = parser.parse_args()
    with place() as folder:
        if "memory" in options.only:
            figures = memory_figures(folder, options.recording)
            report(figures)
            for line in on_paper(figures):
                print(line)
        if "resume" in options.only:
            report(resume_figures(folder, options.units))
            report(planner_figures(folder, options.units))
        if "engines" in options.only:
            report(engine_figures(folder, options.recording, options.recordings, options.repeats))
        if "equal" in options.only:
            report(equal_figures(folder, options.recording))
        if "killed" in options.only:
            report(killed(folder, 6 * options.kills, options.kills, seed=1))


def report(figures: dict[str, float]) -> None:
    for name, value in figures.items():
        target = f" (target {TARGETS[name]:g})" if name in TARGETS else ""
        print(f"{name}: {value:.3g}{target}", flush=True)


if __name__ == "__main__":
    main()
