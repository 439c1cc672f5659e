"""Files of measured numbers have a hash; a file that a person edited says so, and so does what is made with it."""

import dataclasses
import random
import re

import pytest

from fringedic.camera import DistortionMap
from fringedic.errors import CalibrationError, GridError, PatternError
from fringedic.patterns.response import ResponseCurve
from fringedic.rig.model import RigModel

RIG = RigModel(
    camera_width=160, camera_height=120, camera_distance=0.8, pixel_size=4e-4, pixel_aspect=1.0, principal_column=79.5,
    principal_row=59.5, projector_width=800, projector_height=600, projector_position=(-0.3, 0.0, 0.9),
    projector_focal_length=1200.0, projector_principal_column=399.5, projector_principal_row=299.5, identifier="bench",
    projector_k1=-0.0005,
)  # fmt: skip


def test_every_changed_digit_of_a_calibration_is_refused(tmp_path):
    file, chosen = tmp_path / "calibration.yaml", random.Random(1)
    RIG.to_yaml(file)
    text = file.read_text()
    assert RigModel.from_yaml(file) == RIG
    for digit in chosen.sample(list(re.finditer("[0-9]", text)), 60):
        other = chosen.choice([each for each in "0123456789" if each != digit[0]])
        file.write_text(text[: digit.start()] + other + text[digit.end() :])
        with pytest.raises(CalibrationError, match=r"calibration\.yaml: "):
            RigModel.from_yaml(file)


def test_an_edited_calibration_is_accepted_when_it_says_so(tmp_path):
    file = tmp_path / "calibration.yaml"
    RIG.to_yaml(file)
    text = file.read_text().replace("k1: -0.0005", "k1: -0.3")
    file.write_text(text)
    with pytest.raises(CalibrationError, match=r"its content has changed .* add the line 'edited: true'"):
        RigModel.from_yaml(file)
    file.write_text(f"{text}edited: true\n")
    edited = RigModel.from_yaml(file)
    assert edited == dataclasses.replace(RIG, projector_k1=-0.3, identifier="bench (edited by hand)")
    edited.to_yaml(file)  # as a run copies it for its nodes
    assert RigModel.from_yaml(file) == edited


def test_order_comments_and_layout_do_not_matter(tmp_path):
    file = tmp_path / "calibration.yaml"
    RIG.to_yaml(file)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(["# our bench", *lines[3:], *lines[:3]]))
    assert RigModel.from_yaml(file) == RIG


def test_a_file_without_hash_is_read_and_told(tmp_path, caplog):
    file = tmp_path / "calibration.yaml"
    RIG.to_yaml(file)
    file.write_text(re.sub("checksum: .*\n", "", file.read_text()))
    assert RigModel.from_yaml(file) == RIG
    assert f"{file}: contains no hash of its numbers" in caplog.text


def test_lens_and_response_curve_have_a_hash(tmp_path):
    lens, curve = tmp_path / "lens.yaml", tmp_path / "response.yaml"
    DistortionMap.load(_camera_info(tmp_path)).save(lens)
    ResponseCurve(tuple((level / 255) ** 2.2 for level in range(256))).save(curve)
    for file, load, error in ((lens, DistortionMap.load, GridError), (curve, ResponseCurve.load, PatternError)):
        load(file)
        head, numbers = file.read_text().split(".", 1)
        file.write_text(f"{head}.{(int(numbers[0]) + 1) % 10}{numbers[1:]}")
        with pytest.raises(error, match="checksum differs"):
            load(file)


def _camera_info(folder):
    file = folder / "ost.yaml"
    file.write_text(
        "image_width: 160\nimage_height: 120\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [200, 0, 80, 0, 200, 60, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}\n"
    )
    return file
