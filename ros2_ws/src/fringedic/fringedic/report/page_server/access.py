"""Who may open the page, and who drives: sessions of browsers, and the one session that may give commands."""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fringedic.errors import OperatorError
from fringedic.wording.translation import Sentence

ABSENT_S = 10.0  # without a connection, after which a driver has left


def new_token() -> str:
    """Return a random token for the address of a page."""
    return secrets.token_urlsafe(24)


class Sessions:
    """Cookies in exchange for the token of the printed address.

    A cookie contains a random name and its signature with the token, so that it is also valid for a server that was
    started again with the same token, and for no other.

    Parameters
    ----------
    token
        The secret part of the printed address.

    Examples
    --------
    >>> sessions = Sessions("secret")
    >>> cookie = sessions.admit("secret")
    >>> sessions.name_of(cookie) == cookie.partition(".")[0]
    True
    >>> Sessions("another").name_of(cookie) is None
    True
    """

    def __init__(self, token: str) -> None:
        self._key = token.encode()

    def admit(self, token: str) -> str | None:
        """Return a new cookie for the right token; None for another one."""
        if not hmac.compare_digest(token.encode(), self._key):
            return None
        name = secrets.token_hex(8)
        return f"{name}.{self._signature(name)}"

    def name_of(self, cookie: str) -> str | None:
        """Return the name of the session of a cookie; None when this server's token has not signed it."""
        name, _, signature = cookie.partition(".")
        return name if hmac.compare_digest(signature.encode(), self._signature(name).encode()) else None

    def _signature(self, name: str) -> str:
        return hmac.new(self._key, name.encode(), "sha256").hexdigest()


@dataclass
class Seat:
    """A session with a connection: number for people, address, open connections, and when the last one ended."""

    number: int
    address: str
    connections: int = 0
    left: float = 0.0

    @property
    def words(self) -> str:
        """Return the name for people."""
        return Sentence("browser {number} ({address})", number=self.number, address=self.address)


@dataclass
class Wheel:
    """The one session that drives; the first one that connects, until it hands over or leaves.

    Attributes
    ----------
    seats
        Sessions that have connected so far.
    driver
        Session that drives; empty when nobody does.
    asking
        Session that asks for the wheel; empty when none does.
    clock
        Returns the time [s].
    """

    seats: dict[str, Seat] = field(default_factory=dict)
    driver: str = ""
    asking: str = ""
    clock: Callable[[], float] = time.monotonic

    def connect(self, session: str, address: str) -> None:
        """Count a connection; the session drives when nobody else does."""
        seat = self.seats.setdefault(session, Seat(len(self.seats) + 1, address))
        seat.connections += 1
        if not self.present:
            self.driver, self.asking = session, ""

    def disconnect(self, session: str) -> None:
        """Count the end of a connection."""
        seat = self.seats[session]
        seat.connections -= 1
        seat.left = self.clock()

    @property
    def present(self) -> bool:
        """Whether the driver's page is open, or was a moment ago."""
        seat = self.seats.get(self.driver)
        return seat is not None and (seat.connections > 0 or self.clock() - seat.left < ABSENT_S)

    def require(self, session: str) -> None:
        """Check that a session drives.

        Raises
        ------
        OperatorError
            Another session drives, or none.
        """
        if session != self.driver:
            seat = self.seats.get(self.driver)
            if seat is None:
                raise OperatorError(Sentence("Nobody drives: ask for the wheel first."))
            raise OperatorError(Sentence("{browser} drives: ask for the wheel first.", browser=seat.words))

    def ask(self, session: str) -> None:
        """Take the wheel when nobody holds it, and ask the driver for it otherwise."""
        if self.present and session != self.driver:
            self.asking = session
        else:
            self.driver, self.asking = session, ""

    def give(self, session: str) -> None:
        """Hand the wheel over to the session that asks for it; without one nobody drives.

        Raises
        ------
        OperatorError
            The session does not drive.
        """
        self.require(session)
        self.driver, self.asking = self.asking, ""

    def seen_by(self, session: str) -> dict[str, object]:
        """Return what the page of a session shows about the wheel."""
        driver, asking = self.seats.get(self.driver), self.seats.get(self.asking)
        return {
            "drives": session == self.driver,
            "driver": None if driver is None else driver.words,
            "driver_present": self.present,
            "asking": None if asking is None else asking.words,
            "asked": session == self.asking,
        }
