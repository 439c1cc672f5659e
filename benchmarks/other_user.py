"""What a second user of the computer can reach of each command: its ports, shared memory, ROS topics and machine.

Root starts each command, and becomes the user `nobody` for the attempts. A program with the usual settings of ROS 2,
and one that avoids shared memory, try to read samples and images and to move the machine.

    sudo python benchmarks/other_user.py [COMMAND ...] [RECORDING]

RECORDING is replayed; the default one ends before the attempts do.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
from ament_index_python.packages import get_package_share_directory
from rich.console import Console
from rich.table import Table

from fringedic_ros.middleware.fast_dds import name_of_version

ROOT = Path(__file__).parents[1]
RECORDING = ROOT / "ros2_ws/src/fringedic/test/recordings/version_0_1/bag"
AS_NOBODY = ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups", sys.executable, "-c"]
PROGRAMME = "{experiment: watched, ramp: {to_mm: 0.6, steps: 200, speed_mm_per_s: 5}}"
ATTEMPT_S = 45.0  # a busy computer takes half of it for the discovery
UDP_ONLY = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor><transport_id>network</transport_id><type>UDPv4</type></transport_descriptor>
  </transport_descriptors>
  <participant profile_name="intruder" is_default_profile="true"><rtps>
    <userTransports><transport_id>network</transport_id></userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
  </rtps></participant>
</profiles>
"""
PORTS = """
import http.client, json, os, sys
from pathlib import Path
from websockets.sync.client import connect
answers = {}
for port in map(int, sys.argv[1:]):
    page = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        page.request("GET", "/")
        answers[port] = f"HTTP {page.getresponse().status}"
    except Exception as error:
        answers[port] = type(error).__name__
    for origin in (None, "http://evil.example"):
        try:
            with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], origin=origin, open_timeout=5):
                answers[port] += ", WebSocket open"
        except Exception as error:
            status = getattr(getattr(error, "response", None), "status_code", type(error).__name__)
            answers[port] += f", WebSocket {status}"
readable = 0
memory = list(Path("/dev/shm").glob("fast*_*"))
memory = [path for path in memory if not path.name.endswith(("_el", "_sl")) and path.stat().st_uid != os.getuid()]
for path in memory:
    try:
        os.close(os.open(path, os.O_RDONLY))
        readable += 1
    except PermissionError:
        pass
print(json.dumps({"ports": answers, "memory": f"{readable} of {len(memory)} readable"}))
"""
TOPICS = """
import json, os, sys, time
import rclpy
from rclpy.action import ActionClient
from fringedic_msgs.action import MoveCrosshead
from fringedic_msgs.msg import LoadState
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("intruder", namespace=sys.argv[1])
samples, images, end = [], [], time.monotonic() + float(sys.argv[2])
node.create_subscription(LoadState, "load_frame/state", samples.append, 10)
node.create_subscription(Image, "camera/image_raw", images.append, 10)
move = ActionClient(node, MoveCrosshead, "move_crosshead")
goal = ended = None
while time.monotonic() < end and not (ended and ended.done()):
    rclpy.spin_once(node, timeout_sec=0.1)
    if goal is None and move.server_is_ready():
        goal = move.send_goal_async(MoveCrosshead.Goal(position=2e-4, speed=1e-3))
    if goal and goal.done() and ended is None:
        ended = goal.result().get_result_async()
names = [name for name, _ in node.get_topic_names_and_types() if name.startswith(sys.argv[1] + "/")]
said = "no answer" if goal else "no server"
if ended and ended.done():
    said = ended.result().result.error_message or "MOVED"
print(json.dumps({"names": len(names), "samples": len(samples), "images": len(images), "move": said}), flush=True)
os._exit(0)
"""


def as_nobody(program: str, *words: str, **environment: str) -> dict[str, Any]:
    """Result of a program of the second user."""
    home = tempfile.mkdtemp()
    os.chown(home, 65534, 65534)
    variables = {**os.environ, "HOME": home, "ROS_LOG_DIR": home, "PYTHONWARNINGS": "ignore", **environment}
    done = subprocess.run([*AS_NOBODY, program, *words], capture_output=True, text=True, env=variables, check=False)
    lines = done.stdout.splitlines()
    return json.loads(lines[-1]) if lines else {"error": done.stderr[-300:]}


def opened_by(process: psutil.Process) -> tuple[set[int], set[int]]:
    """TCP ports that a command and its processes listen on, and UDP ports."""
    tcp, udp = set(), set()
    for each in (process, *process.children(recursive=True)):
        with suppress(psutil.Error):
            for connection in each.net_connections("inet"):
                if connection.status == psutil.CONN_LISTEN:
                    tcp.add(connection.laddr.port)
                elif connection.status == psutil.CONN_NONE and connection.laddr:
                    udp.add(connection.laddr.port)
    return tcp, udp


def attempts(process: psutil.Process, namespace: str, folder: Path) -> dict[str, Any]:
    """What the second user reaches of a running command."""
    tcp, udp = opened_by(process)
    found = {"TCP": sorted(tcp), "UDP": len(udp), **as_nobody(PORTS, *map(str, sorted(tcp)))}
    if udp:
        profile = folder / "udp.xml"
        profile.write_text(UDP_ONLY)
        found["usual"] = as_nobody(TOPICS, namespace, str(ATTEMPT_S))
        found["UDP only"] = as_nobody(
            TOPICS,
            namespace,
            str(ATTEMPT_S),
            **{f"{name_of_version(os.environ).upper()}_DEFAULT_PROFILES_FILE": str(profile)},
            ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET",
        )
    return found


def is_ready(title: str, process: psutil.Process) -> bool:
    """Whether a command has the ports or the processes that belong to it."""
    tcp, udp = opened_by(process)
    if title == "campaign run --workers 2":
        return len(process.children()) > 2  # one of them cares for the memory of the others
    if title.startswith("view"):
        return bool(tcp)
    nodes = [each for each in process.children(recursive=True) if "load_frame" in " ".join(each.cmdline())]
    return bool(udp) if title == "replay" else bool(nodes and opened_by(nodes[0])[1]) and (title == "run" or bool(tcp))


def main() -> None:
    """Start each command and print what the second user reaches."""
    recordings = [str(Path(each).resolve()) for each in sys.argv[1:] if "/" in each][:1]
    table = Table("command", "TCP", "UDP", "attempts on ports", "shared memory", "ROS, usual settings", "ROS, UDP only")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        rig, programme = folder / "tiny.yaml", folder / "programme.yaml"
        shutil.copyfile(Path(get_package_share_directory("fringedic_bringup")) / "config" / "tiny.yaml", rig)
        programme.write_text(PROGRAMME)
        (folder / "campaign").mkdir()
        (folder / "campaign/campaign.yaml").write_text(f"recordings: [{{path: '{folder}/many/*'}}]")
        for number in range(30):
            shutil.copytree(RECORDING, folder / "many" / str(number))
        subprocess.run(["fringedic", "process", str(folder / "many/0")], check=True, stdout=subprocess.DEVNULL)
        commands = {
            "run": ["run", str(rig), "--programme", str(programme)],
            "operate": ["operate", str(rig), "--port", "8123"],
            "view": ["view", str(folder / "many/0"), "--port", "8124"],
            "view --foxglove": ["view", str(RECORDING), "--foxglove", "--port", "8125"],
            "campaign run --workers 2": ["campaign", "run", str(folder / "campaign"), "--workers", "2"],
            "replay": ["replay", *(recordings or [str(folder / "many/1")]), "--output", str(folder / "again")],
        }
        chosen = [each for each in sys.argv[1:] if each in commands] or list(commands)
        for title in chosen:
            with subprocess.Popen(
                ["fringedic", *commands[title]], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            ) as process:
                command = psutil.Process(process.pid)
                while process.poll() is None and not is_ready(title, command):
                    time.sleep(0.2)
                found = attempts(command, "/rig", folder) if process.poll() is None else {}
                print(title, json.dumps(found), f"still runs: {process.poll() is None}", flush=True)
                process.send_signal(signal.SIGTERM)
                process.wait(300)
            table.add_row(
                title, *(str(found.get(key, "")) for key in ("TCP", "UDP", "ports", "memory", "usual", "UDP only"))
            )
    Console(width=220).print(table)


if __name__ == "__main__":
    main()
