"""What a testing machine answers to the queries of its file, beside the meaning, on a terminal."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, NamedTuple

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from fringedic.errors import MachineError

if TYPE_CHECKING:
    from load_frame_node.machines import Answer, DescribedMachine, Sample

PERIOD_S = 0.5  # between two looks at the machine
_UNITS = {"force": (1.0, "N", 3), "position": (1e3, "mm", 4), "time": (1.0, "s", 3)}  # per SI unit, decimals


class MachineView(NamedTuple):
    """One look at a machine.

    Attributes
    ----------
    answers
        Answer to each entry of the file; none when the machine does not answer at all.
    sample
        The sample that the load frame node would publish; None when there is none.
    problems
        What does not fit and what to change, one sentence each.
    """

    answers: list[Answer]
    sample: Sample | None
    problems: list[str]


def look(machine: DescribedMachine[Any]) -> MachineView:
    """Query the machine once; nothing that moves it is sent."""
    try:
        answers = machine.inspect()
    except MachineError as error:
        return MachineView([], None, [str(error)])
    problems = [str(answer.error) for answer in answers if answer.error is not None]
    if problems:
        return MachineView(answers, None, problems)
    try:
        sample = machine.sample()
    except MachineError as error:
        return MachineView(answers, None, [str(error)])
    return MachineView(answers, sample, [sample.unknown] if sample.unknown else [])


def draw_continuously(console: Console, machine: DescribedMachine[Any], lines: list[str]) -> None:
    """Look at the machine about twice a second and draw it in place of the look before.

    Parameters
    ----------
    console
        The terminal.
    machine
        The machine.
    lines
        What stands above each look.
    """
    with Live(console=console, auto_refresh=False, screen=True) as screen:
        while True:
            due = time.monotonic() + PERIOD_S
            screen.update(_drawing(machine, look(machine), [*lines, "", "Ctrl-C ends"]), refresh=True)
            time.sleep(max(due - time.monotonic(), 0.0))


def print_view(console: Console, machine: DescribedMachine[Any], view: MachineView) -> None:
    """Print one look."""
    console.print(_drawing(machine, view, []))


def requests(machine: DescribedMachine[Any]) -> list[str]:
    """Return lines about the machine: what is sent to it, and what is not."""
    description, limits = machine.description, machine.description.limits
    start = machine.start_requests()
    lines = [machine.title, f"sent: {_listed(start) + ' after connecting, then ' if start else ''}the queries below"]
    if description.move is not None and limits is not None:
        position, speed = (limits.lowest_mm + limits.highest_mm) / 2, limits.fastest_mm_per_s
        sent = machine.move_requests(1e-3 * position, 1e-3 * speed)
        lines.append(f"not sent, a move to {position:g} mm at {speed:g} mm/s: {_listed(sent)}")
    if description.hold:
        lines.append(f"not sent, a hold: {_listed(machine.hold_requests())}")
    return lines


def _drawing(machine: DescribedMachine[Any], view: MachineView, lines: list[str]) -> RenderableType:
    parts: list[RenderableType] = [Text(line, style="dim") for line in lines]
    if view.answers:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
        for name in ("entry", "asked", "answered", "meaning"):
            table.add_column(name, overflow="fold")
        for answer in view.answers:
            style = "" if answer.error is None else "red"
            table.add_row(answer.entry, answer.request, answer.raw, _meaning(answer, machine), style=style)
        if view.sample is not None and all(answer.entry != "status" for answer in view.answers):
            table.add_row("status", "", "from the motion", view.sample.mode.name)
        parts.append(table)
    parts += [Text(each, style="bold red") for each in view.problems]
    if not view.problems:
        parts.append(Text("every answer fits the machine file", style="green"))
    return Group(*parts)


def _meaning(answer: Answer, machine: DescribedMachine[Any]) -> str:
    if answer.value is None:
        return "-"
    if answer.entry == "status":
        return f"{machine.description.status.mode(answer.value).name}"
    signal = machine.description.signals.get(answer.entry.partition(".")[2])
    if signal is not None:
        return f"{float(answer.value):.6g} {signal.channel(answer.entry, '').unit}"
    factor, unit, decimals = _UNITS[answer.entry]
    return f"{factor * float(answer.value):.{decimals}f} {unit}"


def _listed(requests: list[str]) -> str:
    return ", ".join(requests)
