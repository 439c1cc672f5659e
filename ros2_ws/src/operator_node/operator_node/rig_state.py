"""State of a rig for the page, from its messages: nodes, load frame, recorder, steps, procedures, log."""

from __future__ import annotations

import math
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fringedic.patterns.pattern import PatternKind
from fringedic.report.page_server.maps import described_signal
from fringedic.rig_setup.check_list import SetupItem
from fringedic.rig_setup.live_sentences import TITLES, live_entries
from fringedic.signals import Sample
from fringedic.wording.translation import translatable
from fringedic_msgs.msg import ProcedureStatus, StepStatus

LOG_LINES = 200
MOST_NODES = 200  # names of diagnostics that are shown; drivers of others may send any number
OTHER_NODES = {
    "name": "other diagnostics",
    "level": "warning",
    "message": f"there may be more than {MOST_NODES} names; the others are not shown",
    "values": {},
}
MOST_VALUES = 100  # of the diagnostics of a node
LONGEST_TEXT = 2000  # characters of a text from elsewhere: the page is sent whole lists of them
RATE_SPAN_S = 60.0  # over which the use of the disk is averaged
SILENT_S = 5.0  # without diagnostics, after which a node is called silent
BUSY = range(ProcedureStatus.RUNNING, ProcedureStatus.DONE)
STAGES = translatable(("begin", "frames", "processing", "measured", "failed"))
LOAD_MODES = translatable(("unknown", "idle", "moving", "hold", "fault"))
RECORDER_STATES = translatable(("idle", "starting", "recording", "failed"))
NODE_LEVELS = translatable(("ok", "warning", "error", "silent"))
LEVELS = {20: "info", 30: "warning", 40: "error", 50: "fatal"}
PROCEDURE_TITLES = {item.value: title for item, title in TITLES.items()} | {
    "live": translatable("Live view"),
    "settings": translatable("Change of the rig file"),
    "run": translatable("Programme"),
    "by_hand": translatable("Measuring by hand"),
}
KINDS = {"white": PatternKind.WHITE, "fringes": PatternKind.FRINGES}


class RigState:
    """The latest messages of a rig as plain values, from any thread.

    Parameters
    ----------
    clock
        Returns the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._nodes: dict[str, tuple[float, dict[str, Any]]] = {}
        self._steps: dict[int, dict[str, Any]] = {}
        self._log: deque[dict[str, Any]] = deque(maxlen=LOG_LINES)
        self._written: deque[tuple[float, int]] = deque()
        self._parts: dict[str, Any] = {
            "procedure": None,
            "live": None,
            "setup": [],
            "load": None,
            "figures": None,
            "signals": [],
        }
        self._parts |= {"recorder": None, "step": None, "hand": "", "signals": []}
        self._seen: dict[str, float] = {}  # last sign of the nodes of some parts
        self._experiment = ""
        self._is_busy, self._begun = False, 0.0  # of the procedure: whether it runs, and since when
        self._remaining = RemainingTime()

    @property
    def is_busy(self) -> bool:
        """Whether a procedure runs, apart from the live view."""
        return self._is_busy

    def snapshot(self, mapped: Mapping[int, int]) -> dict[str, Any]:
        """Return topics of the page and their data.

        Parameters
        ----------
        mapped
            Steps with maps, also those of a server that was ended: 1 with maps in the image, 2 also of the surface.
        """
        now = self._clock()
        with self._lock:
            # those of a procedure that has ended have ended with it
            nodes = [
                node | ({"level": "silent", "message": translatable("no diagnostics")} if now - seen > SILENT_S else {})
                for seen, node in self._nodes.values()
                if self._is_present(seen, now)
            ]
            if len(nodes) == MOST_NODES:
                nodes.append(OTHER_NODES)
            steps = [
                self._steps.get(number, {"step": number, "error": ""}) | {"mapped": mapped.get(number, 0)}
                for number in sorted(self._steps.keys() | mapped.keys())
            ]
            # a node that is gone sends nothing about it: its last state is not the present one
            silent: dict[str, Any] = {part: None for part, seen in self._seen.items() if now - seen > SILENT_S}
            if "signals" in silent:  # curves still need their names and units
                silent["signals"] = [each | {"value": None} for each in self._parts["signals"]]
            return {**self._parts, **silent, "nodes": nodes, "steps": steps, "log": list(self._log)}

    @property
    def experiment(self) -> str:
        """Name of the experiment of the latest step."""
        return self._experiment

    def take_step(self, message: Any) -> bool:
        """Take a stage of a step; return whether another experiment has begun."""
        with self._lock:
            another: bool = message.experiment != self._experiment
            if another:
                self._experiment = message.experiment
                self._steps.clear()
            self._parts["step"] = {
                "step": message.step,
                "stage": STAGES[message.stage],
                "frame": message.frame,
                "frames": message.frames,
            }
            row = self._steps.setdefault(message.step, {"step": message.step, "error": ""})
            row["stage"], row["reference"] = STAGES[message.stage], message.reference
            if message.stage == StepStatus.ERROR:
                row["error"] = f"{_shortened(message.error_message)} (error {message.error_code})"
            elif message.stage == StepStatus.END:
                row["signals"] = {each["name"]: each["value"] for each in self._parts["signals"]}
            return another

    def take_maps(self, status: Any, *, surface: bool) -> None:
        """Take the arrival of a step's maps, those in the image or those of the surface, with the status after them."""
        with self._lock:
            done = {"step": status.step, "error": "", "stage": STAGES[StepStatus.END]}
            row = self._steps.setdefault(status.step, done)
            row["valid_fraction"], row["reference_step"] = status.valid_fraction, status.reference_step
            if surface:
                row["rms_displacement"] = status.rms_displacement

    def take_load(self, message: Any) -> None:
        """Take the mode of the load frame."""
        mode = LOAD_MODES[message.mode] if message.mode < len(LOAD_MODES) else f"mode {message.mode}"
        self._seen["load"] = self._clock()
        self._set("load", {"mode": f"{mode} ({_shortened(message.reason)})" if message.reason else mode})

    def take_signals(self, latest: Mapping[str, Sample]) -> None:
        """Take the latest sample of each signal, rounded so that noise is no change."""
        described = [
            described_signal(name, sample.channel.unit, sample.channel.source) | {"value": _rounded(sample.value, 4)}
            for name, sample in latest.items()
        ]
        self._seen["signals"] = self._clock()
        self._set("signals", described)

    def take_recorder(self, message: Any) -> None:
        """Take the state of the recorder, and estimate how long the disk lasts."""
        now = self._clock()
        self._written.append((now, message.bytes))
        while now - self._written[0][0] > RATE_SPAN_S or self._written[0][1] > message.bytes:
            self._written.popleft()
        passed, grown = now - self._written[0][0], message.bytes - self._written[0][1]
        self._seen["recorder"] = now
        free = _free_bytes(Path(message.path))
        rate = grown / passed if passed > 1 else 0.0
        self._set(
            "recorder",
            {
                "state": RECORDER_STATES[message.state],
                "images": message.images,
                "missing_images": message.missing_images,
                "free_gb": None if free is None else round(1e-9 * free, 1),
                "minutes_left": None if free is None or rate < 1 else round(free / rate / 60),
                "error": message.error_message,
            },
        )

    def take_diagnostics(self, message: Any) -> None:
        """Take the diagnostics of nodes; of more than `MOST_NODES`, those that came first."""
        now = self._clock()
        with self._lock:
            if len(self._nodes) + len(message.status) > MOST_NODES:
                self._nodes = {name: each for name, each in self._nodes.items() if self._is_present(each[0], now)}
            for status in message.status:
                if status.name.rpartition("/")[2] == "recorder" and "recorder" in self._seen:
                    self._seen["recorder"] = now  # its own topic has the changes alone
                if status.name not in self._nodes and len(self._nodes) >= MOST_NODES:
                    continue
                values = {_shortened(each.key): _shortened(each.value) for each in status.values[:MOST_VALUES]}
                level = NODE_LEVELS[_level(status.level)]
                words = {"name": _shortened(status.name), "level": level, "message": _shortened(status.message)}
                self._nodes[status.name] = (now, words | {"values": values})

    def _is_present(self, seen: float, now: float) -> bool:
        """Return whether a node with diagnostics at a time is shown."""
        return now - seen <= SILENT_S or (self._is_busy and seen > self._begun)

    def take_log(self, message: Any) -> None:
        """Take a line of the log."""
        line = {"time": message.stamp.sec, "level": LEVELS.get(message.level, ""), "node": message.name}
        with self._lock:
            self._log.append(line | {"text": _shortened(message.msg)})

    def take_procedure(self, message: Any, topic: str) -> None:
        """Take the state of the procedure (topic "procedure") or of the live view ("live")."""
        reports = [
            {
                "step": each.step,
                "signals": {"position": each.position, "force": each.force},
                "valid_fraction": each.valid_fraction,
                "rms_displacement": None if math.isnan(each.rms_displacement) else each.rms_displacement,
                "error": each.error_message,
            }
            for each in message.reports
        ]
        names = (
            "procedure",
            "state",
            "activity",
            "step",
            "steps",
            "frame",
            "frames",
            "question",
            "pattern",
            "settings",
        )
        data = {name: getattr(message, name) for name in names}
        remaining = self._remaining_s(message) if topic == "procedure" else None
        data |= {
            "title": PROCEDURE_TITLES.get(message.procedure, message.procedure),
            "remaining_s": None if remaining is None else math.ceil(remaining),
            "folder": Path(message.folder).name,
            "notes": list(message.notes),
            "words": list(message.words),
            "error": message.error_message,
            "reports": reports,
        }
        with self._lock:
            self._parts[topic] = data
            for report in reports:
                row = self._steps.get(report["step"])
                if row is not None:
                    row |= report | {"signals": row.get("signals", {}) | report["signals"]}

    def _remaining_s(self, message: Any) -> float | None:
        """Return the estimated time until the last step or part is done [s], None when it is not known."""
        now, busy = self._clock(), message.state in BUSY
        if busy and not self._is_busy:
            self._begun = now
        self._is_busy = busy
        return self._remaining.update(
            now, _done(message) if busy else math.nan, paused=message.state == ProcedureStatus.PAUSED
        )

    def take_setup(self, message: Any) -> None:
        """Take the check list of the set-up."""
        items = [
            {
                "item": each.item,
                "title": TITLES[SetupItem(each.item)],
                "state": each.state,
                "done": each.done.sec,
                "words": list(each.words),
                "next": each.next,
                "picture": f"/files/{each.item}/{each.picture}" if each.picture else "",
                "report": _report(each.item, each.folder),
            }
            for each in message.items
        ]
        self._set("setup", items)

    def take_figures(self, message: Any) -> None:
        """Take the figures of a live image."""
        live = self._parts["live"]
        kind = KINDS.get(live["pattern"] if live else "", PatternKind.OTHER)
        entries = [[each.name, each.value, each.advice, each.good] for each in live_entries(message, kind)]
        histogram = [sum(message.histogram[k : k + 4]) for k in range(0, len(message.histogram), 4)]
        self._set("figures", {"focus": message.focus, "entries": entries, "histogram": histogram})

    def set_hand(self, words: str) -> None:
        """Take a sentence about the step that is measured by hand."""
        self._set("hand", words)

    def _set(self, topic: str, data: Any) -> None:
        with self._lock:
            self._parts[topic] = data


class RemainingTime:
    """Time that a procedure still takes, from the time that its parts have taken so far; pauses do not count."""

    def __init__(self) -> None:
        self._first, self._done = math.nan, math.nan
        self._spent, self._seen = 0.0, 0.0
        self._was_paused = False

    def update(self, now: float, done: float, *, paused: bool) -> float | None:
        """Return the remaining time [s], None while nothing has been done, and when only the results are missing.

        Parameters
        ----------
        now
            Present time [s].
        done
            Fraction of the parts that are done; NaN where there are none. A smaller one than before is that of
            another procedure, or of another series of parts.
        paused
            Whether it pauses.
        """
        if not done >= self._done:
            self._first, self._spent = done, 0.0
        elif not self._was_paused:
            self._spent += now - self._seen
        self._done, self._seen, self._was_paused = done, now, paused
        passed = done - self._first
        return self._spent / passed * (1 - done) if passed > 0 and done < 1 else None


def _done(message: Any) -> float:
    """Return the fraction of a procedure's steps that are done, or of the frames where there is one step only."""
    if message.steps > 1:
        return float(max(message.step, 0) / message.steps)
    return float(message.frame / message.frames) if message.steps and message.frames else math.nan


def _report(item: str, folder: str) -> str:
    """Return the address of the page in the folder of a result, empty without one."""
    pages = sorted(Path(folder).glob("*.html")) if folder else []
    return f"/files/{item}/{pages[0].name}" if pages else ""


def _level(level: bytes | int) -> int:
    return min(level[0] if isinstance(level, bytes) else int(level), 3)


def _shortened(text: str) -> str:
    """Return a text from elsewhere without what the page has no room for."""
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}... ({len(text)} characters)"


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}") if math.isfinite(value) else value


def _free_bytes(path: Path) -> int | None:
    """Return the free space where a recording is, None when it is on another computer."""
    for place in (path, *path.parents):
        if place.exists():
            return shutil.disk_usage(place).free
    return None
