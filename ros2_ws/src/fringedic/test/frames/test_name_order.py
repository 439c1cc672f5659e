"""Order of image files by the numbers in their names."""

from __future__ import annotations

from itertools import islice, permutations
from pathlib import Path

import pytest

from fringedic.frames.name_order import order_by_name


@pytest.mark.parametrize(
    "names",
    [
        # decimal numbers
        ["load_0", "load_0.25", "load_0.5", "load_0.75", "load_1", "load_1.05", "load_1.5"],
        ["load_-2.5", "load_-1", "load_0", "load_.5", "load_10"],
        ["load_-.5", "load_0", "load_.25"],
        ["a_0,5", "a_1", "a_1,25", "a_10"],
        ["0.5kN", "1kN", "1.25kN", "10kN"],
        ["1.05", "1.10", "1.5"],  # not counters: a leading zero
        # minus signs, and hyphens that are none
        ["load_-10", "load_0", "load_10"],
        ["load_-3", "load_-2", "load_-1"],
        ["-10", "-5", "0", "+5"],
        ["img-1", "img-2", "img-10"],
        ["specimen -1", "specimen -2", "specimen -3"],
        ["load -2", "load -1", "load 0"],
        ["x-1", "x0", "x1"],
        ["part1-2", "part1-10", "part2-1"],
        # dates and times
        ["2024-05-01_12-30-05", "2024-05-01_12-30-06", "2024-05-10_01-00-00", "2024-11-02_00-00-00"],
        ["2024-5-1", "2024-5-12", "2024-10-3"],
        ["2024-05-01T12:30:05.25", "2024-05-01T12:30:05.5", "2024-05-01T12:30:06"],
        ["test-2024-05-01_-5", "test-2024-05-01_5"],
        ["2024.5.1", "2024.10.1"],
        ["20240501T090000", "20240501T123005"],
        ["1714566605123456788", "1714566605123456789"],
        # counters
        ["img_1", "img_2", "img_10"],
        ["img_001", "img_002", "img_010"],
        ["img.9", "img.10"],
        ["cam1.8", "cam1.9", "cam1.10", "cam1.11"],
        ["cam1.9", "cam1.10", "cam2.9", "cam2.10"],
        ["1.0", "1.1", "1.2", "1.3", "1.4", "1.5", "1.6", "1.7", "1.8", "1.9", "1.10"],
        ["v1.2", "v1.2.3", "v1.2.10", "v1.10"],
        ["step9_cam2", "step10_cam1", "step10_cam2"],
        ["a1b2", "a1b10", "a2b1"],
        ["A1", "a2", "A10"],
        ["img", "img1", "img2"],
        ["01", "1", "2"],
    ],
)
def test_names_are_ordered_by_their_numbers(names: list[str]) -> None:
    files = [Path(f"{name}.tif") for name in names]
    for given in islice(permutations(reversed(files)), 100):
        assert order_by_name(given) == files


def test_every_file_stays() -> None:
    same = [Path("a/img_1.tif"), Path("b/img_1.tif"), Path("b/img_1.tif")]
    assert sorted(order_by_name(same)) == same
    assert order_by_name([]) == []
