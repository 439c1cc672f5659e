"""Attachments: signals of a machine's file beside a recording, which is not changed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from machine_exports import STYLES
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.command.main import app
from fringedic.errors import RecordingError
from fringedic.evidence import begin_log, read_log
from fringedic.recording.topics import Topic
from fringedic.recording.writer import BagWriter
from fringedic.signals import (
    ExportOptions,
    attach,
    attachment_digests,
    attachment_folder,
    attachment_names,
    read_attachment,
    recorded_signals,
    remove_attachment,
    with_attachments,
)

LOAD = "fringedic_msgs/msg/LoadState"
DEFINITIONS = Path(__file__).parents[3] / "fringedic_msgs/msg"
BEGIN = 1_790_000_000_000_000_000
OFFSET = 3607.3  # [s] of a machine in another time zone


CORNERS = np.array([[0, 5, 7, 16, 19, 27, 29, 60.0], [0, 0, 400, 400, 1000, 1000, 1500, 1500.0]])
"""Times [s] and forces [N] of ramps with holds."""


def record(path: Path) -> Path:
    """Write a recording of force and position at 20 Hz."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg((DEFINITIONS / "LoadState.msg").read_text(), LOAD))
    definition, _ = store.generate_msgdef(LOAD, ros_version=2)
    rng = np.random.default_rng(1)
    with BagWriter(path) as writer:
        writer.add_recorded_topic(Topic("/rig/load_frame/state", LOAD, definition, "ros2msg", "", ""))
        for time in np.arange(0, 60, 0.05):
            stamp = BEGIN + round(1e9 * time)
            now = store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
            force = float(np.interp(time, *CORNERS)) + rng.normal(0, 4)
            header = store.types["std_msgs/msg/Header"](now, "")
            message = store.types[LOAD](header, 2, force, 1e-6 * force, "")
            writer.write("/rig/load_frame/state", bytes(store.serialize_cdr(message, LOAD)), stamp, stamp)
    return path


@pytest.fixture(scope="module")
def machine_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The machine's own file: dates of its own clock, kilonewton, and a thermocouple."""
    rng = np.random.default_rng(2)
    file = tmp_path_factory.mktemp("machine") / "machine.csv"
    lines = ["Datum;Prüfkraft [kN];Probe [°C]"]
    for time in np.arange(2.05, 55, 0.1):
        stamp = np.datetime64(BEGIN + round(1e9 * (time + OFFSET)), "ns").astype("datetime64[ms]").item()
        force = float(np.interp(time, *CORNERS)) + rng.normal(0, 4)
        words = f"{stamp:%d.%m.%Y %H:%M:%S},{stamp.microsecond // 1000:03d};{1e-3 * force:.6f};{20 + 0.1 * time:.2f}"
        date, force_text, temperature = words.split(";")
        lines.append(f"{date};{force_text.replace('.', ',')};{temperature.replace('.', ',')}")
    file.write_bytes("\r\n".join(lines).encode("cp1252"))
    return file


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run with a recording and its log."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "keys"))
    run = tmp_path / "plate-7"
    run.mkdir()
    record(run / "bag")
    begin_log(run, "run", details={})
    return run


def content(folder: Path) -> Mapping[str, str]:
    return {str(path): sha256(path.read_bytes()).hexdigest() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_file_gets_the_clock_of_the_rig_and_the_recording_stays(run: Path, machine_file: Path) -> None:
    bag = run / "bag"
    before = content(bag)
    attached = attach(bag, machine_file, sigmas={"force": 4.0})
    clock = attached.attachment.clock
    assert clock.by == "force"
    assert abs(clock.offset - OFFSET) < 4 * clock.sigma_offset < 0.1
    force = attached.signals["force"]
    np.testing.assert_allclose(force.values, np.interp(1e-9 * (force.stamps - BEGIN), *CORNERS), atol=20)
    assert force.sigmas.min() >= 4.0
    signals = with_attachments(recorded_signals(bag), bag)
    assert sorted(signals) == ["force", "force_machine", "position", "probe"]
    assert signals["probe"].values[0] == pytest.approx(293.355, abs=0.01)
    assert content(bag) == before
    copy = attachment_folder(bag) / "machine.csv"
    assert sha256(copy.read_bytes()).hexdigest() == attached.attachment.sha256
    entry = read_log(run).entries[-1]
    assert (entry.action, read_log(run).faults) == ("attach", [])
    assert entry.details["attachments"]["machine.csv"]["sha256"] == attached.attachment.sha256
    assert "bag_attached/machine.csv" in entry.files


def test_it_is_replaced_and_removed(run: Path, machine_file: Path) -> None:
    bag = run / "bag"
    attach(bag, machine_file)
    with pytest.raises(RecordingError, match="exists already; replace it with --overwrite"):
        attach(bag, machine_file)
    before = attachment_digests(bag)
    attach(bag, machine_file, instead=True, overwrite=True)
    assert attachment_digests(bag) != before
    signals = with_attachments(recorded_signals(bag), bag)
    assert sorted(signals) == ["force", "position", "probe"]
    assert signals["force"].channel.source == "machine"
    with pytest.raises(RecordingError, match=r"has no attachment 'other\.csv', only machine\.csv"):
        remove_attachment(bag, "other.csv")
    remove_attachment(bag, "machine.csv")
    assert attachment_names(bag) == []
    assert not attachment_folder(bag).exists()
    assert [entry.action for entry in read_log(run).entries[-3:]] == ["attach", "attach", "remove attachment"]
    assert read_log(run).entries[-1].files["bag_attached/machine.csv"][1] is None


def test_parts_of_one_file_are_one_signal(run: Path, machine_file: Path) -> None:
    bag, whole = run / "bag", machine_file.read_text("cp1252").count("\n")
    for name, lines in (("b.csv", (301, whole + 1)), ("a.csv", (1, 300))):
        attach(bag, machine_file, name=name, options=ExportOptions(lines=lines), offset=(OFFSET, 0.01))
    signals = with_attachments(recorded_signals(bag), bag)
    assert sorted(signals) == ["force", "force_a", "position", "probe"]
    assert signals["probe"].stamps.size == whole
    assert np.diff(signals["probe"].stamps).min() > 0


def test_a_changed_file_is_refused(run: Path, machine_file: Path) -> None:
    attach(run / "bag", machine_file)
    copy = attachment_folder(run / "bag") / "machine.csv"
    copy.write_bytes(copy.read_bytes().replace(b"20,2", b"20,3", 1))
    with pytest.raises(RecordingError, match="was changed since it was attached"):
        with_attachments({}, run / "bag")


def test_without_a_common_signal_the_offset_is_given(run: Path, tmp_path: Path) -> None:
    file = tmp_path / "grip.txt"
    file.write_text("time [s]\tgrip [degC]\n0.0\t20.5\n10.0\t21.5\n", encoding="utf-8")
    with pytest.raises(
        RecordingError, match="no signal that both have can fix its clock; the recording has force, pos"
    ):
        attach(run / "bag", file)
    attached = attach(run / "bag", file, offset=(-2.0, 0.5))
    assert attached.signals["grip"].stamps.tolist() == [BEGIN + 2 * 10**9, BEGIN + 12 * 10**9]


def test_the_uncertainty_of_the_clock_is_in_that_of_the_values(run: Path, tmp_path: Path) -> None:
    file = tmp_path / "grip.txt"
    file.write_text("time [s]\tgrip [K]\n0\t300\n1\t310\n2\t320\n", encoding="utf-8")
    attached = attach(run / "bag", file, offset=(0.0, 0.2), sigmas={"grip": 1.5})
    assert attached.signals["grip"].sigmas.tolist() == pytest.approx([2.5, 2.5, 2.5])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"file": "nothing.csv"}, "cannot be read: No such file or directory"),
        ({"name": "../evil"}, "is no name of an attachment"),
        ({"by": "grip"}, "no signal 'grip' in both can fix its clock"),
        ({"sigmas": {"grip": 1.0}}, "--sigma grip: the file has only force, probe"),
        ({"options": ExportOptions(columns=["9=force"])}, "--columns 9: the file has no such column"),
    ],
)
def test_what_is_wrong_is_a_sentence_and_nothing_is_written(
    run: Path, machine_file: Path, change: dict[str, object], reason: str
) -> None:
    file = change.pop("file", machine_file)
    with pytest.raises(RecordingError, match=re.escape(reason)):
        attach(run / "bag", file, **change)  # type: ignore[arg-type]
    assert not attachment_folder(run / "bag").exists()


def test_command_shows_structure_and_clock(run: Path, machine_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    app(["attach", str(run), str(machine_file)], standalone_mode=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "text: cp1252, separated by semicolon, decimal comma" in said
    assert "force: column 2 Prüfkraft [kN], kN to N" in said
    assert re.search(r"clock of the file: \+3607\.\d+ s ± [\d.]+ ms, drift", said)
    assert (run / "bag_attached/machine.csv.clock.png").stat().st_size > 10_000
    assert read_log(run).files.keys() >= {"bag_attached/machine.csv.clock.png"}
    app(["attach", str(run)], standalone_mode=False)
    assert "machine.csv: force, probe; SHA-256" in capsys.readouterr().out
    app(["attach", str(run), "--remove", "machine.csv"], standalone_mode=False)
    for given, sigma in {"3600": 288.675, "3607.2": 28.8675, "3607.25 +- 0.1": 100.0}.items():
        app(["attach", str(run), str(machine_file), "--offset", given, "--overwrite"], standalone_mode=False)
        capsys.readouterr()
        clock = read_attachment(run / "bag", "machine.csv").attachment.clock
        assert 1e3 * clock.sigma_offset == pytest.approx(sigma, rel=1e-4)
    app(["attach", str(run), "--remove", "machine.csv"], standalone_mode=False)
    app(["attach", str(run)], standalone_mode=False)
    assert "nothing is attached" in capsys.readouterr().out


def test_a_file_without_dates_counts_from_its_own_begin(run: Path, tmp_path: Path) -> None:
    """It begins 1.5 s before the recording."""
    time = np.arange(0, 58, 0.1)
    force = np.interp(time - 1.5, *CORNERS) + np.random.default_rng(5).normal(0, 4, time.size)
    file = tmp_path / "bluehill.csv"
    file.write_bytes(STYLES["bluehill"]((time, force, 1e-6 * force)))
    attached = attach(run / "bag", file)
    assert attached.attachment.clock.offset == pytest.approx(1.5, abs=4 * attached.attachment.clock.sigma_offset)


def test_beside_a_gap_the_uncertainty_of_the_clock_counts_too(run: Path, tmp_path: Path) -> None:
    """100 N/s with 0.1 s: 10 N. The values beside a missing one had no slope, and so the uncertainty of the sensor."""
    file = tmp_path / "ramp.csv"
    rows = [f"{number / 10};{'' if number == 20 else 10.0 * number}" for number in range(40)]
    file.write_text("time [s];Load [N]\n" + "\n".join(rows))
    attached = attach(run / "bag", file, offset=(0.0, 0.1), sigmas={"force": 1.0})
    sigmas = attached.signals["force"].sigmas
    assert np.isnan(sigmas[20])
    np.testing.assert_allclose(np.delete(sigmas, 20), np.hypot(1.0, 10.0))
