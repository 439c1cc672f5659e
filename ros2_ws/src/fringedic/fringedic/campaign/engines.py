"""Engines: they hand the units of a campaign to workers. The results do not depend on the engine."""

from __future__ import annotations

import logging
import multiprocessing
import os
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, Protocol

from fringedic.campaign.plan import Unit
from fringedic.campaign.receipts import Failure, Receipt
from fringedic.campaign.unit import attempt, record_failure
from fringedic.errors import CampaignError
from fringedic.wording.optional_packages import optional_import

with optional_import("campaign"):
    import psutil

Outcome = Receipt | Failure
_THREADS = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
ONE_THREAD = dict.fromkeys(_THREADS, "1")
"""Environment of a worker, which has to be set before it starts: workers are parallel, not their kernels."""
# Maps are as large again in the next step: memory that goes back to the kernel, as Dask sets for its workers, is
# cleared again page by page, a fifth of the processor time of large images. The nodes have these values, too (0024).
_KEPT_MEMORY = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": str(1 << 30),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 32),
}
_ATTEMPTS = 3  # at a unit whose worker dies


class Engine(Protocol):
    """Distributes units."""

    def outcomes(self, units: Sequence[Unit]) -> Iterator[Outcome]:
        """Process units and yield the outcome of each one as soon as it is known, in any order.

        Raises
        ------
        CampaignError
            The workers or their scheduler are lost; what is committed stays.
        """


class Serial:
    """Processes one unit after the other in this process, with the threads of the library."""

    def outcomes(self, units: Sequence[Unit]) -> Iterator[Outcome]:
        """See `Engine`."""
        for unit in units:
            limit = float(psutil.virtual_memory().available)
            yield attempt(unit) if unit.memory <= limit else _too_large(unit, limit)


class Processes:
    """Processes units in worker processes of this computer, each with one thread, by pipes: no port is opened.

    Parameters
    ----------
    workers
        Number of processes.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def outcomes(self, units: Sequence[Unit]) -> Iterator[Outcome]:
        """See `Engine`; a unit whose process dies is tried again, three times altogether."""
        limit = psutil.virtual_memory().available / self._workers
        waiting = [unit for unit in units if unit.memory <= limit]
        yield from (_too_large(unit, limit) for unit in units if unit.memory > limit)
        deaths: Counter[str] = Counter()
        while waiting:
            lost: list[Unit] = []
            yield from self._with_one_pool(self._workers, waiting, lost)
            deaths.update(unit.name for unit in lost)
            for unit in lost:
                if not unit.growing:
                    yield from self._alone(unit)
                elif deaths[unit.name] < _ATTEMPTS:
                    waiting.append(unit)  # alone it would keep the others waiting until its recording ends
                else:
                    yield _died(unit)

    def _alone(self, unit: Unit) -> Iterator[Outcome]:
        """Try a lost unit again: the death of the process of another unit is not counted."""
        for _ in range(_ATTEMPTS - 1):
            lost: list[Unit] = []
            yield from self._with_one_pool(1, [unit], lost)
            if not lost:
                return
        yield _died(unit)

    def _with_one_pool(self, workers: int, waiting: list[Unit], lost: list[Unit]) -> Iterator[Outcome]:
        """Process units until none is waiting, or until a process dies: its unit and its neighbours are then lost."""
        with _environment(ONE_THREAD | _KEPT_MEMORY):
            pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _end_with_parent)
            with pool, _killed_when_interrupted():
                running: dict[Future[Outcome], Unit] = {}
                while (waiting or running) and not lost:
                    while waiting and len(running) < workers:
                        unit = waiting.pop(0)
                        try:
                            running[pool.submit(attempt, unit)] = unit
                        except BrokenProcessPool:
                            waiting.insert(0, unit)
                            break
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        unit = running.pop(future)
                        try:
                            yield future.result()
                        except BrokenProcessPool:
                            lost.append(unit)
                lost += running.values()


class Dask:
    """Processes units on the workers of a Dask cluster.

    Whoever reaches its scheduler runs programs as its user, unless it requires certificates (``tls://``).

    Parameters
    ----------
    scheduler
        Address of the cluster, ``tls://...`` or ``tcp://...``; its workers need the software of the plan, and
        `ONE_THREAD` in their environment.
    """

    def __init__(self, scheduler: str) -> None:
        with optional_import("campaign"):
            import distributed
        self._distributed: Any = distributed
        self._scheduler = scheduler

    def outcomes(self, units: Sequence[Unit]) -> Iterator[Outcome]:
        """See `Engine`; a unit whose worker dies is tried again, three times altogether."""
        with self._client() as client:
            try:
                client.wait_for_workers(1, timeout=60)
            except TimeoutError as error:
                raise CampaignError(
                    f"the Dask scheduler {client.scheduler.address} has no workers: start some, and repeat the command"
                ) from error
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            limit = min(
                (float(worker["memory_limit"]) for worker in workers if worker["memory_limit"]), default=float("inf")
            )
            yield from (_too_large(unit, limit) for unit in units if unit.memory > limit)
            futures = {
                client.submit(attempt, unit, key=f"{unit.name}-{unit.key[:16]}", pure=False): unit
                for unit in units
                if unit.memory <= limit
            }
            completed = self._distributed.as_completed(futures, with_results=True, raise_errors=False)
            for future, result in completed:
                unit = futures[future]
                if future.status == "finished":
                    assert isinstance(result, Receipt | Failure)
                    yield result
                    continue
                cause = future.exception() if future.status == "error" else None
                if not isinstance(cause, self._distributed.KilledWorker):
                    reason = f" ({type(cause).__name__})" if cause is not None else ""
                    raise CampaignError(
                        f"the connection to the Dask scheduler of {self._scheduler} is lost{reason}: repeat the "
                        "command, which continues with what is not committed"
                    )
                yield _died(unit)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        try:
            client = self._distributed.Client(self._scheduler, timeout="5s")
        except OSError as error:
            raise CampaignError(
                f"the Dask scheduler {self._scheduler} does not answer: start it with 'dask scheduler', or leave "
                "--scheduler out"
            ) from error
        except (TypeError, ValueError) as error:  # of an address that is none, or of TLS without files
            raise CampaignError(
                f"the Dask scheduler {self._scheduler} cannot be reached: {str(error)[:200]}; write "
                "tcp://computer:port, or tls://computer:port with the files of distributed.comm.tls in the "
                "settings of Dask"
            ) from error
        with self._distributed.utils.silence_logging_cmgr(logging.CRITICAL):  # `outcomes` says it in a sentence
            try:
                yield client
            finally:
                try:
                    client.close()
                except Exception:  # of a lost connection over TLS: not only OSError
                    client.status = "closed"  # or it tries again for 10 s when the process ends


def _too_large(unit: Unit, limit: float) -> Failure:
    return record_failure(
        unit,
        f"{unit.path}: needs about {1e-9 * unit.memory:.1f} GB of memory and a worker has {1e-9 * limit:.1f} GB: use "
        "fewer workers or a computer with more memory, and repeat it with 'fringedic campaign retry'",
    )


def _died(unit: Unit) -> Failure:
    return record_failure(
        unit,
        f"{unit.path}: its worker died {_ATTEMPTS} times, most often for lack of memory: use fewer workers, and repeat "
        "it with 'fringedic campaign retry'",
    )


@contextmanager
def _killed_when_interrupted() -> Iterator[None]:
    """Kill the processes that were started meanwhile when their outcomes are no longer wanted: nobody waits for them.

    They can be killed at any moment: a unit is complete only when its receipt is written.
    """
    before = set(multiprocessing.active_children())
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit):
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise


def _end_with_parent() -> None:
    """End this process when the one that started it ends for any reason: it would wait for units for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "called in worker processes"

    def wait_for_the_end() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_the_end, name="parent", daemon=True).start()


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for the processes that are started meanwhile.

    Numba refuses to compile in a process whose NUMBA_NUM_THREADS is another one than at its start.
    """
    before = os.environ.copy()
    os.environ.update(values)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)
