"""The subcommand that shows a recording in a browser."""

from __future__ import annotations

import ipaddress
import signal
import threading
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.command.app import RESULTS, OptionalBag, Sensor, app, refuse_unused, say
from fringedic.command.plugins import rig_procedure
from fringedic.errors import ConfigurationError

if TYPE_CHECKING:
    from fringedic.report.page_server.server import Address

LOCAL, PORT, FOXGLOVE_PORT = "127.0.0.1", 8090, 8765
LOOK_S = 0.5  # between two looks for Ctrl-C
Host = Annotated[str, typer.Option("--address", help="Address of this computer at which the page is served.")]
Certificate = Annotated[Path | None, typer.Option(help="TLS certificate (PEM).")]
Key = Annotated[Path | None, typer.Option(help="Private key of the certificate (PEM).")]


@app.command(rich_help_panel=RESULTS, epilog="Example: fringedic view recordings/plate-7/bag")
def view(
    context: typer.Context,
    bag: OptionalBag = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve Foxglove instead; without BAG the topics of running nodes.")
    ] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port; 8090, or 8765 for Foxglove, by default.")
    ] = None,
    sensor: Sensor = None,
    address: Host = LOCAL,
    certificate: Certificate = None,
    key: Key = None,
) -> None:
    """Show a recording in a browser: maps with their uncertainty, profiles, extensometers, curves, 3D. Without ROS."""
    if foxglove:
        if (address, certificate, key) != (LOCAL, None, None):
            raise ConfigurationError(f"--foxglove serves {LOCAL} only, because its connection is not encrypted")
        refuse_unused(context, {"sensor"}, "--foxglove shows the topics of all sensors; leave it out")
        view_with_foxglove(bag, port or FOXGLOVE_PORT)
    elif bag is None:
        raise ConfigurationError("no recording: give its folder, or --foxglove for the topics of running nodes")
    else:
        view_page(bag, page_address(address, port or PORT, certificate, key), sensor)


def view_page(bag: Path, place: Address, sensor: str | None = None) -> None:
    """Serve the page of a recording until Ctrl-C."""
    from fringedic.report.page_server.recorded import RecordedRig
    from fringedic.report.page_server.server import PageServer

    with suppress(KeyboardInterrupt):
        recorded = RecordedRig(bag, sensor)
        ended = ended_by_signals()
        server = PageServer(recorded, place)
        try:
            announce(place, "see the recording")
            while not ended.is_set():  # a signal that comes just before a wait is noticed at the end of the wait
                time.sleep(LOOK_S)
        finally:
            server.close()


def view_with_foxglove(bag: Path | None, port: int) -> None:
    """Serve Foxglove with a recording, or with the topics of running nodes, until Ctrl-C."""
    from fringedic.export.foxglove import RecordingPlayer

    source = rig_procedure("live_topics")(port) if bag is None else RecordingPlayer(bag, port)
    with suppress(KeyboardInterrupt), closing(source):
        say(f"foxglove: {source.server.url}", "Ctrl-C ends")
        while True:
            source.spin_once()


def ended_by_signals() -> threading.Event:
    """Return an event that Ctrl-C and SIGTERM set from now on; an exception amid a finalizer would be lost."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    return ended


def page_address(host: str, port: int, certificate: Path | None, key: Path | None) -> Address:
    """Return the address of a page with a new token.

    Raises
    ------
    ConfigurationError
        There is a certificate without its key or the reverse, or the address stands for several.
    """
    from fringedic.report.page_server.access import new_token
    from fringedic.report.page_server.server import Address

    if (certificate is None) != (key is None):
        raise ConfigurationError("TLS needs both --certificate and --key")
    with suppress(ValueError):
        if ipaddress.ip_address(host).is_unspecified:
            raise ConfigurationError(f"--address {host}: give one address of this computer, as browsers write it")
    return Address(host, port, new_token(), certificate, key)


def announce(place: Address, reach: str) -> None:
    """Print the address, and a warning about an address that others can reach."""
    say(f"page: {place.url}", "Ctrl-C ends")
    if not place.is_local:
        lines = "encrypted" if place.certificate is not None else "not encrypted: others can read the token"
        say(f"warning: everybody in the network who has this address can {reach}; the connection is {lines}")
