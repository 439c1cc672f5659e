"""Evaluations and exports through the server: computed by the command, one at a time, and never over the results."""

from __future__ import annotations

import io
import json
import shutil
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from served import Answer, Site, served

from fringedic.datasets import process_bag
from fringedic.datasets.opening import RESULTS

RECORDED = Path(__file__).parents[2] / "recordings" / "version_0_1" / "bag"
SETTINGS = {"overrides": {"dic.window": 40}, "note": "less noise"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("served")
    shutil.copytree(RECORDED, folder / "bag")
    process_bag(folder / "bag", output=folder / f"{RESULTS}.nc")
    with served(folder) as running:
        running.answer_s = 120.0  # a preview is answered when it is measured
        yield running


@pytest.fixture(scope="module")
def cookie(site: Site) -> str:
    return site.login()


def post(site: Site, path: str, content: Any, cookie: str) -> Answer:
    headers = {"Cookie": cookie, "Origin": site.origin, "Content_Type": "application/json"}
    return site.request("POST", f"/evaluations/{path}", json.dumps(content), **headers)


def listed(site: Site, cookie: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(site.get("/evaluations/run", cookie).body)
    return found


def test_an_evaluation_is_made_beside_the_results_and_opened(site: Site, cookie: str) -> None:
    results = (site.rig.folder / f"{RESULTS}.nc").read_bytes()
    assert listed(site, cookie)["settings"]["window"] == 32
    with site.stream(cookie):
        answer = post(site, "run", {"name": "coarse", "settings": SETTINGS}, cookie)
        assert answer.message == "coarse is computed; the results of the run stay as they are"
        other = site.login()
        assert "drives" in post(site, "run", {"name": "x", "settings": {}}, other).message
        assert "another evaluation" in post(site, "run", {"name": "x", "settings": {}}, cookie).message
        until = time.monotonic() + 300
        while listed(site, cookie)["job"]["state"] == "runs":
            assert time.monotonic() < until
            time.sleep(0.3)
        found = listed(site, cookie)
        assert (found["job"]["state"], found["job"]["words"]["template"]) == ("done", "{name} is complete")
        assert [(each["name"], each["report"]) for each in found["evaluations"]] == [("coarse", True)]
        assert found["evaluations"][0]["settings"]["overrides"] == {"dic.window": 40}
        assert "exists already" in post(site, "run", {"name": "coarse", "settings": {}}, cookie).message
    report = site.get("/evaluations/run/coarse/report", cookie)
    assert b"Evaluation coarse: dic.window = 40; less noise" in report.body
    assert report.headers["content-security-policy"].startswith("sandbox")
    assert (site.rig.folder / f"{RESULTS}.nc").read_bytes() == results


def test_an_evaluation_that_cannot_be_started_has_failed(site: Site, cookie: str) -> None:
    with site.stream(cookie):
        post(site, "run", {"name": "x", "settings": {"note": "less\0noise"}}, cookie)
        until = time.monotonic() + 30
        while (job := listed(site, cookie)["job"])["state"] == "runs":
            assert time.monotonic() < until
            time.sleep(0.1)
    assert (job["name"], job["state"]) == ("x", "failed")
    assert "cannot be started" in job["words"]


def test_a_step_is_previewed_and_exported(site: Site, cookie: str) -> None:
    found = json.loads(post(site, "run/preview", {"step": 1, "settings": SETTINGS}, cookie).body)
    assert {row["quantity"] for row in found["rows"]} >= {"measured points", "mean w"}
    assert site.get("/preview/after", cookie).body.startswith(b"\x89PNG")
    answer = site.get("/export/run?format=csv&step=1&evaluation=", cookie)
    assert 'filename="run_csv.zip"' in answer.headers["content-disposition"]
    with zipfile.ZipFile(io.BytesIO(answer.body)) as archive:
        names = archive.namelist()
        assert any(name.endswith("step_001.csv") for name in names)
        assert not any(name.endswith("step_000.csv") for name in names)


@pytest.mark.parametrize(
    ("path", "content", "words"),
    [
        ("nothing/preview", {"step": 1, "settings": {}}, "there is no test nothing"),
        ("run/preview", {"step": 1, "settings": {"overrides": {"dic.window": {"a": 1}}}}, "settings.overrides"),
        ("run/preview", {"step": 1, "settings": {"command": "x"}}, "settings.command"),
    ],
)
def test_what_cannot_be_computed_is_refused_by_a_sentence(
    site: Site, cookie: str, path: str, content: Any, words: str
) -> None:
    answer = post(site, path, content, cookie)
    assert answer.status == 409
    assert words in answer.message


def test_nothing_is_computed_while_a_test_runs(site: Site, cookie: str) -> None:
    site.rig.occupied = "a test runs"
    try:
        assert post(site, "run/preview", {"step": 1, "settings": {}}, cookie).message == "a test runs"
        assert site.get("/export/run?format=csv", cookie).message == "a test runs"
    finally:
        site.rig.occupied = ""
    assert site.get("/export/run?format=exe", cookie).status == 409
    assert site.get("/preview/..%2Fsecret", cookie).status in (404, 409)
    assert "no evaluation" in site.get("/evaluations/run/none/report", cookie).message
