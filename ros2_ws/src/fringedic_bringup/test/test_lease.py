"""One owner of a rig on a computer, whoever starts the second one and wherever."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from fringedic.errors import ProcessError
from fringedic_bringup.launch.lease import RigLease

DOMAIN = 77
OWNER = """
import os, sys, time
from pathlib import Path
from fringedic_bringup.launch.lease import RigLease
{first}
with RigLease({domain}, sys.argv[1], Path("/tests/plate")):
    print("has the rig", flush=True)
    time.sleep(60)
"""


class Owner:
    """Another process that has a rig."""

    def __init__(self, namespace: str, *, first: str = "", environment: Mapping[str, str] | None = None) -> None:
        command = [sys.executable, "-c", OWNER.format(first=first, domain=DOMAIN), namespace]
        variables = {**os.environ, **(environment or {})}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=variables)

    def __enter__(self) -> subprocess.Popen[str]:
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "has the rig\n"
        return self.process

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.mark.parametrize("first", ["", "os.getuid = os.geteuid = lambda: 1001"], ids=["folder", "user"])
def test_a_rig_has_one_owner_of_all_users_and_folders(first: str, tmp_path: Path) -> None:
    namespace = f"rig_{os.getpid()}"
    lease = RigLease(DOMAIN, namespace, tmp_path)
    with Owner(namespace, first=first, environment={"TMPDIR": str(tmp_path)}) as owner:
        for _ in range(2):
            with pytest.raises(ProcessError) as refused, lease:
                pass
            words = rf"rig '{namespace}' in ROS domain {DOMAIN} is in use by process {owner.pid} \(-c {namespace}\) "
            assert re.match(rf"{words}since 20.*, folder /tests/plate; wait until it has ended", str(refused.value))
        with RigLease(DOMAIN, f"{namespace}_b", tmp_path), RigLease(DOMAIN + 1, namespace, tmp_path):
            pass
    for _ in range(2):
        with lease:
            pass


def test_an_owner_that_stands_still_keeps_its_rig(tmp_path: Path) -> None:
    namespace = f"rig_{os.getpid()}"
    with Owner(namespace) as owner:
        owner.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, owner.pid, os.WSTOPPED)  # all of its threads stand still
        with pytest.raises(ProcessError, match="another process"), RigLease(DOMAIN, namespace, tmp_path):
            pass


def test_a_namespace_may_be_long(tmp_path: Path) -> None:
    with RigLease(DOMAIN, "left/" * 40, tmp_path), RigLease(DOMAIN, "right/" * 40, tmp_path):
        pass
