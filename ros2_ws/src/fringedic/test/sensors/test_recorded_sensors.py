"""From recordings of two sensors to one report, by the commands that a user writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sensor_scene import BALLS, record, recorded_balls

from fringedic.campaign import Plan, current_plan, load_campaign, open_campaign, process_unit
from fringedic.command import main  # noqa: F401 (has the subcommands)
from fringedic.command.app import app
from fringedic.datasets import open_experiment
from fringedic.errors import CampaignError

POSITION = 3e-4


def test_balls_register_two_sensors_and_a_test_gives_one_surface_in_one_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rigs, models, balls = recorded_balls(tmp_path / "balls" / "bag")
    bag = record(tmp_path / "test" / "bag", rigs, models, [(None, 0.0), (None, POSITION)])
    app(["register", str(balls), "--balls-mm", "15", "--output", str(bag.parent)], standalone_mode=False)
    printed = " ".join(capsys.readouterr().out.split())
    assert "GO. The sensors agree within their uncertainty: 6 objects deviate by up to" in printed
    ends = {**BALLS, "centres_mm": ((-30.0, 3.0, 0.0), (30.0, -2.0, 2.0))}  # each sensor sees one of them
    known = float(np.linalg.norm(np.subtract(*ends["centres_mm"])))
    bar = record(tmp_path / "bar" / "bag", rigs, models, [(ends, 0.0)])
    check = ["check", str(bar), "--balls-mm", "15", "--registration", str(bag.parent / "registration.yaml")]
    app([*check, "--distance-mm", str(known)], standalone_mode=False)
    assert "The registration holds: 1 distance across sensors" in " ".join(capsys.readouterr().out.split())
    assert app([*check, "--distance-mm", str(known + 1.0)], standalone_mode=False) == 1
    assert "does not hold: in step 0 the distance between" in " ".join(capsys.readouterr().out.split())
    app(["process", str(bag)], standalone_mode=False)
    assert "joined surface: " in capsys.readouterr().out
    with open_experiment(bag) as joined:
        assert joined.attrs["sensor"] == "joined"
        step = joined.sel(step=1)
        for name in ("u", "v", "w"):
            assert 0.75 < np.sqrt(np.nanmean(step[f"overlap_{name}"].values ** 2)) < 1.3
        strain = POSITION / 80e-3
        several = step["sensors"].values
        error = step["e_22"].values - (strain + strain**2 / 2)
        for count in (1, 2):
            assert abs(np.nanmean(error[several == count])) < 20e-6
    app(["report", str(bag), "--output", str(tmp_path / "report.html")], standalone_mode=False)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Where two sensors overlap, their RMS difference in units of its standard deviation is: shape " in page


def test_a_campaign_joins_the_sensors_of_its_recordings(tmp_path: Path) -> None:
    """With the registration beside a recording, or that of the file; without one it names what to write."""
    rigs, models, balls = recorded_balls(tmp_path / "balls" / "bag")
    bag = record(tmp_path / "test" / "bag", rigs, models, [(None, 0.0), (None, POSITION)])
    file = tmp_path / "campaign.yaml"

    def planned(text: str) -> Plan:
        file.write_text(f"recordings: [{{path: test}}]\n{text}", "utf-8")
        return current_plan(load_campaign(file))

    [reason] = planned("").refused.values()
    assert "contains the sensors left, right: write one as 'sensor' in the file of the campaign, or as" in reason
    app(["register", str(balls), "--balls-mm", "15", "--output", str(tmp_path)], standalone_mode=False)
    plan = planned("registration: registration.yaml\n")
    assert not plan.refused
    process_unit(plan.units[0])
    app(["process", str(bag), "--registration", str(tmp_path / "registration.yaml")], standalone_mode=False)
    tree, catalogue = open_campaign(tmp_path)
    joined = tree[plan.units[0].name].dataset
    with open_experiment(bag) as by_hand:
        assert joined.attrs["sensor"] == by_hand.attrs["sensor"] == "joined"
        assert set(joined.variables) == set(by_hand.variables)
        for name in by_hand.variables:
            np.testing.assert_array_equal(joined[name].values, by_hand[name].values, str(name))
    assert catalogue["largest_strain"].item() > 0
    models["left"].to_yaml(tmp_path / "c.yaml")
    for option, words in (("calibration: c.yaml", "'calibration' is that of one"), ("segments: 2", "leave 'segments'")):
        [reason] = planned(f"registration: registration.yaml\n{option}\n").refused.values()
        assert words in reason
    file.with_name("registration.yaml").write_text("reference: left\n", "utf-8")
    with pytest.raises(CampaignError, match=r"registration .*registration\.yaml: .* is no registration of sensors"):
        load_campaign(file)
