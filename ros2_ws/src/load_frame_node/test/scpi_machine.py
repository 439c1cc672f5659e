"""A testing machine with text commands, as a process: a TCP socket before the simulated load frame.

TRIP stops it with a fault until RESET; it follows commands nevertheless, as some machines do. LOG? lists the commands.
"""

from __future__ import annotations

import asyncio
import sys

from fringedic.virtual_rig import SimulatedLoadFrame, VirtualRigConfiguration
from load_frame_node.machines import LoadMode, SimulatedMachine

WORDS = {LoadMode.IDLE: "IDLE", LoadMode.MOVING: "RUN", LoadMode.HOLD: "HOLD"}


class Conversation:
    def __init__(self) -> None:
        configuration = VirtualRigConfiguration.from_dict({"preset": "plate"})
        self.machine = SimulatedMachine(SimulatedLoadFrame(configuration.load_frame, seed=1))
        self.speed = 1.0  # [mm/min]
        self.manner = "SPEAK"
        self.is_tripped = False
        self.replies: dict[str, str] = {}  # in place of the measured ones
        self.log: list[str] = []

    def answer(self, line: str) -> str | None:
        sample = self.machine.sample()
        command, _, value = line.partition(" ")
        self.operate(command, value)
        if command in self.replies:
            return self.replies[command]
        match command:
            case "MEAS:FORC?":
                return "?#!" if self.manner == "BABBLE" else f"{1e-3 * sample.force:.6f}"  # [kN]
            case "MEAS:POS?":
                return f"{1e6 * sample.position:.3f}"  # [um]
            case "STAT?":
                return "TRIP" if self.is_tripped else WORDS[sample.mode]
            case "SPEED":
                self.speed = float(value)
            case "GOTO":
                self.machine.move_to(1e-3 * float(value), 1e-3 / 60 * self.speed)
            case "STOP":
                self.machine.hold()
            case "SILENT" | "BABBLE" | "ACKNOWLEDGE" | "SPEAK":
                self.manner = command
        return "0" if self.manner == "ACKNOWLEDGE" else None

    def operate(self, command: str, value: str) -> None:
        """Do what the tests request, and keep the commands."""
        match command:
            case "GOTO" | "STOP":
                self.log.append(f"{command} {value}".strip())
            case "LOG?":
                self.replies["LOG?"] = ",".join(self.log)
            case "TRIP" | "RESET":
                self.is_tripped = command == "TRIP"
                self.machine.hold()
            case "REPLY":
                query, _, reply = value.partition(" ")
                self.replies[query] = reply
            case "MEASURE":
                self.replies.clear()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            answer = self.answer(line.decode().strip())
            if self.manner == "ACKNOWLEDGE":
                await asyncio.sleep(0.003)  # longer than the machine is waited for after a sample
            if answer is not None and self.manner != "SILENT":
                writer.write(f"{answer}\n".encode())
                await writer.drain()
        writer.close()


async def main(port: int) -> None:
    server = await asyncio.start_server(Conversation().serve, "127.0.0.1", port)
    sys.stdout.write(f"{server.sockets[0].getsockname()[1]}\n")
    sys.stdout.flush()
    await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
