"""Two network namespaces with a pair of virtual cards, as two computers at a switch of their own; needs root."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from fringedic_bringup.launch.processes import GRACE_S

NETWORK = "10.77.0"
# As docs/two_computers.md: of an image whose packets are partly lost, the fragments fill 4 MB for 30 s by default.
REASSEMBLY = {"ipfrag_time": 1, "ipfrag_high_thresh": 2**27}
SCRIPT = Path(__file__).parent / "rig_side.py"


@dataclass(frozen=True)
class Host:
    """A network namespace with one card and shared memory of its own, and no default route."""

    name: str
    card: str
    address: str

    def command(self, *words: str) -> list[str]:
        """Return the command that runs another one on this host."""
        own_memory = 'mount -t tmpfs -o size=512m tmpfs /dev/shm && exec "$@"'
        return ["ip", "netns", "exec", self.name, "unshare", "--mount", "sh", "-c", own_memory, "sh", *words]

    def plug(self, state: str) -> None:
        """Connect (``up``) or disconnect (``down``) the card."""
        _run("ip", "-n", self.name, "link", "set", self.card, state)

    def lose(self, share: float) -> None:
        """Lose a share of the packets that arrive, each IP fragment by itself and at random; 0: none."""
        _run("tc", "-n", self.name, "qdisc", "replace", "dev", self.card, "clsact")
        _run("tc", "-n", self.name, "filter", "delete", "dev", self.card, "ingress")
        if share:
            _run("tc", "-n", self.name, "filter", "add", "dev", self.card, "ingress", *_dropping(share))

    def lost(self) -> int:
        """Return how many packets were lost since the first call of `lose`."""
        shown = subprocess.run(
            ["tc", "-n", self.name, "-s", "-j", "qdisc", "show", "dev", self.card], capture_output=True, check=True
        )
        return sum(each["drops"] for each in json.loads(shown.stdout) if each["kind"] == "clsact")


def _dropping(share: float) -> list[str]:
    """Return the classic BPF filter that drops a share of the packets; many kernels have no netem.

    The accumulator gets a random number of 32 bits (the extension at SKF_AD_OFF + SKF_AD_RANDOM of linux/filter.h);
    below the limit the filter returns TC_ACT_SHOT, else TC_ACT_UNSPEC.
    """
    random_number, limit = 2**32 - 0x1000 + 56, min(round(share * 2**32), 2**32 - 1)
    load, jump_if_at_least, drop, go_on = f"32 0 0 {random_number}", f"53 1 0 {limit}", "6 0 0 2", f"6 0 0 {2**32 - 1}"
    return ["bpf", "direct-action", "bytecode", f"4,{load},{jump_if_at_least},{drop},{go_on}"]


def why_not() -> str:
    """Return why two hosts cannot be made here; empty when they can."""
    if os.geteuid():
        return "two network namespaces need root"
    missing = [tool for tool in ("ip", "tc", "unshare", "mount") if shutil.which(tool) is None]
    if missing:
        return f"two network namespaces need {', '.join(missing)}"
    made = subprocess.run(["ip", "netns", "add", "fringedic-probe"], capture_output=True, text=True)
    subprocess.run(["ip", "netns", "del", "fringedic-probe"], capture_output=True)
    return made.stderr.strip()


@contextmanager
def two_hosts() -> Iterator[tuple[Host, Host]]:
    """Make two connected hosts, and remove them at the end."""
    tag = f"fd{os.getpid()}"
    hosts = (Host(f"{tag}a", f"{tag}c", f"{NETWORK}.1"), Host(f"{tag}b", f"{tag}d", f"{NETWORK}.2"))
    try:
        for host in hosts:
            _run("ip", "netns", "add", host.name)
            _run("ip", "-n", host.name, "link", "set", "lo", "up")
        first, second = hosts
        ends = "type", "veth", "peer", "name", second.card, "netns", second.name
        _run("ip", "link", "add", first.card, "netns", first.name, *ends)
        for host in hosts:
            _run("ip", "-n", host.name, "address", "add", f"{host.address}/24", "dev", host.card)
            host.plug("up")
            for name, value in REASSEMBLY.items():
                _run("ip", "netns", "exec", host.name, "sh", "-c", f"echo {value} > /proc/sys/net/ipv4/{name}")
        yield hosts
    finally:
        for host in hosts:
            subprocess.run(["ip", "netns", "del", host.name], capture_output=True)


class Side:
    """The nodes of a rig on one host, and on one of them a client of the rig.

    Parameters
    ----------
    host
        Where they run.
    rig, folder
        Rig file; folder of the recording, the logs and temporary files of this host.
    names
        The nodes.
    domain
        ROS_DOMAIN_ID.
    """

    def __init__(self, host: Host, rig: Path, folder: Path, names: tuple[str, ...], domain: str) -> None:
        self.host = host
        folder.mkdir()
        environment = {name: value for name, value in os.environ.items() if name != "FRINGEDIC_ADDRESS"}
        # each computer has temporary files of its own
        environment |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": domain, "TMPDIR": str(folder)}
        command = host.command(sys.executable, str(SCRIPT), str(rig), str(folder), *names)
        with (folder / "side.txt").open("w") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, env=environment
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(2 * sum(GRACE_S.values()))
        self._process.stdout.close()

    def ask(self, *words: object) -> Any:
        """Send a command to the client and return its answer."""
        self.tell(*words)
        return self.answer()

    def tell(self, *words: object) -> None:
        """Send a command to the client."""
        assert self._process.stdin is not None
        self._process.stdin.write(" ".join(map(str, words)) + "\n")
        self._process.stdin.flush()

    def answer(self) -> Any:
        """Return the next answer of the client."""
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())

    def crash(self) -> None:
        """End all processes of the host at once, after its card went dead."""
        self.host.plug("down")
        listed = subprocess.run(["ip", "netns", "pids", self.host.name], capture_output=True, text=True, check=True)
        for pid in listed.stdout.split():
            with suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True)
