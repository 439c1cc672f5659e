"""Runs the procedures of an operator's page, and keeps the page served."""

from __future__ import annotations

import socket
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path

from fringedic.configuration.known_rigs import remember_rig
from fringedic.errors import WaitTimeoutError
from fringedic.report.page_server.server import Address, listen
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.operating.procedures import Place
from fringedic_bringup.operating.server import ProcedureServer

TOKEN = "FRINGEDIC_OPERATOR_TOKEN"  # the environment of another user's process cannot be read
START_S = 60.0
MOST_DEATHS = 5  # of the page within `DEATHS_SPAN_S`; after more, another start helps later at best
DEATHS_SPAN_S = 60.0


def operate(
    place: Place, address: Address, *, attach: bool, ready: Callable[[], None], stop: Callable[[], bool]
) -> None:
    """Serve the page of a rig, and run its procedures, until `stop` returns true.

    Parameters
    ----------
    place
        The rig.
    address
        Where the page is served.
    attach
        Join a rig that runs already: only its page is started.
    ready
        Called when the page is served.
    stop
        Called some times a second.

    Raises
    ------
    OperatorError
        The port is in use.
    ProcessError
        The page ends again and again.
    """
    listen(address.host, address.port).close()  # a sentence about a port in use, before nodes are started
    rig = place.rig
    with tempfile.TemporaryDirectory(prefix="fringedic-operate-") as folder:
        parameters = {
            "rig_file": str(place.rig_path.absolute()),
            "address": address.host,
            "port": address.port,
            "certificate": "" if address.certificate is None else str(address.certificate.absolute()),
            "key": "" if address.key is None else str(address.key.absolute()),
            "maps_folder": str(Path(folder) / "maps"),
        }
        graph = Graph(rig.topic_namespace, (NodeEntry("operator", "operator_node", "operator", parameters),))
        # for a preview, waking other threads costs more than they do
        environment = {TOKEN: address.token, "OPENCV_FOR_THREADS_NUM": "1"}
        page = RunningGraph(graph, Path(folder), domain=place.domain, environment=environment, owner=False)
        server = nullcontext() if attach else ProcedureServer(place)
        with page, server as procedures:
            work = (lambda: time.sleep(0.2)) if procedures is None else procedures.spin_once
            _await_page(page, address, work)
            remember_rig(place.rig_path)
            ready()
            deaths: list[float] = []
            while not stop():
                work()
                deaths = [each for each in deaths if time.monotonic() - each < DEATHS_SPAN_S]
                if not page.dead():
                    continue
                if len(deaths) < MOST_DEATHS:
                    deaths.append(time.monotonic())
                    with suppress(OSError):  # no memory or disk space for it now
                        page.restart("operator")
                elif procedures is None or not procedures.is_measuring:  # a page that is gone must not end a test
                    page.check()


def _await_page(page: RunningGraph, address: Address, work: Callable[[], None]) -> None:
    end = time.monotonic() + START_S
    while not _is_served(address):
        if time.monotonic() > end:
            raise WaitTimeoutError(f"the page is not served after {START_S:g} s; see {page.log('operator')}")
        page.check()
        work()


def _is_served(address: Address) -> bool:
    with suppress(OSError), socket.create_connection((address.host, address.port), timeout=0.5):
        return True
    return False
