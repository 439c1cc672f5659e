"""The door of the page: host, origin and session of every request, and the headers of every answer."""

from __future__ import annotations

from collections.abc import Collection

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fringedic.report.page_server.access import Sessions
from fringedic.wording.translation import translatable

EXPIRED = translatable(
    "This page belongs to another start of the program: open the address that fringedic has printed."
)
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
REPORT_POLICY = "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
REPORT_POLICY += "img-src data:; font-src data:"


class Guard:
    """Refuses requests of other sites, of names that are not this server's, and without a session.

    Parameters
    ----------
    app
        The application behind the door.
    sessions
        Knows the cookies.
    hosts
        Names with port by which this server may be addressed, against DNS rebinding.
    cookie
        Name of the cookie.
    secure
        Whether the server uses TLS.
    """

    def __init__(self, app: ASGIApp, sessions: Sessions, hosts: Collection[str], cookie: str, secure: bool) -> None:
        self._app, self._sessions, self._hosts = app, sessions, frozenset(hosts)
        self._cookie, self._secure = cookie, secure

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is None:
            await self._app(scope, receive, send if scope["type"] == "websocket" else _with_headers(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})  # before it is accepted: status 403
        else:
            await refusal(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> Response | None:
        """Return the answer to a request that may not pass; keep the session of one that may."""
        headers = Headers(scope=scope)
        if headers.get("host", "") not in self._hosts:
            return PlainTextResponse("This name is not the server's: open the address that it has printed.", 403)
        origin = headers.get("origin")
        if scope["type"] == "http" and scope["method"] in ("GET", "HEAD") and origin is None:
            own_origin = True
        else:
            own_origin = origin == f"{'https' if self._secure else 'http'}://{headers.get('host')}"
        if not own_origin:
            return PlainTextResponse("Requests of other sites are refused.", 403)
        session = self._sessions.name_of(HTTPConnection(scope).cookies.get(self._cookie, ""))
        if scope["type"] == "http" and scope["path"] == "/" and "token" in (query := Request(scope).query_params):
            token = query["token"]
            cookie = self._sessions.admit(token)
            if cookie is None:
                return PlainTextResponse("The address has a wrong token: copy it completely from the terminal.", 403)
            response = RedirectResponse("/", 303)  # removes the token from the address bar
            if session is None:
                response.set_cookie(self._cookie, cookie, httponly=True, samesite="strict", secure=self._secure)
            return response
        if session is None:
            return PlainTextResponse(EXPIRED, 403)
        scope.setdefault("state", {})["session"] = session
        return None


def _with_headers(send: Send) -> Send:
    """Return a function that adds the headers to every answer that does not have its own."""

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return send_with_headers
