"""Settings that a program writes into a rig file."""

from __future__ import annotations

from pathlib import Path

import pytest

from fringedic.configuration.changes import change_rig_file, load_changed_rig_file
from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import ConfigurationError

TEXT = "# my rig\ncamera: {source: virtual, exposure_ms: 5.0}\nvirtual_rig: {preset: plate, size: tiny}\n"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    file = tmp_path / "rig.yaml"
    file.write_text(TEXT)
    return file


def test_changed_keys_are_merged_and_the_file_before_is_kept(rig: Path) -> None:
    before = change_rig_file(rig, "camera:\n  settle_ms: 20\nnodes: {dic: {window: 24}}")
    changed = load_rig_file(rig)
    assert (changed.camera.exposure_time, changed.camera.settle_time, changed.nodes.dic.window) == (0.005, 0.02, 24)
    assert before.read_text() == TEXT
    second = change_rig_file(rig, "namespace: other")
    assert second != before
    assert sorted(path.name for path in rig.parent.iterdir()) == sorted([rig.name, before.name, second.name])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("camera: {settle_ms: -1}", "camera.settle_ms"),
        ("no_such_key: 1", "no_such_key"),
        ("calibration: nowhere.yaml", "there is no file"),
        ("just words", "settings: are not 'key: value'"),
        ("", "settings: are not 'key: value'"),
        ("a: [", "settings: line 1"),
    ],
)
def test_wrong_settings_change_nothing(rig: Path, settings: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        change_rig_file(rig, settings)
    assert rig.read_text() == TEXT
    assert [path.name for path in rig.parent.iterdir()] == [rig.name]


def test_a_file_of_several_sensors_is_refused_without_an_option_that_is_not_there(rig: Path) -> None:
    own = "{{virtual_rig: {{arrangement: plate, place: {0}, size: tiny}}}}"
    text = f"camera: {{source: virtual}}\nsensors:\n  left: {own.format('left')}\n  right: {own.format('right')}\n"
    rig.write_text(text)
    words = "rig.yaml: has the sensors left, right, and this is possible for one only: .* top of a file of its own$"
    with pytest.raises(ConfigurationError, match=words):
        change_rig_file(rig, "camera: {settle_ms: 20}")
    with pytest.raises(ConfigurationError, match=words):
        load_changed_rig_file(rig, {"plan.angle_degree": 35.0})
    assert rig.read_text() == text
