"""First page of a report: figures against known ones, the template of a laboratory, and how it prints."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from aligned_rig import aligned_rig
from PIL import Image
from playwright.sync_api import sync_playwright

from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import ConfigurationError
from fringedic.metadata import Metadata
from fringedic.report import write_report
from fringedic.report.printing import print_page
from fringedic.signals import SignalValue, signals_of
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.recorded_parameters import StepSettings

ROWS, COLUMNS, SPACING, PIXEL = 30, 40, 2, 1e-4
MODULUS, SECTION, SIGMA = 3.0e9, 10e-6, 1e-4  # [Pa], [m²], noise of a strain
SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="60" height="20"><rect width="60" height="20"/></svg>'
LABORATORY = """
name: Testing <House> & Sons
address: [Long Street 1, 12345 Town]
logo: {logo}
title: Test certificate
details: {{Order of: customer, Test: test_number, Piece: number, Charge: material}}
signatures: [Operator, Head of the laboratory, Witness]
statement: Valid for the tested specimen only.
"""


PAPER = 680  # [px] between the margins of A4
# Elements that reach beyond the page and do not lie in a part that scrolls
BEYOND = """width => [...document.querySelectorAll("body *")].filter(each => {
  const box = each.getBoundingClientRect();
  return box.width > 0 && box.right > width + 1 && !each.closest(".wide, pre, .modebar-container, svg svg, defs")
    && !each.closest("g");
}).map(each => `${each.tagName}.${each.getAttribute("class")} ${each.getBoundingClientRect().right}`)"""


def dataset_of(folder: Path, strain: float, steps: int = 6) -> Path:
    """A tension test along y up to a strain, in equal steps, with noise."""
    metadata = Metadata.from_text(
        "specimen: {name: plate, number: A-7, customer: '<b>Smith</b>', test_number: T 12, section_mm2: 10.0, "
        "youngs_modulus_gpa: 3.0, poisson_ratio: 0.3}"
    )
    parameters = {
        "phase": PhaseParameters(),
        "dic": DicParameters(spacing=SPACING, window=24),
        "coupling": CouplingParameters(strain_window_px=41),
    }
    rig = aligned_rig((80, 60), PIXEL, (100, 75), 400.0, projector_position=(-0.3, 0.0, 0.4))
    settings = StepSettings(parameters, rig, {"camera": {"source": "files"}}, metadata)
    generator = np.random.default_rng(2)
    row, column = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = PIXEL * SPACING * (column - 20), -PIXEL * SPACING * (row - 15)
    with DatasetWriter(folder / "plate.nc", {"experiment": "plate", "source": "bag"}) as writer:
        writer.add_signals(signals_of([]).values())
        for step in range(steps):
            e = strain * step / (steps - 1)
            maps = {"x": x, "y": y, "z": 0.1 * x, "shape_z": 0.1 * x, "u": -0.3 * e * x, "v": e * y, "w": 0 * x}
            maps |= {"e_12": 0 * x, "displacement_x": 0 * x, "displacement_y": 0 * x, "texture": 90 + 0 * x}
            for name, value in {"e_11": -0.3 * e, "e_22": e}.items():
                maps[name] = value + generator.normal(0, SIGMA, x.shape) * (step > 0)
                maps[f"sigma_{name}"] = SIGMA + 0 * x
            measured = {name: each.astype(np.float32) for name, each in maps.items()}
            line = Row(step, 1_700_000_000_000_000_000 + step * 10**9, "", 0, 0, 0.9, 1e-5 * step, measured)
            line.signals = {"force": SignalValue(MODULUS * SECTION * e), "position": SignalValue(1e-4 * step)}
            writer.add(line, settings)
    return folder / "plate.nc"


def cells(page: str) -> dict[str, str]:
    """The values of the first page by their names."""
    first = page.split('class="certificate"')[1].split("</section>")[0]
    return dict(re.findall(r'<(?:td class="name"|dt)>([^<]*)</(?:td|dt)><(?:td|dd)>(.*?)</(?:td|dd)>', first))


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A test up to 4 % of strain, with the template of a laboratory in the folder above."""
    folder = tmp_path_factory.mktemp("laboratory")
    Image.new("RGB", (30, 10)).save(folder / "logo.png")
    (folder / "laboratory.yaml").write_text(LABORATORY.format(logo="logo.png"))
    (folder / "run").mkdir()
    return dataset_of(folder / "run", 0.04)


@pytest.fixture(scope="module")
def page(large: Path) -> Path:
    return write_report(large)


def test_first_page_states_force_strain_and_modulus_with_uncertainty(page: Path) -> None:
    """The true values within five standard uncertainties, which are those of the noise."""
    found = cells(page.read_text("utf-8"))
    assert found["maximum force"] == "1200 N"
    value, sigma = map(float, re.fullmatch(r"([\d.]+) ± ([\d.]+) %", found["mean strain e_22 (up)"]).groups())
    assert abs(value - 4) < 5 * sigma
    assert sigma < 0.01
    value, sigma = map(float, re.fullmatch(r"([\d.]+) ± ([\d.]+) GPa", found["modulus of elasticity"]).groups())
    assert abs(value - 3) < 5 * sigma
    assert sigma < 0.02
    value, sigma = map(float, re.fullmatch(r"([\d.]+) ± ([\d.]+)", found["Poisson&#39;s ratio"]).groups())
    assert abs(value - 0.3) < 5 * sigma
    assert found["steps measured"] == "6 of 6 steps"
    assert found["strain measure"].startswith("Green-Lagrange")
    assert "not known" in found["check of the calibration"]


def test_first_page_follows_the_template_of_the_laboratory_and_escapes_it(page: Path) -> None:
    text = page.read_text("utf-8")
    found = cells(text)
    assert list(found)[:4] == ["Order of", "Test", "Piece", "Charge"]
    assert [found[name] for name in ("Order of", "Test", "Piece")] == ["&lt;b&gt;Smith&lt;/b&gt;", "T 12", "A-7"]
    assert "Testing &lt;House&gt; &amp; Sons" in text
    assert "<h1>Test certificate: plate</h1>" in text
    assert 'class="logo" alt="logo of the laboratory" src="data:image/png;base64,' in text
    assert text.count(": name, date, signature") == 3
    assert "Stress: plane stress of an isotropic elastic material" in text


def test_strains_above_one_percent_are_in_percent(page: Path, tmp_path: Path) -> None:
    text = page.read_text("utf-8")
    charts = text.split('id="curves"')[1]
    assert '"text":"strain [%]"' in charts
    assert "µstrain" not in charts.split('id="steps"')[0]
    small = write_report(dataset_of(tmp_path, 0.004, steps=2)).read_text("utf-8")
    assert '"text":"strain [\\u00b5strain]"' in small
    found = cells(small)
    assert "µstrain" in found["mean strain e_22 (up)"]
    assert "not known" in found["modulus of elasticity"], "of two steps"
    assert found["Customer"] == "&lt;b&gt;Smith&lt;/b&gt;"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nmae: x", "nmae: unknown key; known are name, address, logo"),
        ("details: {Test: number_of_test}", "details.Test: Input should be 'customer', 'test_number'"),
        ("logo: none.png", "the logo cannot be read: No such file"),
        ("logo: laboratory.yaml", "is no PNG, JPEG or SVG picture"),
        ("logo: large.png", "the logo has 600 kB, at most 500 are allowed"),
        ("name: [1", "is not YAML"),
    ],
)
def test_a_template_that_cannot_be_used_is_refused_by_name_or_told(
    large: Path, tmp_path: Path, text: str, words: str
) -> None:
    (tmp_path / "laboratory.yaml").write_text(text)
    (tmp_path / "large.png").write_bytes(bytes(600_000))
    with pytest.raises(ConfigurationError, match=re.escape(words)):
        write_report(large, tmp_path / "x.html", laboratory=tmp_path / "laboratory.yaml")


def test_a_run_with_a_damaged_template_has_its_report(large: Path, tmp_path: Path) -> None:
    shutil.copy(large, tmp_path / "plate.nc")
    (tmp_path / "laboratory.yaml").write_text("logo: none.png")
    text = write_report(tmp_path / "plate.nc").read_text("utf-8")
    assert "the settings of the laboratory are not used: " in text
    (tmp_path / "logo.svg").write_text(SVG)
    (tmp_path / "laboratory.yaml").write_text("logo: logo.svg")
    text = write_report(tmp_path / "plate.nc", overwrite=True).read_text("utf-8")
    assert 'src="data:image/svg+xml;base64,' in text


@pytest.mark.browser
def test_report_prints_on_a4_with_the_certificate_on_its_own_page(page: Path, tmp_path: Path) -> None:
    pdf = print_page(page, tmp_path / "page.pdf")
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf.read_bytes())
    assert {(round(float(width)), round(float(height))) for width, height in boxes} == {(595, 842)}
    if shutil.which("pdftotext") is None:
        pytest.skip("poppler-utils is not installed: sudo apt-get install poppler-utils")
    text = subprocess.run(["pdftotext", "-layout", pdf, "-"], check=True, capture_output=True, text=True).stdout
    first, second, *others = text.split("\f")[:-1]
    assert "Test certificate: plate" in first
    assert "Witness: name, date, signature" in first
    assert "report of 20" in first
    assert second.strip().startswith("Warnings")
    subprocess.run(["pdftoppm", "-r", "20", "-png", pdf, tmp_path / "page"], check=True)
    pages = sorted(tmp_path.glob("page-*.png"))
    assert len(pages) == len(others) + 2 <= 14
    for each in pages:
        inked = np.asarray(Image.open(each).convert("L")) < 240
        assert inked.mean() > 0.005, f"{each.name} is blank"
    heads = [each for each in others if "Analysis" in each and "value" in each]
    assert len(heads) >= 1, "a table that goes on has its heading again"


@pytest.mark.browser
def test_nothing_leaves_the_page_at_700_px_and_on_paper(large: Path, tmp_path: Path) -> None:
    """A chart, a picture or a table that is wider than its page would be cut on paper."""
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed: sudo apt-get install chromium")
    gauges = {f"gauge {k}": ((20, 10), (20, 40 + k)) for k in range(3)}
    wide = write_report(large, tmp_path / "wide.html", gauges=gauges)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for width, medium in ((700, "screen"), (320, "screen"), (PAPER, "print")):
            shown = browser.new_page(viewport={"width": width, "height": 1000})
            shown.emulate_media(media=medium)
            shown.goto(wide.as_uri())
            shown.wait_for_selector(".js-plotly-plot .main-svg", state="attached")
            assert shown.evaluate(BEYOND, width) == [], f"{width} px, {medium}"
            if medium == "print":  # on paper nothing scrolls
                assert shown.evaluate(BEYOND.replace(".wide, ", ""), width) == []
            shown.close()
        browser.close()


@pytest.mark.browser
def test_without_webgl_the_surface_is_a_picture(page: Path) -> None:
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed: sudo apt-get install chromium")
    with sync_playwright() as playwright:
        for arguments, is_picture in ((["--disable-gpu", "--disable-3d-apis"], True), ([], False)):
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", *arguments])
            shown = browser.new_page()
            shown.goto(page.as_uri())
            has_webgl = shown.evaluate("!!document.createElement('canvas').getContext('webgl')")
            assert shown.locator("#view .paper").is_visible() is not has_webgl
            assert is_picture is False or not has_webgl
            browser.close()
