"""The address at which the nodes of this computer listen."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from contextlib import suppress

import psutil

from fringedic.errors import ProcessError

LOOPBACK = "127.0.0.1"


def own_address(discovery_range: str) -> str:
    """Return the address at which nodes listen: this computer alone, or its address in the network of the rig.

    That is the address of the default route, or the only one where there is no such route, as at a switch of its own.

    Parameters
    ----------
    discovery_range
        ROS_AUTOMATIC_DISCOVERY_RANGE.

    Raises
    ------
    ProcessError
        There is no default route, and none or several addresses to choose from.
    """
    if discovery_range in ("LOCALHOST", "OFF"):
        return LOOPBACK
    return routed_address() or only_address(interface_addresses())


def routed_address() -> str:
    """Return the address from which this computer reaches others; empty without a default route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as towards, suppress(OSError):
        towards.connect(("192.0.2.1", 9))  # an address for documentation; connecting a datagram socket sends nothing
        return str(towards.getsockname()[0])
    return ""


def interface_addresses() -> dict[str, str]:
    """Return the IPv4 address of each network card that is up, without the loopback, by the name of the card."""
    up = {name for name, state in psutil.net_if_stats().items() if state.isup}
    return {
        name: each.address
        for name, addresses in psutil.net_if_addrs().items()
        for each in addresses
        if each.family == socket.AF_INET and name in up and not each.address.startswith("127.")
    }


def only_address(addresses: Mapping[str, str]) -> str:
    """Return the address of the only network card.

    Parameters
    ----------
    addresses
        Address by the name of the card.

    Raises
    ------
    ProcessError
        There is none, or more than one; the message names them.
    """
    if len(addresses) == 1:
        return next(iter(addresses.values()))
    listed = ", ".join(f"{address} ({name})" for name, address in sorted(addresses.items()))
    if addresses:
        raise ProcessError(
            f"this computer has several addresses and no default route: set FRINGEDIC_ADDRESS to one of {listed}"
        )
    raise ProcessError(
        "this computer has no network address: connect it, give its card an address, or set "
        "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
    )
