"""Files that a person has mistyped: one sentence with file and line, never a traceback or the last of two values."""

import math
import types
import typing

import pytest
import yaml
from pydantic import BaseModel

from fringedic.calibration.history import CHECKS_FILE, recorded_checks
from fringedic.camera.distortion import DistortionMap
from fringedic.configuration.forecast import forecast
from fringedic.configuration.rig_file import RigFile, load_programme, load_rig_file
from fringedic.errors import ConfigurationError, FringedicError
from fringedic.frames.region import Region
from fringedic.metadata import Metadata, NoiseFloorMetadata
from fringedic.patterns.response import ResponseCurve
from fringedic.rig.model import RigModel
from fringedic.wording.yaml_text import load_yaml

RIG = "camera: {source: virtual}\nvirtual_rig: {preset: plate, size: tiny}\n"


def nested_aliases(first, other):
    """Lists or merged mappings (<<) of ten aliases each, in 10 levels: 500 to 800 bytes for 10^10 values."""
    lines = [f"k0: &a0 {first.format(0)}"]
    for level in range(1, 11):
        lines.append(f"k{level}: &a{level} {other.format(', '.join([f'*a{level - 1}'] * 10))}")
    return "\n".join(lines)


BROKEN = [
    (f"{RIG}camera: {{source: files}}", r"line 3: the key 'camera' is in line 1 already: remove one"),
    ("experiment: a\nramp:\n  to_mm: 1.0\n  steps: 3\n  to_mm: 10.0\n", r"line 5: the key 'to_mm' is in line 3"),
    ("experiment: 2026-02-30\nramp: {to_mm: 1.0, steps: 3}", r"line 1: 2026-02-30 is no valid value: day"),
    (f"{RIG}namespace: !!int abc", r"line 3: abc is no valid value"),
    (f"{RIG}namespace: {'9' * 5000}", r"line 3: 9{40}\.\.\. is no valid value: Exceeds the limit"),
    (f"{RIG}namespace: {'[' * 400}{']' * 400}", r"line 3: more than 50 brackets"),
    (f"{RIG}namespace: {'[' * 400}", r"line 3: more than 50 brackets"),
    (f"{RIG}namespace: [1, 2", r"line 3, column 17: .*"),
    (f"{RIG}namespace: !!python/object:os.system {{}}", r"line 3, column 12: could not determine a constructor"),
    (f"{RIG}namespace: '\x07'", r"special characters are not allowed"),
    (f"{RIG}? [1, 2]\n: 3", r"line 3|unhashable|valid string"),
    ("ramp: {to_mm: 010, steps: 3}", r"line 1: 010 is no valid value: write a number in decimal digits"),
    ("steps:\n- position_mm: 1:30", r"line 2: 1:30 is no valid value: write a number in decimal"),
    ("steps: [{position_mm: 1:30.5}]", r"line 1: 1:30\.5 is no valid value: write a number in decimal"),
    ("ramp: {to_mm: 010.5, steps: 3}", r"line 1: 010\.5 is no valid value: write a number in decimal"),
    ("ramp: {to_mm: 0x10, steps: 3}", r"line 1: 0x10 is no valid value: write a number in decimal"),
    ("ramp: {to_mm: 0b10, steps: 3}", r"line 1: 0b10 is no valid value: write a number in decimal"),
    ("ramp: {to_mm: 1_0, steps: 3}", r"line 1: 1_0 is no valid value: write a number in decimal"),
    ("ramp: {to_mm: 0o10, steps: 3}", r"ramp"),
    (f"ramp: {{to_mm: {'1:' * 3000}1, steps: 3}}", r"line 1: 1:1:.*\.\.\. is no valid value: write a number"),
    (f"{RIG}namespace: !!bool maybe", r"line 3: maybe is no valid value: it is no bool"),
    (f"{RIG}namespace: !!timestamp abc", r"line 3: abc is no valid value: it is no timestamp"),
    (f"{RIG}namespace: !!int ''", r"line 3: an empty text is no valid value: write a number"),
    (f"{RIG}namespace: !!float ''", r"line 3: an empty text is no valid value: write a number"),
    (f"{RIG}namespace: !!int +", r"line 3: \+ is no valid value: write a number"),
    (f"{RIG}namespace: !!map 5", r"line 3, column 12: expected a mapping node"),
    (f'{RIG}namespace: "\\UFFFFFFFF"', r"line 3: an escape sequence is no character of Unicode"),
    (f'{RIG}namespace: "\\U00110000"', r"line 3: an escape sequence is no character of Unicode"),
    (f"{RIG}<<: 3", r"line 3, column 5|mapping"),
    (f"{RIG}namespace: &a [*a]", r"line 3: &a contains itself"),
    (nested_aliases("{}", "[{}]"), r"line 5: aliases such as \*a3 stand for more than 10000 values: write them out"),
    (nested_aliases("{{k{}: 1}}", "{{<<: [{}]}}"), r"line 5: aliases such as \*a3 stand for more than 10000 values"),
]


@pytest.mark.parametrize("load", [load_rig_file, load_programme])
@pytest.mark.parametrize(("text", "message"), BROKEN)
def test_broken_files_are_refused_in_one_sentence_with_the_line(tmp_path, load, text, message):
    file = tmp_path / "mistyped.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as refused:
        load(file)
    assert str(file) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) <= 500 + len(str(file))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0), ("-10", -10), ("+5", 5), ("0.5", 0.5), ("-0.5", -0.5), (".5", 0.5), ("1.", 1.0), ("1.5e-3", 1.5e-3),
        ("1.0E+2", 100.0), ("-.inf", -math.inf), ("!!float 5", 5.0), ("'010'", "010"), ("'1:30'", "1:30"),
    ],
)  # fmt: skip
def test_decimal_numbers_and_quoted_text_are_read_as_they_are_written(text, value):
    assert load_yaml(f"key: {text}") == {"key": value}


def test_merged_keys_are_replaced_by_those_of_the_mapping(tmp_path):
    file = tmp_path / "programme.yaml"
    file.write_text(
        "steps:\n"
        "- &a {position_mm: 0.0, hold_s: 1.0}\n"
        "- cycle: {times: 2, steps: [&b {<<: *a, position_mm: 0.5}]}\n"
        "- {<<: *b, position_mm: 1.0}\n"
    )
    assert [step.position for step in load_programme(file).load_steps()] == [0.0, 0.5e-3, 0.5e-3, 1e-3]
    with pytest.raises(yaml.YAMLError, match="line 2: the key '<<' is in line 2 already"):
        load_yaml("a: &a {k: 1}\nb: {<<: *a, <<: *a}")


def test_aliases_of_ordinary_files_are_read():
    text = "steps: [&a {position_mm: 1, hold_s: 2}" + ", *a" * 1000 + "]"
    assert load_yaml(text)["steps"] == [{"position_mm": 1, "hold_s": 2}] * 1001


@pytest.mark.parametrize("entry", ["preset: [plate]", "preset: plate, size: {}", "preset: plate, alignment: [usual]"])
def test_entries_of_a_virtual_rig_that_are_no_names(tmp_path, entry):
    file = tmp_path / "rig.yaml"
    file.write_text(f"camera: {{source: virtual}}\nvirtual_rig: {{{entry}}}\n")
    with pytest.raises(FringedicError, match="is unknown; choose from"):
        load_rig_file(file)


@pytest.mark.parametrize(
    "load",
    [
        RigModel.from_yaml,
        DistortionMap.load,
        ResponseCurve.load,
        NoiseFloorMetadata.load,
        Region.load,
        lambda file: Region.from_text(file.read_text("utf-8", "replace")),
        lambda file: Metadata.from_text(f"specimen: {file.read_text('utf-8', 'replace')}"),
        lambda file: recorded_checks(file.parent) or Region.load(file),
    ],
)
@pytest.mark.parametrize(
    "content",
    [*(text.encode() for text, _ in BROKEN), b"\xff\xfe\x00binary", b"[]", b"text", b"a: {b: 1}", b"[[1], 2]"],
)
def test_every_file_that_a_person_may_edit_is_read_strictly(tmp_path, load, content):
    file = tmp_path / CHECKS_FILE
    file.write_bytes(content)
    with pytest.raises(FringedicError) as refused:
        load(file)
    assert len(str(refused.value)) <= 500 + len(str(file))


@pytest.mark.parametrize("load", [load_rig_file, load_programme, RigModel.from_yaml, DistortionMap.load, Region.load])
@pytest.mark.parametrize("name", ["absent.yaml", "", f"{'x' * 300}.yaml"])
def test_files_that_cannot_be_read(tmp_path, load, name):
    with pytest.raises(FringedicError, match=r"cannot be read|path of this file system"):
        load(tmp_path / name)


def numbers_of(model, path=()):
    """Return the paths of all numbers of a section and of the sections in it."""
    found = []
    for name, field in model.model_fields.items():
        kinds = [field.annotation]
        while kinds:
            kind = kinds.pop()
            origin = typing.get_origin(kind)
            if origin in (typing.Union, types.UnionType, typing.Annotated):
                kinds += typing.get_args(kind)
            elif kind in (float, int):
                found.append((*path, name))
            elif isinstance(kind, type) and issubclass(kind, BaseModel):
                found += numbers_of(kind, (*path, name))
    return found


PROGRAMME = [("programme", "ramp", name) for name in ("from_mm", "to_mm", "speed_mm_per_s", "hold_s", "steps")]


@pytest.mark.parametrize("value", [1e308, -1e308, 1e-308, math.inf, math.nan, 10**400])
def test_every_number_of_a_rig_file_is_a_number_that_works_or_an_error(tmp_path, value):
    numbers = [*numbers_of(RigFile), *PROGRAMME]
    assert len(numbers) > 60
    for path in numbers:
        content = {**yaml.safe_load(RIG), "projector": {}, "programme": {"ramp": {"to_mm": 1.0, "steps": 3}}}
        section = content
        for name in path[:-1]:
            section = section.setdefault(name, {})
        section[path[-1]] = value
        file = tmp_path / "rig.yaml"
        file.write_text(yaml.safe_dump(content))
        assert works_or_is_refused(file), path


def works_or_is_refused(file):
    try:
        rig = load_rig_file(file)
    except FringedicError as error:
        return len(str(error)) <= 500 + len(str(file))
    expected = forecast(rig, rig.programme)
    positions = [step.position for step in rig.programme.load_steps()]
    return math.isfinite(expected.duration + expected.size) and all(map(math.isfinite, positions))
