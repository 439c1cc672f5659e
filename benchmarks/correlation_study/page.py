"""The target table and the validation page, both from the results alone."""

from __future__ import annotations

import os
import platform
import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from correlation_study.plots import save_plots
from correlation_study.results import SINE_PERIODS, Results
from correlation_study.scenes import GREY_LEVELS
from correlation_study.speed import Speed
from correlation_study.table import Row

SINE_TARGETS = (0.003, 0.0012, 0.0012)
CHALLENGE_TARGETS = (0.0031, 0.0037, 0.0043)


def target_rows(results: Results) -> list[Row]:
    """Measured figures beside the targets."""
    chosen, clean, noisy = results.chosen, results.translations[0], results.translations[GREY_LEVELS]
    at = f"window {results.window} px, 90 % transfer at {chosen.period:.1f} px"
    sine_window = results.sine_window(SINE_TARGETS)
    longest = min(results.sines, key=lambda w: results.sines[w][-1])
    errors = f"standard errors {clean.standard_error:.5f} / {noisy.standard_error:.5f}"
    product = f"{chosen.noise:.5f} x {chosen.period:.1f}"
    rows = [
        Row("resolution, 0 / 31 GL [px]", (clean.resolution, noisy.resolution), (0.0005, 0.0080), note=at),
        Row("largest bias, 0 / 31 GL [px]", (clean.bias, noisy.bias), (0.0001, 0.0005), 5, errors),
        Row("noise x period with 10 % loss [px²]", (chosen.product,), (0.35,), 3, product),
        Row("noise x period with 10 % loss, extended target [px²]", (chosen.product,), (0.32,), 3),
        Row("overshoot of the gain [%]", (100 * chosen.overshoot,), (5.0,), 2),
    ]  # fmt: skip
    if results.rivals:
        for shape, subset in results.rivals.matched.items():
            noise = results.rivals.interpolated[shape]
            rows.append(
                Row(
                    f"    pyvale {'affine' if shape == 'AFFINE' else 'quadratic'} at the same cut-off [px²]",
                    (noise * chosen.period,), (), 3, f"noise {noise:.5f}; nearest size {subset.size} px",
                )
            )  # fmt: skip
    else:
        rows.append(Row("    pyvale", (), note="it could not be installed or run here"))
    rows += [
        Row(
            "0.02 px sine of 45 / 130 / 260 px, 8 bits: RMSE [px]", tuple(results.sines[sine_window]), SINE_TARGETS,
            5, f"window {sine_window} px",
        ),
        Row("0.02 px sine of 260 px [px]", (results.sines[longest][-1],), (0.0007,), 5, f"window {longest} px"),
    ]  # fmt: skip
    if results.sample_14:
        best = best_sample_14(results.sample_14)
        for w in dict.fromkeys((results.window, best)):
            rmse = tuple(results.sample_14[w].rmse)
            rows.append(Row("sample 14, column means L1 / L3 / L5 [px]", rmse, CHALLENGE_TARGETS, 4, f"window {w} px"))
        if results.rivals and results.rivals.sample_14:
            subset = best_sample_14(results.rivals.sample_14)
            rows.append(Row(f"    {subset}, best size", tuple(results.rivals.sample_14[subset].rmse)))
    else:
        rows.append(Row("sample 14, column means L1 / L3 / L5 [px]", (), CHALLENGE_TARGETS, note="images not found"))
    for large, target in zip(results.large, (0.005, 0.0033, 0.0036), strict=True):
        note = f"{100 * large.measured:.1f} % measured, largest error {large.largest:.3f}"
        rows.append(Row(f"{large.name}, 10 GL [px]", (large.rmse,), (target,), 4, note))
    departure = np.abs(results.scores.deviation - 1)
    rows.append(
        Row("z-scores, largest difference of their standard deviation from 1", (float(departure.max()),), (0.1,), 3)
    )
    return rows


def time_rows(speeds: list[Speed]) -> list[Row]:
    """Measured times and memory beside the targets."""
    rows = []
    for one in speeds:
        targets = one.pixels < 2
        rows += [
            Row(f"{one.columns}x{one.rows}, every pixel, with sigma and validity [s]", (one.measure,),
                (0.08,) if targets else (), 3, f"fastest {one.fastest:.3f}, one thread {one.one_thread:.3f}"),
            Row("    peak memory of the process [MB]", (one.memory,), (500.0,) if targets else (), 0,
                f"{one.before:.0f} before"),
        ]  # fmt: skip
    return rows


def best_sample_14(candidates: dict) -> object:
    """Setting with the least sum of the three errors."""
    return min(candidates, key=lambda setting: float(np.sum(candidates[setting].rmse)))


def write_page(results: Results, path: Path) -> None:
    """Write the page and its plots beside it."""
    save_plots(results, path.with_suffix(""))
    text = _rendered(
        "page.md.jinja",
        r=results,
        targets=target_rows(results),
        window=results.window,
        speeds=results.speeds,
        rows=time_rows(results.speeds),
        grey_levels=GREY_LEVELS,
        sine_periods=[int(period) for period in SINE_PERIODS],
        sine_targets=SINE_TARGETS,
        best_ours=best_sample_14(results.sample_14) if results.sample_14 else None,
        folder=path.stem,
    )
    path.write_text(text)


def write_times(speeds: list[Speed], window: int, path: Path) -> None:
    """Replace the last section of the page, which contains the times."""
    text = path.read_text()
    times = _rendered("times.md.jinja", window=window, speeds=speeds, rows=time_rows(speeds))
    path.write_text(text[: text.index(times.splitlines()[0])] + times)


def window_of(path: Path) -> int:
    """Window that the page's times belong to [px]."""
    found = re.search(r"every pixel, window (\d+) px", path.read_text())
    if found is None:
        raise SystemExit(f"{path} contains no window: run the whole benchmark once, without --times")
    return int(found[1])


def _rendered(template: str, **values: object) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["px"] = lambda value, digits=4: f"{value:.{digits}f}"
    environment.filters["many"] = lambda values, digits=4: " / ".join(f"{value:.{digits}f}" for value in values)
    environment.filters["target_table"] = _target_table
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    return environment.get_template(template).render(machine=_machine(), date=date, **values)


def _target_table(rows: list[Row]) -> str:
    lines = ["| figure | measured | target | |", "|---|---:|---:|---|"]
    for row in rows:
        name = f"{row.name.strip()} ({row.note})" if row.note else row.name.strip()
        verdict = "**missed**" if row.verdict == "missed" else row.verdict
        lines.append(f"| {name} | {row.value} | {row.target} | {verdict} |")
    return "\n".join(lines)


def _machine() -> str:
    """Processor, cores, load and versions, in words."""
    import numba
    import scipy

    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    versions = f"NumPy {np.__version__}, SciPy {scipy.__version__}, Numba {numba.__version__}"
    return (
        f"{os.cpu_count()} cores of {model}, load average {os.getloadavg()[2]:.1f} over the last 15 minutes, "
        f"Python {platform.python_version()}, {versions}"
    )
