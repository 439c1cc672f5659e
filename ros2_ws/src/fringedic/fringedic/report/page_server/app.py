"""The web application: page, maps, files, commands and the stream of states and images."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import math
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from fringedic.errors import FringedicError, OperatorError
from fringedic.figures.palettes import PALETTES, palette
from fringedic.frames.region import Point
from fringedic.report.page_server import maps
from fringedic.report.page_server.access import Wheel
from fringedic.report.page_server.catalogue import small_picture
from fringedic.report.page_server.evaluations import NICE, Evaluate, Evaluations, Export, Preview
from fringedic.report.page_server.guard import REPORT_POLICY
from fringedic.report.page_server.languages import words_in
from fringedic.report.page_server.manual import manual_file, manual_page
from fringedic.report.page_server.marks import Asked, KeepMarks, readings
from fringedic.report.page_server.recorded import RecordedRig
from fringedic.report.page_server.streams import Client, Hub
from fringedic.wording.translation import Sentence, translatable

PAGE = Path(__file__).with_name("static")
LARGEST_BODY = 500_000  # [byte] of a command; the longest is a programme
STATE_PERIOD_S = 0.2
SHOWN_FILES = {".html", ".png", ".yaml"}
Measurement = Literal["timing", "response", "calibrate", "check", "region", "noise", "advise"]
Procedure = Literal[Measurement, "live", "confirm", "use", "settings", "run", "by_hand"]
Pattern = Literal["white", "fringes", "focus", "crosshair", "axes", "camera_focus", "projector_focus", Measurement]


class _Command(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Start(_Command):
    """Starts a procedure; the fields are those of ``fringedic_msgs/StartProcedure``, which checks the options."""

    procedure: Procedure
    pattern: Pattern = "white"
    text: str = Field("", max_length=400_000)
    options: dict[str, bool | int | float | str | dict[str, float | str]] = Field({}, max_length=20)


class Control(_Command):
    """Controls the procedure that runs."""

    command: Literal["pause", "resume", "stop", "confirm", "refuse"]


class Measure(_Command):
    """Measures one step by hand."""

    mode: Literal["fringes", "white"] = "fringes"
    set_reference: bool = False


class Check(_Command):
    """Asks what a programme would do; empty: that of the rig file."""

    text: str = Field("", max_length=400_000)


class Alarm(_Command):
    """Limits of a signal in its own unit, at which a hold of the machine is requested."""

    signal: str = Field(max_length=200)
    below: float | None = None
    above: float | None = None


class SetAlarms(_Command):
    """Sets the limits in place of those before; they are in force again after one was reached."""

    alarms: list[Alarm] = Field([], max_length=20)


class PlanSeries(_Command):
    """Plans tests of several specimens with one programme; empty: none."""

    specimens: list[str] = Field([], max_length=200)
    answers: dict[str, float | str] = Field({}, max_length=40)
    text: str = Field("", max_length=400_000)


class Compose(_Command):
    """Asks for the text of a programme that was changed in the form."""

    programme: dict[str, Any]


class TurnWheel(_Command):
    """Asks for the wheel, or hands it over."""

    action: Literal["ask", "give"]


class Hold(_Command):
    """Requests a hold of the machine."""


CommandT = TypeVar("CommandT", bound=BaseModel)
COMMANDS: dict[str, type[BaseModel]] = {
    "start": Start,
    "control": Control,
    "measure": Measure,
    "hold": Hold,
    "marks": KeepMarks,
    "alarms": SetAlarms,
    "series": PlanSeries,
}
FOR_EVERYBODY = ("hold",)  # these commands need no wheel


class Rig(Protocol):
    """What the page shows and drives: a running rig, or a recording."""

    @property
    def maps(self) -> maps.StepMaps:
        """The maps of the steps."""

    def snapshot(self) -> dict[str, Any]:
        """Return the state, without the maps, as plain values: topic -> data, published when they change."""

    def opened(self, test: str) -> RecordedRig:
        """Return an earlier test.

        Raises
        ------
        OperatorError
            There is no such test, or it has no results.
        """

    def folders(self) -> Mapping[str, Path]:
        """Return the folders whose files the page may show, by their names."""

    def busy(self) -> str:
        """Return why nothing else may be computed now, such as a test that runs; "" when it may."""

    async def do(self, command: Any) -> str:
        """Execute a command and return a sentence about its effect.

        Raises
        ------
        OperatorError
            It is refused.
        """

    async def check(self, text: str) -> dict[str, Any]:
        """Return what a programme would do: ``rows``, ``count``, ``words``, and the ``problem`` that prevents it.

        Raises
        ------
        OperatorError
            There is no rig for it.
        """


def make_app(rig: Rig, hub: Hub, wheel: Wheel) -> Starlette:
    """Return the application, without the `Guard` that has to stand before it.

    Parameters
    ----------
    rig
        What is shown.
    hub
        Distributes images, which the owner publishes, and states.
    wheel
        The session that drives.
    """
    site = _Site(rig, hub, wheel)
    return Starlette(
        routes=[
            Route("/", site.index),
            Mount("/page", StaticFiles(directory=PAGE)),
            Route("/maps/{step:int}/{name}", site.tile),
            Route("/cloud/{step:int}/{name}", site.cloud),
            Route("/line/{step:int}/{name}", site.line),
            Route("/gauge", site.gauge),
            Route("/readings", site.readings, methods=["POST"]),
            Route("/tests/{name}", site.test),
            Route("/tests/{name}/picture", site.picture),
            Route("/palettes", site.palettes),
            Route("/words", site.words),
            Route("/files/{folder}/{name}", site.file),
            Route("/evaluations/{folder}", site.evaluations),
            Route("/evaluations/{folder}", site.evaluate, methods=["POST"]),
            Route("/evaluations/{folder}/preview", site.preview, methods=["POST"]),
            Route("/evaluations/{folder}/{name}/report", site.evaluation_report),
            Route("/preview/{name}", site.previewed),
            Route("/export/{folder}", site.export),
            Route("/manual/{page:path}", site.manual),
            Route("/check", site.check, methods=["POST"]),
            Route("/compose", site.compose, methods=["POST"]),
            Route("/do/{name}", site.do, methods=["POST"]),
            WebSocketRoute("/stream", site.stream),
        ],
        lifespan=site.lifespan,
    )


def _answering(
    endpoint: Callable[[_Site, Request], Awaitable[Response]],
) -> Callable[[_Site, Request], Awaitable[Response]]:
    """Turn errors of the library into answers with one sentence."""

    @functools.wraps(endpoint)
    async def answer(site: _Site, request: Request) -> Response:
        try:
            return await endpoint(site, request)
        except FringedicError as error:
            sentence = next((each for each in error.args if isinstance(each, Sentence)), str(error))
            return JSONResponse(_said(sentence), 409)

    return answer


class _Site:
    def __init__(self, rig: Rig, hub: Hub, wheel: Wheel) -> None:
        self._rig, self._hub, self._wheel = rig, hub, wheel
        self._evaluations = Evaluations(rig.busy, 0 if isinstance(rig, RecordedRig) else NICE)
        self._texts: dict[str, tuple[Any, str]] = {}  # data of each topic, and their JSON
        self._published: dict[str, str] = {}  # message of each topic that all clients have

    @contextlib.asynccontextmanager
    async def lifespan(self, _: Starlette) -> Any:
        """Publish the state while the server runs."""
        task = asyncio.create_task(self._publish_changes())
        yield
        task.cancel()
        self._evaluations.close()

    async def index(self, _: Request) -> Response:
        return FileResponse(PAGE / "index.html")

    @_answering
    async def tile(self, request: Request) -> Response:
        found = await run_in_threadpool(maps.tile, await self._maps(request), *_step_and_name(request))
        rows, columns = found.values.shape
        geometry = {"X-Rows": str(rows), "X-Columns": str(columns), "X-Spacing": str(found.spacing)}
        return Response(found.values.astype("<f4").tobytes(), media_type="application/octet-stream", headers=geometry)

    @_answering
    async def cloud(self, request: Request) -> Response:
        points = await run_in_threadpool(maps.cloud, await self._maps(request), *_step_and_name(request))
        return Response(points.astype("<f4").tobytes(), media_type="application/octet-stream")

    @_answering
    async def line(self, request: Request) -> Response:
        ends = _point(request, "from"), _point(request, "to")
        found = await run_in_threadpool(maps.line, await self._maps(request), *_step_and_name(request), *ends)
        return JSONResponse(plain(found))

    @_answering
    async def gauge(self, request: Request) -> Response:
        ends = _point(request, "from"), _point(request, "to")
        subset = _finite("subset", request.query_params.get("subset", ""))
        return JSONResponse(plain(await run_in_threadpool(maps.gauge, await self._maps(request), *ends, subset)))

    @_answering
    async def readings(self, request: Request) -> Response:
        asked = _parsed(Asked, await _body(request))
        return JSONResponse(plain(await run_in_threadpool(readings, await self._maps(request), asked)))

    @_answering
    async def test(self, request: Request) -> Response:
        opened = await run_in_threadpool(self._rig.opened, request.path_params["name"])
        return JSONResponse(plain(opened.snapshot()))

    @_answering
    async def picture(self, request: Request) -> Response:
        opened = await run_in_threadpool(self._rig.opened, request.path_params["name"])
        picture = await run_in_threadpool(small_picture, opened)
        return Response(picture, media_type="image/png", headers={"Cache-Control": "max-age=600"})

    async def _maps(self, request: Request) -> maps.StepMaps:
        """Return the maps of the test that a request names, or of the one that runs or ran last."""
        name = request.query_params.get("test", "")
        return (await run_in_threadpool(self._rig.opened, name)).maps if name else self._rig.maps

    @_answering
    async def palettes(self, _: Request) -> Response:
        return JSONResponse(await run_in_threadpool(_palettes))

    async def words(self, request: Request) -> Response:
        return JSONResponse(words_in(request.query_params.get("languages", "").split(",")))

    async def file(self, request: Request) -> Response:
        folder = self._rig.folders().get(request.path_params["folder"])
        name = Path(request.path_params["name"]).name
        if folder is None or Path(name).suffix not in SHOWN_FILES or not (folder / name).is_file():
            return JSONResponse({"message": f"there is no file {name}"}, 404)
        policy = {"Content-Security-Policy": REPORT_POLICY} if name.endswith(".html") else {}
        return FileResponse(folder / name, headers=policy)

    @_answering
    async def do(self, request: Request) -> Response:
        name, session = request.path_params["name"], request.state.session
        if name == "wheel":
            action = _parsed(TurnWheel, await _body(request)).action
            (self._wheel.ask if action == "ask" else self._wheel.give)(session)
            self._offer_wheel(*self._hub.clients)  # also where nothing has changed: the page waits for it
            return JSONResponse({"message": ""})
        if name not in COMMANDS:
            raise OperatorError(f"{name[:40]}: there is no such command")
        command = _parsed(COMMANDS[name], await _body(request))
        if name not in FOR_EVERYBODY:
            self._wheel.require(session)
        return JSONResponse(_said(await self._rig.do(command)))

    @_answering
    async def check(self, request: Request) -> Response:
        return JSONResponse(plain(await self._rig.check(_parsed(Check, await _body(request)).text)))

    @_answering
    async def manual(self, request: Request) -> Response:
        page = request.path_params["page"]
        if page.endswith((".png", ".svg")):
            return FileResponse(manual_file(page))
        return HTMLResponse(manual_page(page))

    @_answering
    async def evaluations(self, request: Request) -> Response:
        sensor = request.query_params.get("sensor", "")
        return JSONResponse(plain(await run_in_threadpool(self._evaluations.listed, self._folder(request), sensor)))

    @_answering
    async def preview(self, request: Request) -> Response:
        asked = _parsed(Preview, await _body(request))
        return JSONResponse(plain(await run_in_threadpool(self._evaluations.preview, self._folder(request), asked)))

    @_answering
    async def evaluate(self, request: Request) -> Response:
        asked = _parsed(Evaluate, await _body(request))
        self._wheel.require(request.state.session)
        words = await run_in_threadpool(self._evaluations.start, self._folder(request), asked)
        return JSONResponse(_said(words))

    @_answering
    async def previewed(self, request: Request) -> Response:
        return FileResponse(self._evaluations.picture(request.path_params["name"]))

    @_answering
    async def evaluation_report(self, request: Request) -> Response:
        report = self._evaluations.of(self._folder(request), request.path_params["name"]).report
        if not report.is_file():
            raise OperatorError(translatable("this evaluation has no report: 'fringedic report' writes it"))
        return FileResponse(report, headers={"Content-Security-Policy": REPORT_POLICY})

    @_answering
    async def export(self, request: Request) -> Response:
        asked = _parsed(Export, json.dumps({key: each for key, each in request.query_params.items() if each}).encode())
        packed = await run_in_threadpool(self._evaluations.export, self._folder(request), asked)
        name = f"{asked.evaluation or request.path_params['folder'].replace(' ', '_')}_{asked.format}.zip"
        return FileResponse(packed, filename=name, background=BackgroundTask(packed.unlink))

    def _folder(self, request: Request) -> Path:
        """Return the folder of the run that a request names."""
        folder = self._rig.folders().get(request.path_params["folder"])
        if folder is None:
            name = request.path_params["folder"][:60]
            raise OperatorError(Sentence("there is no test {test}: choose one of the list", test=name))
        return folder

    @_answering
    async def compose(self, request: Request) -> Response:
        composed = yaml.safe_dump(
            _parsed(Compose, await _body(request)).programme, sort_keys=False, allow_unicode=True, width=100
        )
        return JSONResponse({"text": composed})

    async def stream(self, socket: WebSocket) -> None:
        await socket.accept()
        client = Client(socket.state.session)
        self._hub.clients.add(client)
        self._wheel.connect(client.session, socket.client.host if socket.client else "")
        for topic, text in self._topics().items():
            client.put(topic, functools.partial(str, text))
        self._offer_wheel(client)
        self._published = {}  # this client may have another state than the one published last
        tasks = [asyncio.create_task(each) for each in (_until_closed(socket), _send(socket, client))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            self._hub.clients.discard(client)
            self._wheel.disconnect(client.session)

    async def _publish_changes(self) -> None:
        """Publish every part of the state, and the wheel, after each change, while somebody looks."""
        while True:
            await asyncio.sleep(STATE_PERIOD_S)
            if not self._hub.clients:
                continue  # a new one receives everything
            now = self._topics() | {"wheel": repr((self._wheel.driver, self._wheel.asking, self._wheel.present))}
            changed = {topic: text for topic, text in now.items() if self._published.get(topic) != text}
            self._published = now
            if changed.pop("wheel", None) is not None:
                self._offer_wheel(*self._hub.clients)
            for topic, text in changed.items():
                self._hub.publish(topic, functools.partial(str, text))

    def _offer_wheel(self, *clients: Client) -> None:
        for client in clients:
            client.put("wheel", functools.partial(self._wheel_message, client.session))

    def _wheel_message(self, session: str) -> str:
        return _message("wheel", self._wheel.seen_by(session))

    def _topics(self) -> dict[str, str]:
        """Return the message of each topic; only changed ones are made, as a comparison costs a tenth."""
        for topic, data in self._rig.snapshot().items():
            if topic not in self._texts or self._texts[topic][0] != data:
                self._texts[topic] = data, _message(topic, data)
        return {topic: text for topic, (_, text) in self._texts.items()}


def _message(topic: str, data: Any) -> str:
    return json.dumps({"topic": topic, "data": plain(data)})


async def _send(socket: WebSocket, client: Client) -> None:
    while True:
        message = await client.take()
        if isinstance(message, bytes):
            await socket.send_bytes(message)
        else:
            await socket.send_text(message)


def _palettes() -> dict[str, list[int]]:
    return {name: palette(name).ravel().tolist() for name in PALETTES}


async def _until_closed(socket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            await socket.receive()


def _said(text: str) -> dict[str, Any]:
    """Return an answer with a text, and a sentence also in its parts, which the page translates."""
    return {"message": text} | ({"sentence": plain(text)} if isinstance(text, Sentence) else {})


def plain(value: Any) -> Any:
    """Return nested values with None in place of numbers that JSON does not have, and sentences in their parts."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Sentence):
        return {"template": value.template, "values": plain(value.values)}
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    return value


async def _body(request: Request) -> bytes:
    """Return the body of a command.

    Raises
    ------
    OperatorError
        It is not JSON, as that of a form of another site, or too long.
    """
    if request.headers.get("content-type") != "application/json":
        raise OperatorError("a command has to be JSON")
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_BODY:
            raise OperatorError(Sentence("the text is longer than {size} kB: shorten it", size=LARGEST_BODY // 1000))
    return body


def _parsed(kind: type[CommandT], body: bytes) -> CommandT:
    try:
        return kind.model_validate_json(body)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "command"
        raise OperatorError(f"{where}: {first['msg'].removeprefix('Value error, ')}") from error


def _step_and_name(request: Request) -> tuple[int, str]:
    return request.path_params["step"], request.path_params["name"]


def _point(request: Request, key: str) -> Point:
    column, _, row = request.query_params.get(key, "").partition(",")
    return _finite(key, column), _finite(key, row)


def _finite(key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise OperatorError(f"{key} is '{text[:40]}': give a number")
    return value
