"""What set-up says when the machine lacks something: one sentence that names the remedy, and an exit code."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import distribution, version
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

import pytest

ROOT = Path(__file__).parent.parent
PYTHON = os.path.realpath(sys.executable)
TOOLS = (
    *("awk", "basename", "bash", "cat", "chmod", "cut", "df", "dirname", "env", "find", "flock", "mkdir"),
    *("printf", "rm", "sha256sum", "sort", "tail", "uname", "wc", "xargs"),
)


class Machine:
    """A checkout on a computer whose PATH holds only what a test puts there."""

    def __init__(self, folder: Path) -> None:
        self.checkout = folder / "checkout"
        shutil.copytree(ROOT / "setup", self.checkout / "setup")
        self.bin = folder / "bin"
        self.bin.mkdir()
        self.environment = {"PATH": str(self.bin), "HOME": str(folder), "LC_ALL": "C", "PIP_CONFIG_FILE": os.devnull}
        for tool in [*TOOLS, "gcc", "g++"]:
            found = shutil.which(tool)
            assert found, f"{tool} is needed to run this test"
            (self.bin / tool).symlink_to(found)
        (self.bin / "python3").symlink_to(PYTHON)

    def replace(self, tool: str, script: str) -> None:
        """Put a shell script in the place of a tool."""
        (self.bin / tool).unlink()
        (self.bin / tool).write_text(f"#!{shutil.which('bash')}\n{script}\n")
        (self.bin / tool).chmod(0o755)

    def customise_python(self, statements: str) -> None:
        """Let Python execute these statements whenever it starts."""
        folder = self.bin.parent / "customisation"
        folder.mkdir()
        (folder / "sitecustomize.py").write_text(statements)
        self.environment["PYTHONPATH"] = str(folder)

    def complaint(self) -> str:
        """Run set-up, which must fail, and return the one sentence it ends with."""
        script = str(self.checkout / "setup" / "setup.sh")
        done = subprocess.run([script], env=self.environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 1, done.stdout + done.stderr
        [sentence] = done.stderr.splitlines()
        assert sentence.startswith("set-up: ")
        return sentence


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize("compiler", ["gcc", "g++"])
def test_missing_compiler(machine: Machine, compiler: str) -> None:
    (machine.bin / compiler).unlink()
    assert (
        f"the compiler {compiler} is missing: install it (Debian, Ubuntu: sudo apt install g++)" in machine.complaint()
    )


def test_old_python(machine: Machine) -> None:
    machine.replace("python3", 'if [ "$1" = --version ]; then echo Python 3.9.2; else exit 1; fi')
    sentence = machine.complaint()
    assert "Python 3.11, 3.12, 3.13 or 3.14 is needed and Python 3.9.2 was found: install one" in sentence


def test_no_python(machine: Machine) -> None:
    (machine.bin / "python3").unlink()
    assert "is needed and no Python was found: install one" in machine.complaint()


@pytest.mark.parametrize("place", ["bin/python3.12", "checkout/.venv/bin/python3"])
def test_another_python_serves_when_python3_is_too_old(machine: Machine, place: str) -> None:
    machine.replace("python3", "exit 1")
    other = machine.bin.parent / place
    other.parent.mkdir(parents=True, exist_ok=True)
    other.symlink_to(PYTHON)
    (machine.bin / "g++").unlink()  # the next thing that set-up looks for
    assert "compiler g++ is missing" in machine.complaint()


def test_named_python_does_not_suit(machine: Machine) -> None:
    machine.environment["PYTHON"] = "/bin/false"
    assert "PYTHON=/bin/false is not Python 3.11, 3.12, 3.13 or 3.14: name one that is" in machine.complaint()


@pytest.mark.parametrize(
    "kind",
    [
        'import sys; sys.implementation.name = "pypy"',
        'import sysconfig; sysconfig.get_config_var = {"Py_GIL_DISABLED": 1}.get',
    ],
)
def test_python_without_packages(machine: Machine, kind: str) -> None:
    machine.customise_python(kind)
    sentence = machine.complaint()
    assert "is needed and Python 3." in sentence
    assert sentence.endswith("PyPy and free-threaded builds have no packages of ROS 2")


def test_missing_venv_module(machine: Machine) -> None:
    machine.customise_python('import sys; sys.modules["ensurepip"] = None')
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    assert f"no venv module: install it (Debian, Ubuntu: sudo apt install {version}-venv)" in machine.complaint()


def test_missing_headers_that_cannot_be_fetched(machine: Machine) -> None:
    machine.customise_python('import sysconfig; sysconfig.get_path = lambda name: "/no/headers/here"')
    sentence = machine.complaint()
    assert "header files of Python are missing: install them (Debian, Ubuntu: sudo apt install python3." in sentence
    assert str(machine.checkout / "setup.log") in sentence


def test_other_processor(machine: Machine) -> None:
    machine.replace("uname", "echo Linux aarch64")
    assert "install ROS 2 (Jazzy, Kilted or Lyrical), source its setup.bash" in machine.complaint()


def test_sourced_ros_of_another_python(machine: Machine) -> None:
    machine.environment["ROS_DISTRO"] = "jazzy"
    assert "ROS 2 jazzy is sourced and" in machine.complaint()


def test_two_sourced_distributions(machine: Machine) -> None:
    prefixes = [machine.bin.parent / name for name in ("jazzy", "kilted")]
    for prefix in prefixes:
        (prefix / "share" / "rclpy").mkdir(parents=True)
        (prefix / "share" / "rclpy" / "package.xml").touch()
    machine.environment |= {"ROS_DISTRO": "kilted", "AMENT_PREFIX_PATH": ":".join(map(str, prefixes))}
    assert f"several ROS 2 installations are sourced ({prefixes[0]} {prefixes[1]}): open a new" in machine.complaint()


@pytest.mark.parametrize(
    ("sourced", "requested", "sentence"),
    [
        ("humble", "", "ROS 2 humble is sourced, and fringedic runs on jazzy, kilted and lyrical: source one of these"),
        ("jazzy", "kilted", "ROS=kilted was requested and ROS 2 jazzy is sourced: unset ROS"),
        ("", "lyrical", "ROS=lyrical is not on the Python package index: select jazzy or kilted, or source ROS 2 lyr"),
    ],
)
def test_distribution_that_cannot_be_had(machine: Machine, sourced: str, requested: str, sentence: str) -> None:
    machine.environment |= {"ROS_DISTRO": sourced, "ROS": requested}
    assert sentence in machine.complaint()


def test_numpy_that_the_sourced_ros_did_not_bring(machine: Machine) -> None:
    """The compiled messages of a distribution do not load with a NumPy of another major version."""
    modules = machine.bin.parent / "modules"
    (modules / "sensor_msgs").mkdir(parents=True)
    (modules / "rclpy.py").touch()
    (modules / "numpy.py").write_text('__version__ = "9.9"')
    (modules / "sensor_msgs" / "msg.py").write_text('raise ImportError("compiled for another NumPy")')
    machine.environment |= {"ROS_DISTRO": "jazzy", "PYTHONPATH": str(modules)}
    sentence = machine.complaint()
    assert f"do not load with the NumPy of {PYTHON} (9.9 {modules}/numpy.py): remove that NumPy" in sentence


def test_environment_of_another_distribution(tmp_path: Path) -> None:
    """Sourcing the environment beside another ROS 2 than it was built for changes nothing."""
    (tmp_path / "setup").mkdir()
    (tmp_path / ".venv" / "stamps").mkdir(parents=True)
    (tmp_path / ".venv" / "stamps" / "distribution").write_text("kilted")
    script = shutil.copy(ROOT / "setup" / "environment.sh", tmp_path / "setup")
    done = subprocess.run(
        ["bash", "-c", f'. "{script}"; echo $? "$PATH"'],
        env={"PATH": os.environ["PATH"], "ROS_DISTRO": "jazzy"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"1 {os.environ['PATH']}\n"
    assert "built for ROS 2 kilted and ROS 2 jazzy is sourced: run `make setup` in this shell" in done.stderr


def test_too_little_space_to_begin_with(machine: Machine) -> None:
    machine.replace("df", 'echo header; echo "/dev/sda1 20000 19990 10 99% /"')
    sentence = machine.complaint()
    assert "the disk is full" in sentence
    assert "10 MB are free; free some and start again" in sentence


def test_disk_fills_up_meanwhile(machine: Machine) -> None:
    machine.customise_python(
        "import os, sys\n"
        "def full(*_, **__): raise OSError(28, os.strerror(28))\n"
        "if 'venv' in sys.orig_argv: os.makedirs = full\n"
    )
    sentence = machine.complaint()
    assert "the disk is full: free" in sentence
    assert "No space left" in (machine.checkout / "setup.log").read_text()
    assert str(machine.checkout / "setup.log") in sentence


def test_unreachable_package_index(machine: Machine) -> None:
    machine.environment |= {"PIP_INDEX_URL": "http://127.0.0.1:9/simple", "PIP_RETRIES": "0", "PIP_NO_CACHE_DIR": "1"}
    sentence = machine.complaint()
    assert "package index cannot be reached: connect this computer to the network" in sentence
    assert str(machine.checkout / "setup.log") in sentence


@pytest.mark.skipif(find_spec("uv") is None, reason="the environment was made before set-up used uv")
def test_mirror_without_connection_once_the_installer_is_there(machine: Machine) -> None:
    """The installer comes from a folder of wheels; then it asks the index that pip is configured for."""
    _offer_installer(machine)
    settings = machine.bin.parent / "pip.conf"
    settings.write_text("[global]\nindex-url = http://127.0.0.1:9/simple\n")
    machine.environment |= {"PIP_CONFIG_FILE": str(settings), "UV_HTTP_RETRIES": "0"}
    assert "package index cannot be reached: connect this computer to the network" in machine.complaint()
    assert "http://127.0.0.1:9/simple/" in (machine.checkout / "setup.log").read_text()


OTHER_FILE = "the package index has another file than the lock names: unset PIP_INDEX_URL or set it to another mirror"


@pytest.mark.skipif(find_spec("uv") is None, reason="the environment was made before set-up used uv")
def test_mirror_with_another_installer_than_the_locked_one(machine: Machine) -> None:
    _offer_installer(machine, digest="0" * 64)
    assert OTHER_FILE in machine.complaint()


@pytest.mark.skipif(find_spec("uv") is None, reason="the environment was made before set-up used uv")
def test_mirror_with_another_package_than_the_locked_one(machine: Machine) -> None:
    """An index that cannot be reached is another thing: it leaves the smoke test of the other distribution out."""
    _offer_installer(machine)
    mirror = machine.bin.parent / "mirror"
    packages = mirror / "simple" / "sorted"
    packages.mkdir(parents=True)
    wheel = packages / "sorted-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("sorted-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: sorted\nVersion: 1.0\n")
        archive.writestr("sorted-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr("sorted-1.0.dist-info/RECORD", "")
    (packages / "index.html").write_text(f'<a href="{wheel.name}">{wheel.name}</a>')
    setup = machine.checkout / "setup"
    (setup / "requirements.lock").write_text(f"sorted==1.0 --hash=sha256:{'0' * 64}\n")
    (setup / "requirements-jazzy.lock").write_text("")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=mirror)) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        machine.environment["PIP_INDEX_URL"] = f"http://127.0.0.1:{server.server_port}/simple"
        try:
            assert OTHER_FILE in machine.complaint()
        finally:
            server.shutdown()
            thread.join()


def _offer_installer(machine: Machine, digest: str = "") -> None:
    """Let pip find the installer of the packages in a folder, which has this checksum or its own in the lock."""
    wheels = machine.bin.parent / "wheels"
    wheel = _wheel_of("uv", wheels)
    digest = digest or hashlib.sha256(wheel.read_bytes()).hexdigest()
    lock = machine.checkout / "setup" / "requirements-installer.lock"
    lock.write_text(f"uv=={version('uv')} --hash=sha256:{digest}\n")
    machine.environment |= {"PIP_FIND_LINKS": str(wheels), "PIP_NO_INDEX": "1"}


def _wheel_of(name: str, folder: Path) -> Path:
    """Pack the files of an installed package into a wheel again."""
    installed = distribution(name)
    tag = installed.read_text("WHEEL").split("Tag: ")[1].split()[0]
    folder.mkdir()
    wheel = folder / f"{name}-{installed.version}-{tag}.whl"
    scripts = f"{name}-{installed.version}.data/scripts/"
    with zipfile.ZipFile(wheel, "w") as archive:
        for file in installed.files:
            is_script = file.parts[0] == ".."
            archive.write(file.locate(), scripts + file.name if is_script else str(file))
    return wheel
