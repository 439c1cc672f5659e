"""Text machines as real ones answer, over a TCP socket and a pseudo-terminal, with the keys of the machine file."""

from __future__ import annotations

import re
import termios
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import pyvisa
import yaml
from pyvisa.constants import Parity, StopBits
from text_instrument import TextInstrument

from fringedic.errors import ConfigurationError, MachineError
from load_frame_node.machines import DescribedMachine, LoadMode, load_machine, open_machine

PAGE = Path(__file__).parents[4] / "docs" / "machines.md"
MM = 1e-3
FILE: dict[str, Any] = {
    "protocol": "scpi",
    "timeout_s": 2.0,
    "start": ["REMOTE"],
    "force": {"query": "F?"},
    "position": {"query": "P?"},
    "status": {"query": "S?", "moving": ["RUN"], "hold": ["HOLD"]},
    "move": {"commands": ["SPEED {speed:.3f}", "GOTO {position:.3f}"]},
    "hold": ["STOP"],
    "limits": {"lowest_mm": 0.0, "highest_mm": 10.0, "fastest_mm_per_s": 10.0},
}
ONE_LINE = {
    "force": {"query": "ALL?", "separator": ";", "index": 0},
    "position": {"query": "ALL?", "separator": ";", "index": 1},
    "status": {"query": "ALL?", "separator": ";", "index": 2, "moving": ["RUN"], "hold": ["HOLD"]},
}


def comma(**keys: Any) -> dict[str, Any]:
    return {**keys, "decimal": ","}


def opened(folder: Path, resource: str, changes: dict[str, Any]) -> DescribedMachine[Any]:
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump({**FILE, "resource": resource, **changes}))
    return open_machine(load_machine(path))


def check_move_and_hold(machine: DescribedMachine[Any]) -> None:
    machine.move_to(9.5 * MM, 0.02 * MM)  # 450 s
    assert machine.sample().mode is LoadMode.MOVING
    machine.hold()
    held = machine.sample()
    assert held.mode is LoadMode.HOLD
    assert 0.5 * MM < held.position < 9.5 * MM
    assert held.force == pytest.approx(2e6 * held.position, abs=1.0)


# how the machine answers; the keys that it needs; what is said without them
QUIRKS = {
    "decimal comma": (
        {"comma": True},
        {"force": comma(query="F?"), "position": comma(query="P?")},
        r"force: 'F\?' was answered with '1000,000', which is not a number: it has a decimal comma: add dec",
    ),
    "decimal comma and unit": (
        {"comma": True, "force": "{kn:.4f} kN", "position": "{mm:.4f} mm"},
        {"force": comma(query="F?"), "position": comma(query="P?")},
        r"'1,0000 kN', .* add decimal: ','",
    ),
    "several values": (
        {"force": "{newton:.3f};{mm:.5f};{word}", "position": "{newton:.3f};{mm:.5f};{word}"},
        ONE_LINE,
        "it contains several values: add separator: ';' and index: 0 or 1 to force",
    ),
    "several values with blanks, units and decimal commas": (
        {"all_values": "+ {kn:.4f} kN   {mm:.5f} mm\t{word}", "force": "{kn:.4f} kN {mm:.5f} mm", "comma": True},
        {
            "force": comma(query="ALL?", separator=" ", index=1, unit="kN"),
            "position": comma(query="ALL?", separator=" ", index=3),
            "status": {**ONE_LINE["status"], "separator": " ", "index": 5},
        },
        "add separator: ' ' and index: 0 or 2 to force; it has a decimal comma",
    ),
    "name before the value": (
        {"force": "FORCE={newton:.3f} N"},
        {"force": {"query": "F?", "separator": "=", "index": 1}},
        "add separator: '=' and index: 1 to force",
    ),
    "acknowledgement": ({"acknowledgement": "OK"}, {"acknowledge": "OK"}, 'add acknowledge: "OK"'),
    "any acknowledgement": (
        {"acknowledgement": "12 done"},
        {"acknowledge": True},
        'add acknowledge: "12 done"',
    ),
    "echo": ({"echo": True}, {"echo": True}, "it repeats requests: add echo: true"),
    "echo and acknowledgement": (
        {"echo": True, "acknowledgement": "0"},
        {"echo": True, "acknowledge": 0},
        "add echo: true",
    ),
    "carriage return": (
        {"end": "\r"},
        {"read_termination": "\r"},
        r"it sent '1000.000\\r.*', whose end is not '\\n': write read_termination: \"\\r\"",
    ),
    "carriage return of requests": (
        {"request_end": "\r"},
        {"write_termination": "\r"},
        r"'F\?' has no answer within 0.3 s.*check the query, write_termination, now '\\n', timeout_s",
    ),
    "carriage return in both directions": ({"end": "\r", "request_end": "\r"}, {"termination": "\r"}, "write_termin"),
    "slow": ({"delay_s": 0.4}, {}, r"has no answer within 0.3 s; .* came later: increase timeout_s"),
}


@pytest.mark.parametrize("quirk", QUIRKS)
def test_answers_of_real_machines_need_their_key(quirk: str, tmp_path: Path) -> None:
    manner, keys, words = QUIRKS[quirk]
    instrument = TextInstrument(**manner)
    with instrument.on_socket() as resource:
        with pytest.raises(MachineError, match=words):
            opened(tmp_path, resource, {"timeout_s": 0.3})
        with closing(opened(tmp_path, resource, keys)) as machine:
            sample = machine.sample()
            assert sample.mode is LoadMode.HOLD
            assert sample.force == pytest.approx(1000.0)
            assert sample.position == pytest.approx(0.5 * MM)
            check_move_and_hold(machine)


def test_values_of_one_line_are_asked_for_once(tmp_path: Path) -> None:
    instrument = TextInstrument()
    with instrument.on_socket() as resource, closing(opened(tmp_path, resource, ONE_LINE)) as machine:
        instrument.received.clear()
        machine.sample()
    assert instrument.received == ["ALL?"]


@pytest.mark.parametrize(
    ("manner", "keys", "words"),
    [
        ({"force": "{newton:.3f} mm"}, {}, "reply to 'F\\?' is in 'mm', and force is expected in one of mN, N, kN"),
        ({"position": "{mm:.3f} N"}, {}, "position is expected in one of um, mm, m"),
        ({"force": "{newton:.3f} lbf"}, {}, "'lbf'.* select another unit at the machine; separator: ' '"),
        ({}, {"force": comma(query="F?")}, "it has a decimal point: remove decimal from force"),
        ({}, {"force": {"query": "F?", "separator": ";", "index": 1}}, "has 1 value separated by ';', .* index"),
        ({}, {"echo": True}, "'REMOTE' has no answer within 0.3 s"),
        ({"acknowledgement": "OK"}, {"echo": True}, "does not repeat it; remove echo"),
        ({"acknowledgement": "ERR 5"}, {"acknowledge": "OK"}, "'REMOTE' was answered with 'ERR 5.*acknowledge .*'OK'"),
        ({}, {"acknowledge": "OK"}, r"'REMOTE' has no answer .* acknowledge \(remove it"),
        ({"end": "\r\n"}, {"read_termination": "\r"}, r'write read_termination: "\\r\\n"'),
    ],
)
def test_keys_that_do_not_fit_are_refused(
    manner: dict[str, Any], keys: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with TextInstrument(**manner).on_socket() as resource, pytest.raises(MachineError, match=words):
        opened(tmp_path, resource, {"timeout_s": 0.3, **keys})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("9" * 1_000_000, "'F?' was answered with more than 4095 characters, '9999"),
        ("<script>alert(1)</script>\x1b[31m" + 1500 * ";1", "'<script>alert(1)</script>"),
    ],
)
def test_hostile_replies_are_refused_in_a_short_sentence(text: str, words: str, tmp_path: Path) -> None:
    with TextInstrument(force=text).on_socket() as resource, pytest.raises(MachineError) as refused:
        opened(tmp_path, resource, {"timeout_s": 0.3})
    said = str(refused.value)
    assert words in said
    assert len(said) < 400
    assert said.isprintable()


@pytest.mark.parametrize(
    ("form", "newton"),
    [("{newton:.1f} N", 1000.0), ("{kn:.4f} kN", 1000.0), ("{kn:.4f}kN", 1000.0), ("{kn:.1e} KN", 1000.0),
     ("-  {kn} mN", -1e-3), ("{newton:.3f}\r", 1000.0)],
)  # fmt: skip
def test_unit_of_a_reply_replaces_that_of_the_file(form: str, newton: float, tmp_path: Path) -> None:
    for unit in ("N", "kN"):
        instrument = TextInstrument(force=form)
        changes = {"force": {"query": "F?", "unit": unit}}
        with instrument.on_socket() as resource, closing(opened(tmp_path, resource, changes)) as machine:
            has_unit = form.endswith("N")
            assert machine.sample().force == pytest.approx(newton * (1.0 if has_unit or unit == "N" else 1e3))


@pytest.mark.parametrize("letter", ["u", "\u00b5"])
def test_micrometres_of_a_reply(letter: str, tmp_path: Path) -> None:
    instrument = TextInstrument(position=f"500 {letter}m")
    with instrument.on_socket() as resource, closing(opened(tmp_path, resource, {})) as machine:
        assert machine.sample().position == pytest.approx(0.5 * MM)


def test_serial_machine_moves_and_holds_over_a_pseudo_terminal(tmp_path: Path) -> None:
    instrument = TextInstrument(end="\r\n", request_end="\r", acknowledgement="OK", echo=True, comma=True)
    line = {"baud_rate": 19200, "stop_bits": 2, "flow_control": "xon_xoff"}
    changes = {
        "serial": line, "read_termination": "\r\n", "write_termination": "\r", "echo": True, "acknowledge": "OK",
        "force": comma(query="F?"), "position": comma(query="P?"),
    }  # fmt: skip
    with instrument.on_line() as (resource, descriptor):
        with closing(opened(tmp_path, resource, changes)) as machine:
            settings = termios.tcgetattr(descriptor)
            assert settings[4] == settings[5] == termios.B19200
            assert settings[2] & termios.CSTOPB
            assert settings[0] & termios.IXON
            assert machine.sample().force == pytest.approx(1000.0)
            check_move_and_hold(machine)
            with pytest.raises(MachineError, match="another program uses the serial line; end it"):
                opened(tmp_path, resource, changes)
        with closing(opened(tmp_path, resource, changes)) as machine:
            assert machine.sample().mode is LoadMode.HOLD, "the line is free again"


def test_silent_serial_machine_names_the_settings_of_the_line(tmp_path: Path) -> None:
    with TextInstrument(request_end="\x03").on_line() as (resource, _):
        words = "no answer .* check .*serial: baud_rate, data_bits, parity, stop_bits and flow_control"
        with pytest.raises(MachineError, match=words):
            opened(tmp_path, resource, {"timeout_s": 0.2})
    with pytest.raises(MachineError, match=r"no connection: .*check cable"):
        opened(tmp_path, "ASRL/dev/absent::INSTR", {})


def test_settings_reach_the_serial_port(tmp_path: Path) -> None:
    """PySerial's loop repeats every request; a pseudo-terminal accepts neither 7 data bits nor a parity."""
    line = {"baud_rate": 4800, "data_bits": 7, "parity": "odd", "stop_bits": 1.5, "flow_control": "rts_cts"}
    path = tmp_path / "machine.yaml"
    path.write_text(
        yaml.safe_dump({**FILE, "resource": "ASRLloop://::INSTR", "start": [], "timeout_s": 0.2, "serial": line})
    )
    with closing(open_machine(load_machine(path), is_required=False)) as machine:
        assert "add echo: true" in str(machine.inspect()[0].error)
        [port] = pyvisa.ResourceManager("@py").list_opened_resources()
        assert (port.baud_rate, port.data_bits, port.parity) == (4800, 7, Parity.odd)
        assert (port.stop_bits, port.visalib.sessions[port.session].interface.rtscts) == (StopBits.one_and_a_half, True)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"serial": {"baud_rate": 9600}}, r"serial belongs to a serial line \(ASRL...\), and the resource is TCPIP"),
        ({"resource": "ASRL1::INSTR", "serial": {"parity": "often"}}, "serial.parity: "),
        ({"resource": "ASRL1::INSTR", "serial": {"stop_bits": 3}}, "serial: stop_bits is 3; give 1, 1.5 or 2"),
        ({"resource": "ASRL1::INSTR", "serial": {"bauds": 9600}}, "serial.bauds: "),
        ({"force": {"query": "F?", "index": 2}}, "force: index 2 needs separator"),
        ({"force": comma(query="F?", separator=",")}, "force: separator and decimal are both ','"),
        ({"read_termination": "\r\r"}, "contains its last character twice"),
        ({"status": {"query": "S?", "moving": [{}]}}, "give bits_set or bits_clear"),
        ({"status": {"query": "S?", "moving": [{"bits_set": [1], "bits_clear": [1]}]}}, "bit 1 is in bits_set and in"),
    ],
)
def test_machine_file_with_a_mistake(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump({**FILE, "resource": "TCPIP::127.0.0.1::5025::SOCKET", **changes}))
    with pytest.raises(ConfigurationError, match=words):
        load_machine(path)


def test_inspection_shows_every_answer_and_sends_queries_only(tmp_path: Path) -> None:
    instrument = TextInstrument(force="{kn:.3f} kN", position="{mm:.3f} N", status="{word} 3")
    path = tmp_path / "machine.yaml"
    with instrument.on_socket() as resource:
        path.write_text(yaml.safe_dump({**FILE, "resource": resource}))
        with closing(open_machine(load_machine(path), is_required=False)) as machine:
            force, position, status = machine.inspect()
    assert (force.request, force.raw, force.value, force.error) == ("F?", r"'1.000 kN\n'", pytest.approx(1000.0), None)
    assert (position.raw, position.value) == (r"'0.500 N\n'", None)
    assert "position is expected in one of um, mm, m" in str(position.error)
    assert status.raw == r"'HOLD 3\n'"
    assert "'HOLD 3' is in no list of status: add it to idle, moving, hold or fault" in str(status.error)
    assert instrument.received == ["REMOTE", "F?", "P?", "S?"]


@pytest.mark.parametrize("text", re.findall(r"```yaml\n(protocol: .*?)```", PAGE.read_text(), re.S))
def test_files_of_the_page_are_valid(text: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.yaml"
    path.write_text(text)
    assert load_machine(path).entries()
