"""Waiting, background work, pairing and diagnostics of running nodes."""

from __future__ import annotations

import ctypes
import gc
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.task import Future
from rclpy.waitable import NumberOfEntities, Waitable
from sensor_msgs.msg import Image
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from fringedic.errors import WaitTimeoutError
from fringedic_msgs.msg import Exposure
from fringedic_ros import waiting
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.images import image_message
from fringedic_ros.middleware import servers_of
from fringedic_ros.pairing import ImageExposurePairs
from fringedic_ros.qos import DIAGNOSTICS, IMAGES
from fringedic_ros.serialized import image_view
from fringedic_ros.spinning import Spinning
from fringedic_ros.stamps import to_msg
from fringedic_ros.waiting import Condition, LongRequest, Patience, RepeatedRequest, call, sleep, until, wait_for
from fringedic_ros.work import Worker

LIMIT_S = 0.4  # of a wait in which the process stands still


def test_waiting_is_exact_and_leaves_nothing(spinning: Spinning) -> None:
    node = spinning.add(Node("waiter"))
    timers_before = len(list(node.timers))

    async def wait_for_each() -> list[float]:
        durations = []
        start = time.monotonic()
        await sleep(node, 0.1)
        durations.append(time.monotonic() - start)
        with pytest.raises(WaitTimeoutError, match=r"the pattern did not come within 0\.1 s"):
            await wait_for(node, Future(), 0.1, "the pattern")
        durations.append(time.monotonic() - start)
        late: Future = Future()
        threading.Timer(0.1, late.set_result, ["from another thread"]).start()
        assert await wait_for(node, late, 5.0) == "from another thread"
        durations.append(time.monotonic() - start)
        with pytest.raises(WaitTimeoutError):
            await until(node, lambda: False, 0.1)
        durations.append(time.monotonic() - start)
        return durations

    durations = spinning.run(wait_for_each)
    assert all(later >= 0.0999 * n for n, later in enumerate(durations, 1))
    assert len(list(node.timers)) == timers_before


def test_condition_wakes_at_the_change(spinning: Spinning) -> None:
    node = spinning.add(Node("waiter"))
    condition = Condition(node)
    seen: list[int] = []

    def arrive() -> None:
        seen.append(len(seen))
        condition.notify()

    node.create_timer(0.02, arrive, callback_group=ReentrantCallbackGroup())

    async def wait_for_three() -> int:
        await condition.wait(lambda: len(seen) >= 3, 5.0)
        at_once = len(seen)
        with pytest.raises(WaitTimeoutError, match="the tenth thousand"):
            await condition.wait(lambda: len(seen) > 10_000, 0.1, "the tenth thousand")
        return at_once

    assert spinning.run(wait_for_three) == 3


def test_a_wait_looks_without_a_notification(spinning: Spinning) -> None:
    """The graph of nodes changes without a callback."""
    node = spinning.add(Node("waiter"))
    condition, looks = Condition(node), iter([False, False, True])
    spinning.run(lambda: condition.wait(lambda: next(looks), 6.0))  # True is neither the first look nor that at the end


def test_a_condition_that_changes_in_every_turn_still_gives_up(spinning: Spinning) -> None:
    """At 1000 samples/s of a load frame no wait of a step ended."""
    node = spinning.add(Node("waiter"))
    condition = Condition(node)
    node.create_timer(0.0, condition.notify, callback_group=ReentrantCallbackGroup())

    async def wait_in_vain() -> None:
        with pytest.raises(WaitTimeoutError, match=r"the camera did not come within 0\.2 s"):
            await condition.wait(lambda: False, 0.2, "the camera")

    spinning.run(wait_in_vain)


class SlowToTake(Waitable):
    """Is always ready, and takes its data for longer than the program needs to end the executor."""

    def __init__(self) -> None:
        super().__init__(ReentrantCallbackGroup())
        self.taking = threading.Event()

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities()

    def add_to_wait_set(self, _: object) -> None:
        pass

    def is_ready(self, _: object) -> bool:
        return True

    def take_data(self) -> None:
        self.taking.set()
        time.sleep(0.2)

    async def execute(self, _: object) -> None:
        pass


@pytest.mark.usefixtures("ros")
def test_nodes_end_while_a_callback_is_taken() -> None:
    """An exception of the thread fails the test; rclpy's executor triggers what its end in another thread destroyed."""
    waitable = SlowToTake()
    with Spinning() as spinning:
        node = spinning.add(Node("taking"))
        node.add_waitable(waitable)
        node.create_timer(0.0, lambda: None)
        assert waitable.taking.wait(30.0)


def test_call_answers_or_gives_up(spinning: Spinning) -> None:
    node = spinning.add(Node("caller"))
    server = spinning.add(Node("server"))
    hang = Future()

    async def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        await sleep(server, 0.01)
        response.success, response.message = True, "done"
        return response

    async def never(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        await hang
        return response

    server.create_service(Trigger, "serve", serve, callback_group=ReentrantCallbackGroup())
    server.create_service(Trigger, "never", never, callback_group=ReentrantCallbackGroup())
    clients = {name: node.create_client(Trigger, name) for name in ("serve", "never", "nobody")}

    async def calls() -> None:
        for _ in range(20):
            assert (await call(node, clients["serve"], Trigger.Request(), 5.0)).message == "done"
        with pytest.raises(WaitTimeoutError, match="the answer of service never"):
            await call(node, clients["never"], Trigger.Request(), 0.3)
        with pytest.raises(WaitTimeoutError, match="service nobody"):
            await call(node, clients["nobody"], Trigger.Request(), 0.1)

    spinning.run(calls)
    hang.set_result(None)
    assert list(node.timers) == []
    gc.collect()


class StoppedClock:
    """A clock that a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 0.0
        monkeypatch.setattr(waiting.time, "monotonic", lambda: self.now_s)

    def looks(self, patience: Patience, turn_s: float) -> int:
        """Return how often one can look at a limit, once per turn, until it is over."""
        for count in range(1, 1000):
            self.now_s += turn_s
            if patience.is_over():
                return count
        raise AssertionError("the limit is never over")


@pytest.mark.parametrize(("limit_s", "looks"), [(0.1, 4), (2.0, 4), (3.0, 6), (30.0, 60)])
def test_a_limit_is_over_after_its_turns(limit_s: float, looks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, patience = StoppedClock(monkeypatch), Patience(limit_s)
    assert clock.looks(patience, patience.turn_s + 1e-9) == looks
    clock.now_s += 100.0
    assert patience.is_over(), "a stop afterwards changes nothing"
    patience.renew()
    assert clock.looks(patience, patience.turn_s + 1e-9) == looks


def test_a_stop_of_the_process_is_followed_by_some_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the beginning and at the end of a limit."""
    clock, early, late = StoppedClock(monkeypatch), Patience(2.0), Patience(2.0)
    clock.now_s += 60.0
    assert not early.is_over()
    assert clock.looks(early, 0.01) > 50
    late.renew()
    clock.now_s += 0.9
    assert not late.is_over()
    clock.now_s += 0.9
    assert not late.is_over()
    clock.now_s += 60.0
    assert not late.is_over()
    assert clock.looks(late, 0.01) > 50


def test_a_limit_ends_also_when_every_turn_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = StoppedClock(monkeypatch)
    assert clock.looks(Patience(0.1), 60.0) < 10
    assert clock.looks(Patience(10.0), 60.0) < 30
    assert Patience(0.0).is_over()
    assert Patience(-1.0).is_over()


@pytest.mark.parametrize("way", ["future", "condition", "predicate"])
def test_what_came_while_the_executor_stood_still_is_taken(spinning: Spinning, way: str) -> None:
    """Of a queue, the executor takes one message per turn, and the limit is over before the first."""
    node = spinning.add(Node("waiter"))
    taken: list[Empty] = []
    condition, third = Condition(node), Future()

    def take(message: Empty) -> None:
        taken.append(message)
        condition.notify()
        if len(taken) == 3:
            third.set_result(None)

    node.create_subscription(Empty, "answers", take, 10)
    answers = node.create_publisher(Empty, "answers", 10)

    def stand_still() -> None:
        stop.cancel()
        for _ in range(3):
            answers.publish(Empty())
        assert answers.wait_for_all_acked(Duration(seconds=60))
        time.sleep(1.5 * LIMIT_S)

    async def wait() -> None:
        nonlocal stop
        await until(node, lambda: answers.get_subscription_count() == 1, 60.0)
        stop = node.create_timer(0.0, stand_still, callback_group=ReentrantCallbackGroup())
        if way == "future":
            await wait_for(node, third, LIMIT_S)
        elif way == "condition":
            await condition.wait(lambda: len(taken) == 3, LIMIT_S)
        else:
            await until(node, lambda: len(taken) == 3, LIMIT_S)

    stop = node.create_timer(60.0, lambda: None)
    spinning.run(wait, timeout_s=120.0)


def test_a_response_that_came_while_the_caller_stood_still_is_taken(spinning: Spinning) -> None:
    """The responses to two other requests wait before it."""
    node = spinning.add(Node("caller"))
    client = node.create_client(Trigger, "serve")
    served: list[Trigger.Request] = []

    def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        served.append(request)
        return response

    def stand_still() -> None:
        stop.cancel()
        while len(served) < 4:
            time.sleep(0.01)
        time.sleep(1.5 * LIMIT_S)

    async def calls() -> None:
        nonlocal stop
        with RepeatedRequest(client, Trigger.Request()) as first:
            await until(node, first.is_answered, 60.0)
        for _ in range(2):
            client.call_async(Trigger.Request())
        stop = node.create_timer(0.0, stand_still, callback_group=ReentrantCallbackGroup())
        await call(node, client, Trigger.Request(), LIMIT_S)

    stop = node.create_timer(60.0, lambda: None)
    with Spinning() as beside:
        beside.add(Node("server")).create_service(Trigger, "serve", serve)
        spinning.run(calls, timeout_s=120.0)


def test_a_service_is_not_missing_because_its_client_stood_still(
    spinning: Spinning, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting, "LOST_S", LIMIT_S)
    node = spinning.add(Node("client"))
    with LongRequest(node, node.create_client(Trigger, "nobody"), Trigger.Request()) as sent:
        time.sleep(1.5 * LIMIT_S)
        assert not sent.is_over()
        while not sent.is_over():
            time.sleep(0.01)
        assert "the service nobody is missing" in sent.loss


def test_a_long_request_is_sent_again_to_a_server_that_took_the_place_of_another_between_two_looks(
    spinning: Spinning,
) -> None:
    """The number of servers is the same at both looks."""
    asker = spinning.add(Node("asker"))
    silent = Node("silent")  # in no executor
    silent.create_service(Trigger, "serve", lambda _, response: response)
    client = asker.create_client(Trigger, "serve")

    def eventually(done: Callable[[], bool]) -> None:
        spinning.run(until, asker, done, 60.0, timeout_s=120.0)

    def servers() -> frozenset[Hashable]:
        return servers_of(asker, "serve")

    eventually(lambda: client.service_is_ready() and len(servers()) == 1)
    first = servers()
    with LongRequest(asker, client, Trigger.Request()) as sent:
        assert not sent.is_over()
        silent.destroy_node()
        spinning.add(Node("successor")).create_service(Trigger, "serve", lambda _, response: response)
        eventually(lambda: len(servers()) == 1 and servers() != first)
        eventually(sent.is_answered)


def test_worker_keeps_order_and_survives_errors(spinning: Spinning) -> None:
    node = spinning.add(Node("worker"))
    errors: list[Exception] = []
    done: list[int] = []
    worker = Worker(node, errors.append)

    def job(number: int) -> int:
        if number == 2:
            raise ValueError("job 2")
        done.append(number)
        return number

    for number in range(5):
        worker.submit(job, number)

    async def results() -> int:
        with pytest.raises(ValueError, match="job 2"):
            await wait_for(node, worker.run(job, 2), 5.0)
        return await wait_for(node, worker.run(job, 7), 5.0)

    assert spinning.run(results) == 7
    assert done == [0, 1, 3, 4, 7]
    assert [str(error) for error in errors] == ["job 2"]
    assert worker.pending == 0
    begun, release = threading.Event(), threading.Event()
    worker.submit(lambda: (begun.set(), release.wait()))
    assert begun.wait(5.0)
    worker.submit(job, 8)
    assert not worker.stop(0.05)
    release.set()
    assert worker.stop(5.0)
    assert 8 not in done


def test_pairs_by_equal_stamps_and_counts_the_rest(spinning: Spinning) -> None:
    node, camera = spinning.add(Node("reader")), Node("camera")
    pairs: list[tuple[int, int]] = []
    joined = ImageExposurePairs(node, lambda image, exposure: pairs.append((image_view(image).stamp, exposure.index)))
    images = camera.create_publisher(Image, "camera/image_raw", IMAGES)
    exposures = camera.create_publisher(Exposure, "camera/exposure", IMAGES)

    async def matched() -> None:
        await until(node, lambda: images.get_subscription_count() + exposures.get_subscription_count() == 2, 10.0)

    spinning.run(matched)
    picture = np.zeros((4, 4), dtype=np.uint8)
    for index in (1, 2, 4, 5):
        exposure = Exposure(index=index)
        exposure.header.stamp = to_msg(10 * index)
        exposures.publish(exposure)
    for index in (1, 3, 4, 5):
        images.publish(image_message(picture, stamp_ns=10 * index, frame_id=""))

    async def paired() -> None:
        await until(node, lambda: len(pairs) == 3, 10.0)

    spinning.run(paired)
    assert pairs == [(10, 1), (40, 4), (50, 5)]
    assert joined.unpaired == 2  # exposure 2 and image 3
    assert joined.waiting == 0
    camera.destroy_node()


def test_diagnostics_once_a_second(spinning: Spinning) -> None:
    node = spinning.add(Node("busy"))
    reports: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, DIAGNOSTICS)
    diagnostics = NodeDiagnostics(node)
    for _ in range(10):
        diagnostics.success(0.25)
    diagnostics.drop(3)

    async def reported(count: int) -> None:
        await until(node, lambda: len(reports) >= count, 5.0)

    spinning.run(reported, 1)
    first = reports[0].status[0]
    values = {entry.key: entry.value for entry in first.values}
    assert (first.name, first.level, values["drops"], values["latency_s"]) == (
        "/busy",
        DiagnosticStatus.WARN,
        "3",
        "0.25",
    )
    assert 5 < float(values["rate_hz"]) <= 10
    diagnostics.failure("no light")
    spinning.run(reported, 2)
    assert (reports[1].status[0].level, reports[1].status[0].message) == (DiagnosticStatus.ERROR, "no light")


@pytest.mark.skipif(
    not Path(sys.prefix, "lib", "unlimited_wait.so").exists(), reason="an installed ROS 2 waits on the steady clock"
)
def test_a_wait_until_the_overflown_end_of_the_clock_lasts() -> None:
    """Fast DDS asks again and again when it is refused, and its process never ends (decision 0033)."""
    library = ctypes.CDLL(None)
    condition, mutex = (ctypes.create_string_buffer(64) for _ in range(2))  # zeros: as initialised in C
    until = (ctypes.c_long * 2)(-9223372037, 0)
    ended: list[int] = []

    def wait() -> None:
        library.pthread_mutex_lock(mutex)
        ended.append(library.pthread_cond_timedwait(condition, mutex, until))
        library.pthread_mutex_unlock(mutex)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    waiting.join(0.2)
    assert waiting.is_alive(), f"refused with error {ended}"
    while waiting.is_alive():  # a signal before the wait is lost
        library.pthread_cond_signal(condition)
        waiting.join(0.01)
    assert ended == [0]


NODE_PROGRAM = """
import signal
import sys
import time
import rclpy
from rclpy.node import Node
from std_msgs.msg import Empty
from fringedic.errors import ProcessError
from fringedic_ros.main import run

class Minding(Node):
    def __init__(self):
        super().__init__("minding")
        signal.signal(signal.SIGUSR1, lambda *_: print("minded", flush=True))
        self.create_timer(0.01, lambda: None)  # Python's handlers run when the executor returns to Python
        print("standing", flush=True)

class Failing(Node):
    def __init__(self):
        super().__init__("failing")
        self.create_timer(0.01, self.fail)
    def fail(self):
        raise ZeroDivisionError("a bug")

class Slow(Node):
    def __init__(self):
        super().__init__("slow")
        for number in range(20):
            time.sleep(0.1)
            self.create_publisher(Empty, f"topic_{number}", 1)
        print("made", flush=True)
    def destroy_node(self):
        print("closing", flush=True)
        time.sleep(0.5)
        super().destroy_node()
        print("closed", flush=True)

def refuse():
    raise ProcessError("there is no camera")

print("ready", flush=True)
classes = {"failing": Failing, "minding": Minding, "slow": Slow}
nodes = {"good": lambda: Node("good"), "refused": refuse, **classes}
sys.exit(run(nodes[sys.argv[1]]))
"""


@contextmanager
def node_program(which: str) -> Iterator[tuple[subprocess.Popen[str], IO[str]]]:
    """Run one node of the program above; yields its process and what it writes after its imports."""
    with subprocess.Popen(
        [sys.executable, "-c", NODE_PROGRAM, which], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process, process.stdout


@pytest.mark.parametrize(
    ("which", "sent", "code", "words"),
    [
        ("good", signal.SIGINT, 0, ""),
        ("good", signal.SIGTERM, 0, ""),
        ("failing", None, 1, "ZeroDivisionError: a bug"),
        ("refused", None, 1, "ProcessError: there is no camera"),
    ],
)
def test_process_ends_as_it_should(which: str, sent: signal.Signals | None, code: int, words: str) -> None:
    with node_program(which) as (process, _):
        if sent is not None:
            time.sleep(1.0)
            process.send_signal(sent)
        _, log = process.communicate(timeout=300)
    assert process.returncode == code, log
    assert words in log
    assert which != "refused" or "Traceback" not in log
    assert which != "good" or log == ""


def test_signals_tear_nothing() -> None:
    """One that comes while the node is being made, and one while it is being destroyed."""
    with node_program("slow") as (process, written):
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGINT)
        assert written.readline() == "made\n"
        assert written.readline() == "closing\n"
        process.send_signal(signal.SIGINT)
        rest, log = process.communicate(timeout=300)
    assert (process.returncode, rest, log) == (0, "closed\n", "")


def test_other_signals_do_not_end_a_node() -> None:
    with node_program("minding") as (process, written):
        assert written.readline() == "standing\n"
        for _ in range(2):
            process.send_signal(signal.SIGUSR1)
            assert written.readline() == "minded\n"
        process.send_signal(signal.SIGTERM)
        rest, log = process.communicate(timeout=300)
    assert (process.returncode, rest, log) == (0, "", "")
