"""Worker processes that die: which recording is the cause."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from fringedic.campaign import Failure, Processes, Unit


class Deadly(Unit):
    """A unit that ends every process which receives it, as one does that needs too much memory."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os._exit, (1,)


def test_a_recording_that_ends_its_worker_does_not_take_its_neighbour_with_it(tmp_path: Path) -> None:
    def unit(kind: type[Unit], name: str) -> Unit:
        return kind(name, name, str(tmp_path / "store"), "key", {}, {}, {"bag": (1, 1)}, {}, 1, 1, 0.0)

    units = [unit(Deadly, "deadly"), unit(Unit, "neighbour")]
    outcomes = {each.name: each for each in Processes(2).outcomes(units)}
    assert outcomes.keys() == {each.name for each in units}
    died = {
        name for name, each in outcomes.items() if isinstance(each, Failure) and "worker died 3 times" in each.reason
    }
    assert died == {"deadly"}
