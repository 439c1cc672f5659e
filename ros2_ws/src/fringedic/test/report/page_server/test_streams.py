"""One slot per client and topic."""

from __future__ import annotations

import asyncio

from fringedic.report.page_server.streams import Client, Hub, Payload


def test_newest_message_replaces_one_that_was_not_taken() -> None:
    async def received() -> list[Payload]:
        hub, slow = Hub(), Client("slow")
        hub.clients.add(slow)
        for number in range(5):
            hub.publish("image", lambda number=number: f"image {number}")  # type: ignore[misc]
            hub.publish("state", lambda number=number: f"state {number}")  # type: ignore[misc]
        return [await slow.take(), await slow.take()]

    assert asyncio.run(received()) == ["image 4", "state 4"]


def test_message_is_made_once_for_all_clients_and_never_without_one() -> None:
    made = []

    def make() -> str:
        made.append(1)
        return "image"

    async def received() -> list[Payload]:
        hub, clients = Hub(), [Client("a"), Client("b")]
        hub.publish("image", make)
        assert not made
        hub.clients.update(clients)
        hub.publish("image", make)
        return [await client.take() for client in clients]

    assert asyncio.run(received()) == ["image", "image"]
    assert len(made) == 1


def test_a_fast_topic_does_not_starve_another() -> None:
    async def received() -> Payload:
        client = Client("a")
        client.put("image", lambda: "image 0")
        client.put("state", lambda: "state")
        client.put("image", lambda: "image 1")
        return await client.take()

    assert asyncio.run(received()) == "state"


def test_waiting_client_receives_what_comes() -> None:
    async def received() -> Payload:
        client = Client("a")
        waiting = asyncio.create_task(client.take())
        await asyncio.sleep(0)
        client.put("state", lambda: "state")
        return await asyncio.wait_for(waiting, 5)

    assert asyncio.run(received()) == "state"


def test_an_empty_message_is_left_out() -> None:
    async def received() -> Payload:
        client = Client("a")
        client.put("image", lambda: b"")
        client.put("state", lambda: "state")
        return await client.take()

    assert asyncio.run(received()) == "state"
