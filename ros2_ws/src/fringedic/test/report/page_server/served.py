"""A server of the page over a small rig that keeps its commands, and requests to it."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from websockets.sync.client import ClientConnection, connect

from fringedic.configuration.programme import Programme
from fringedic.configuration.test_card import Card
from fringedic.configuration.test_form import DEFAULT_FORM, answered_specimen
from fringedic.datasets.stores import save_netcdf
from fringedic.errors import OperatorError
from fringedic.metadata import SpecimenMetadata
from fringedic.report.page_server.maps import SpooledMaps
from fringedic.report.page_server.recorded import RecordedRig
from fringedic.report.page_server.server import Address, PageServer

TOKEN = "secret of this test"


class Answer(NamedTuple):
    """Status, headers and content of an answer."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def message(self) -> str:
        return str(json.loads(self.body)["message"])


@dataclass
class SmallRig:
    """Two steps with a map each; keeps the commands and refuses a hold."""

    folder: Path
    commands: list[Any] = field(default_factory=list)
    occupied: str = ""
    state: dict[str, Any] = field(default_factory=lambda: {"rig": {"kind": "rig", "force": float("nan")}})

    def __post_init__(self) -> None:
        self.maps = SpooledMaps(self.folder / "maps")
        self.put_maps()

    def put_maps(self, hole: int | None = None) -> None:
        """Keep the maps of both steps, with NaN in a column that is not measured."""
        column, row = np.meshgrid(np.arange(5.0), np.arange(4.0))
        plane = {"x": 1e-3 * column, "y": -1e-3 * row, "z": 0 * row, "v": 0 * row, "w": 0 * row}
        sigmas = {"sigma_u": 1e-7 + 0 * row, "sigma_v": 0 * row, "sigma_w": 0 * row}
        for step in (0, 1):
            maps = plane | {"u": 1e-5 * step * column, **sigmas}
            seen = np.where(column == (-1 if hole is None else hole), np.nan, 1.0)
            kept = {name: (values * seen).astype(np.float32) for name, values in maps.items()}
            self.maps.put(step, kept, spacing=8)

    def snapshot(self) -> dict[str, Any]:
        return self.state

    def opened(self, test: str) -> RecordedRig:
        raise OperatorError(f"there is no test {test}")

    def folders(self) -> Mapping[str, Path]:
        return {"run": self.folder}

    def busy(self) -> str:
        return self.occupied

    async def check(self, text: str) -> dict[str, Any]:
        return {"rows": [], "count": 0, "words": text, "problem": ""}

    async def do(self, command: Any) -> str:
        self.commands.append(command)
        if type(command).__name__ == "Hold":
            raise OperatorError("there is no machine")
        return "started"


def write_test(
    recordings: Path, name: str, answers: dict[str, str | float], *, stretch: float, failed: int = 0
) -> Path:
    """Write the folder of a test with three planned steps, of which a plane is stretched along x; return it."""
    folder = recordings / name
    (folder / "bag").mkdir(parents=True)
    programme = Programme.model_validate({"experiment": name, "ramp": {"to_mm": 1.0, "steps": 3}})
    Card(rig_file="tiny.yaml", answers=answers, programme=programme).save(folder)
    column, row = np.meshgrid(8.0 * np.arange(20), 8.0 * np.arange(12))
    steps, over = np.arange(3), ("step", "row", "column")
    fields = {"x": 1e-4 * column, "y": -1e-4 * row, "z": 0 * row, "v": 0 * row, "w": 0 * row, "texture": 100 + row}
    maps = {each: (over, np.stack([values] * 3).astype(np.float32)) for each, values in fields.items()}
    maps["u"] = over, np.stack([stretch * step * 1e-4 * column for step in steps]).astype(np.float32)
    maps["sigma_u"] = over, np.full((3, *row.shape), 1e-7, np.float32)
    signals = {"force": ("step", 100.0 * steps), "position": ("step", 5e-4 * steps)}
    errors = ["no light (error 3)" if step >= 3 - failed else "" for step in steps]
    values = {"valid_fraction": ("step", np.ones(3)), "error": ("step", errors), "reference_step": ("step", [0, 0, 0])}
    times = np.datetime64("2026-11-01T10:00:00", "ns") + steps * np.timedelta64(10, "s")
    places = {"step": steps, "time": ("step", times), "row": row[:, 0], "column": column[0]}
    specimen = answered_specimen(DEFAULT_FORM, SpecimenMetadata(), answers)
    facts = json.dumps({"specimen": specimen.model_dump(exclude_defaults=True)})
    units = {"force": "N", "position": "m"}
    dataset = xr.Dataset({**maps, **signals, **values}, places, {"experiment": name, "facts": facts})
    for each, unit in units.items():
        dataset[each].attrs["units"] = unit
    save_netcdf(dataset, folder / "results.nc")
    (folder / "report.html").write_text(f"the report of {name}")
    return folder


@dataclass
class Site:
    """A running server with its rig."""

    port: int
    rig: SmallRig
    server: PageServer
    answer_s: float = 10.0

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def request(self, method: str, path: str, body: str | None = None, **headers: str) -> Answer:
        """Send a request exactly as given; header names are written with underscores."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=self.answer_s)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, named)
        answer = connection.getresponse()
        found = Answer(answer.status, dict(answer.headers), answer.read())
        connection.close()
        return found

    def login(self) -> str:
        """Return the cookie of a new session."""
        answer = self.request("GET", f"/?token={TOKEN.replace(' ', '%20')}")
        assert answer.status == 303
        return answer.headers["set-cookie"].partition(";")[0]

    def get(self, path: str, cookie: str) -> Answer:
        return self.request("GET", path, Cookie=cookie)

    def post(self, name: str, content: Any, cookie: str) -> Answer:
        headers = {"Cookie": cookie, "Origin": self.origin, "Content_Type": "application/json"}
        return self.request("POST", f"/do/{name}", json.dumps(content), **headers)

    def stream(self, cookie: str, origin: str | None = None) -> ClientConnection:
        headers = {"Cookie": cookie}
        return connect(
            f"ws://127.0.0.1:{self.port}/stream",
            additional_headers=headers,
            origin=origin or self.origin,  # type: ignore[arg-type]
            compression=None,
        )


def free_port() -> int:
    """Return a port of this computer that nobody listens to."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def served(folder: Path, kind: type[SmallRig] = SmallRig) -> Iterator[Site]:
    """Serve a small rig."""
    port, rig = free_port(), kind(folder)
    server = PageServer(rig, Address("127.0.0.1", port, TOKEN))
    try:
        yield Site(port, rig, server)
    finally:
        server.close()
