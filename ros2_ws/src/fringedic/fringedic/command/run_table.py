"""Table of the steps of a run."""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table

from fringedic.command.outcome import RunReport


def report_table(report: RunReport) -> Table:
    """Return the steps of a run as a table.

    ``z exact`` is the error of z with the exact calibration of a virtual rig. ``lost frames`` are those that the camera
    dropped / those whose image is missing in the recording.
    """
    title = f"{report.experiment}: {report.folder}"
    if any(step.errors for step in report.steps):
        title += "; errors are RMS against the ground truth"
    if report.no_errors:
        title += f"; no errors against the ground truth: {escape(report.no_errors)}"
    table = Table(title=title, min_width=70, title_justify="left")
    with_truth = any(step.errors for step in report.steps)
    with_exact = any("z_exact" in step.errors for step in report.steps)
    table.add_column("step", justify="right")
    table.add_column(escape("position\n[mm]"), justify="right")
    table.add_column(escape("force\n[N]"), justify="right")
    table.add_column(escape("moved\n[RMS]"), justify="right")
    if with_truth:
        for name in ("u", "v", "w", "z"):
            table.add_column(escape(f"error {name}\n[µm]"), justify="right")
    if with_exact:
        table.add_column(escape("z exact\n[µm]"), justify="right")
    table.add_column(escape("valid\n[%]"), justify="right")
    table.add_column("lost\nframes", justify="right")
    table.add_column(escape("to cloud\n[s]"), justify="right")
    for step in report.steps:
        if step.error:
            table.add_row("–" if step.step < 0 else str(step.step), "failed")
            continue
        cells = [str(step.step), _figure(step.position * 1e3, 3), _figure(step.force, 2)]
        length, in_image = step.rms_displacement, step.rms_displacement_px
        cells.append(f"{in_image:.3f} px" if step.white else f"{length * 1e6:.1f} µm")
        if with_truth:
            cells += [_figure(step.errors.get(name, float("nan")), 2) for name in ("u", "v", "w", "z")]
        if with_exact:
            cells.append(_figure(step.errors.get("z_exact", float("nan")), 2))
        cells += [
            _figure(step.valid_fraction * 100, 1),
            f"{step.dropped} / {step.missing}",
            _figure(step.processing_time, 2),
        ]
        table.add_row(*cells)
    return table


def _figure(value: float, digits: int) -> str:
    return "-" if value != value else f"{value:.{digits}f}"
