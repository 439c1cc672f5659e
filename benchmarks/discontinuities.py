"""What counts as a discontinuity, where there is none and beside cracks. Writes docs/validation/discontinuities.md.

Surfaces are those of the virtual rig at 1280x960, cracks are exact images of speckles of 12 bits. Seeds fixed no
constant of the library.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import date
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import xarray as xr
from correlation_study.scenes import Speckle, camera
from coupling import PITCH, STRAIN_WINDOW, displacements, render

from fringedic.correlation import measure_displacement
from fringedic.rig.model import RigModel
from fringedic.surface import couple, surface_strain
from fringedic.surface.discontinuities import find_discontinuities
from fringedic.virtual_rig import VirtualRig

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "discontinuities.md"
SURFACES = ("plate", "skin", "leather")
SEEDS = (201, 202)
SPACINGS = (4, 1)
TRAVEL = 0.5  # part of the largest position
OPENINGS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0)  # [px]
CRACKED = (5, 6, 7)  # seeds
SHAPE, MIDDLE = (140, 300), 150  # [px] of the images with a crack, and its column
STRAIN, WINDOW, NOISE = 0.004, 61, 10.0
RINGS = ((20, 28), (28, 40), (40, 60))  # [px] from the crack
BORDER = 12  # points at the ends of the crack whose window of the strain is cut


def surface_rows() -> Iterator[str]:
    """Yield the shares of points that count as discontinuous and of points without strain, on continuous surfaces."""
    for name in SURFACES:
        for seed in SEEDS:
            rendered = render(VirtualRig.from_preset(name, seed=seed), TRAVEL)
            for spacing in SPACINGS:
                field = displacements(rendered, spacing)[1].field
                cloud = couple(*rendered.shapes(), field, calibration=rendered.rig, z_filter=2.0)
                measured = np.isfinite(cloud.u.values)
                found = find_discontinuities(cloud)[measured].mean()
                without = np.isnan(surface_strain(cloud, window=STRAIN_WINDOW).e_11.values[measured]).mean()
                yield f"| {name}, {seed} | {spacing} px | {100 * found:.3f} | {100 * without:.1f} |"


def crack_rows() -> Iterator[str]:
    """Yield the lines that find a crack, and the strain beside it, for each opening."""
    for opening in OPENINGS:
        lines, errors, known, sigmas = [], [], [], []
        for seed in CRACKED:
            field = cracked_displacement(opening, seed)
            cloud = flat_cloud(field)
            away = np.abs(cloud.column.values - MIDDLE)
            lines.append(find_discontinuities(cloud)[:, away <= 4].any(axis=1).mean())
            sigmas.append(np.nanmedian(field.sigma_x))
            strain = surface_strain(cloud, window=WINDOW).e_11.values[BORDER:-BORDER]
            rings = [strain[:, (away >= near) & (away < far)] for near, far in RINGS]
            errors.append([np.nanmean((ring - STRAIN - STRAIN**2 / 2) ** 2) for ring in rings])
            known.append([np.isfinite(ring).mean() for ring in rings])
        rms = 1e6 * np.sqrt(np.nanmean(errors, axis=0))
        cells = [f"{error:.0f} / {100 * part:.0f}" for error, part in zip(rms, np.mean(known, axis=0), strict=True)]
        across = 1e6 * opening / WINDOW
        yield (
            f"| {opening:g} | {opening / np.mean(sigmas):.0f} | {100 * np.mean(lines):.0f} | {' | '.join(cells)} | "
            f"{across:.0f} |"
        )


def cracked_displacement(opening: float, seed: int) -> xr.Dataset:
    """Measure a plate under uniform strain in which a straight crack opens by so many pixels."""
    surface = Speckle(SHAPE, seed)

    def half(side: int) -> np.ndarray:
        grey: np.ndarray = surface.grey(lambda x, y: (STRAIN * (x - MIDDLE) + side * opening / 2, -0.3 * STRAIN * y))
        return grey

    column = np.arange(float(SHAPE[1]))
    inside = np.abs(column - MIDDLE) <= opening / 2
    cracked = np.where(inside, 500.0, np.where(column < MIDDLE, half(-1), half(1)))
    images = camera(surface.grey(), NOISE, 1), camera(cracked, NOISE, 2)
    return measure_displacement(*images, spacing=4)


def flat_cloud(field: xr.Dataset) -> xr.Dataset:
    """Couple a displacement with a flat surface at rest, seen by a camera of this size."""
    rows, columns = SHAPE
    rig = RigModel(
        camera_width=columns,
        camera_height=rows,
        camera_distance=0.5,
        pixel_size=5e-5,
        pixel_aspect=1.0,
        principal_column=(columns - 1) / 2,
        principal_row=(rows - 1) / 2,
        projector_width=columns,
        projector_height=rows,
        projector_position=(0.2, 0.0, 0.5),
        projector_focal_length=5000.0,
        projector_principal_column=(columns - 1) / 2,
        projector_principal_row=(rows - 1) / 2,
    )
    x, y = np.meshgrid(
        rig.pixel_size * (np.arange(columns) - rig.principal_column),
        -rig.pixel_size * (np.arange(rows) - rig.principal_row),
    )
    phase = rig.phase(x, y, 0 * x, PITCH).astype(np.float32)
    shape = rig.reconstruct(phase, PITCH, np.full(SHAPE, 0.002, np.float32))
    return couple(shape, shape, field, calibration=rig, z_filter=2.0)


def main() -> None:
    """Measure both tables and write the page."""
    tables = []
    for rows in (surface_rows(), crack_rows()):
        lines = []
        for line in rows:
            print(line, flush=True)
            lines.append(line)
        tables.append("\n".join(lines))
    rings = " | ".join(f"{near} to {far} px" for near, far in RINGS)
    PAGE.write_text(
        f"""# Discontinuities

This page shows how many points count as discontinuous although nothing is, and which cracks are found. It is written by
`python benchmarks/discontinuities.py`. What counts as a discontinuity: [mechanics](../mechanics.md).

## Surfaces without a discontinuity

*Measured on {date.today()} with frames of the virtual rig, 1280x960 px, {100 * TRAVEL:g} % of the largest position,
strain over {STRAIN_WINDOW} px. Points without strain lie beside a discontinuity or at the border, where too little of
the window is measured.*

| surface, seed | points every | counted as discontinuous [%] | measured points without strain [%] |
|---|---:|---:|---:|
{tables[0]}

## Cracks

*Exact images of a speckled plate of {SHAPE[1]}x{SHAPE[0]} px, 12 bits, noise of {NOISE:g} grey levels, strain of
{100 * STRAIN:g} %, {len(CRACKED)} surfaces; a straight crack opens across the whole image. Points every 4 px, windows
of 32 px (displacement) and {WINDOW} px (strain).*

| opening [px] | opening / sigma | lines that find it [%] | {rings} | opening / window [µstrain] |
|---:|---:|---:|---:|---:|---:|---:|
{tables[1]}

By distance from the crack: RMS error of e_11 [µstrain] / share of points with a strain [%]. The last column is
the size of the error of a window across the crack. The lines at both ends of the crack have fewer neighbours that
agree: the largest share is below 100 %.
"""
    )


if __name__ == "__main__":
    main()
