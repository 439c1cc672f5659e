"""The address of this computer in the network of a rig."""

from __future__ import annotations

import socket

import pytest

from fringedic.errors import ProcessError
from fringedic_ros.middleware.address import interface_addresses, only_address, own_address, routed_address


def test_alone_it_is_the_loopback() -> None:
    assert own_address("LOCALHOST") == "127.0.0.1"


def test_the_only_card_is_chosen() -> None:
    assert only_address({"eth1": "10.0.0.2"}) == "10.0.0.2"


def test_several_cards_are_named() -> None:
    with pytest.raises(ProcessError, match=r"one of 192\.168\.1\.7 \(eth0\), 10\.0\.0\.2 \(eth1\)"):
        only_address({"eth1": "10.0.0.2", "eth0": "192.168.1.7"})


def test_without_a_card_the_message_says_what_to_do() -> None:
    with pytest.raises(ProcessError, match="LOCALHOST"):
        only_address({})


def test_addresses_can_be_listened_at() -> None:
    for address in interface_addresses().values():
        assert not address.startswith("127.")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
            listening.bind((address, 0))


def test_the_default_route_decides() -> None:
    if not routed_address():
        pytest.skip("this computer has no default route")
    assert own_address("SUBNET") == routed_address()
