"""Phase of a real object from public fringe images. Writes docs/validation/real_fringes.md and its picture.

The images are those of kamino410/phase-shifting, sample_data/object1 (MIT), in ../shared/data or FRINGEDIC_DATA.
"""

from __future__ import annotations

import os
import sys
from datetime import date
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from fringedic.configuration.fringe_images import FringeImageDescription
from fringedic.figures.phase_images import save_phase_picture
from fringedic.images import measure_phase_images

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "validation" / "real_fringes.md"
IMAGES = Path(os.environ.get("FRINGEDIC_DATA", ROOT.parent / "shared" / "data")) / "fringes_object"
DESCRIPTIONS = ROOT / "docs" / "examples"
SMOOTH = np.s_[40:160, 450:950]  # of the wall
STEP = 12.0  # projector px between neighbours: a step of the surface or the edge of a shadow
EDGE = 5  # px


def measure(direction: str, corrected: bool) -> xr.Dataset:
    """Return the phase under fringes of one direction."""
    description = FringeImageDescription.load(DESCRIPTIONS / f"fringes_object_{direction}.yaml")
    return measure_phase_images(IMAGES, description.model_copy(update={"correct_harmonics": corrected}))


def inner(measured: xr.Dataset) -> np.ndarray:
    """Return the measured points that are more than 5 px from shadows and steps."""
    place, valid = measured.coordinate.values, measured.valid.values
    highest, lowest = (maximum_filter(np.where(valid, place, -1e9), 3), minimum_filter(np.where(valid, place, 1e9), 3))
    return np.asarray(valid & (distance_transform_edt(~((highest - lowest > STEP) | ~valid)) > EDGE))


def noise(measured: xr.Dataset) -> tuple[float, float]:
    """Return the noise on the smooth wall and the median sigma there [projector px].

    Second differences along the fringes remove the surface and the errors that follow the phase.
    """
    along = 0 if measured.attrs["direction"] == "vertical" else 1
    difference = np.diff(measured.coordinate.values[SMOOTH], n=2, axis=along)
    scale = float(measured.attrs["pitch_px"]) / (2 * np.pi)
    spread = float(np.nanmedian(np.abs(difference))) / 0.6745 / np.sqrt(6)
    return spread, float(np.nanmedian(measured.sigma.values[SMOOTH])) * scale


def row(direction: str, corrected: bool) -> tuple[str, xr.Dataset]:
    """Return a row of the table, and what it was measured from."""
    measured = measure(direction, corrected)
    inside = inner(measured)
    wrong = int(measured.other_block.values[inside].sum())
    spread, sigma = noise(measured)
    closure = float(np.nanmedian(np.abs(measured.closure))) / 0.6745
    cells = (
        direction,
        "yes" if corrected else "no",
        f"{float(measured.valid.mean()):.1%}",
        f"{wrong} of {int(inside.sum())}",
        f"{int(measured.other_block.sum())}",
        f"{float(measured.attrs['harmonic_error']):.4f}",
        f"{closure:.1f}",
        f"{spread:.3f} / {sigma:.3f} ({spread / sigma:.2f})",
    )
    return "| " + " | ".join(cells) + " |", measured


def epipolar(vertical: xr.Dataset, horizontal: xr.Dataset) -> tuple[int, float]:
    """Return the number of points with both directions and the RMS distance from their epipolar lines [projector px].

    Column and row on the projector of each camera pixel are one point in two images: without lens distortion they obey
    one fundamental matrix, which is fitted to all of them (least median of squares).
    """
    both = inner(vertical) & inner(horizontal)
    rows, columns = np.nonzero(both)
    seen = np.stack([columns, rows], axis=1).astype(float)
    lit = np.stack([vertical.coordinate.values[both], horizontal.coordinate.values[both]], axis=1).astype(float)
    few = np.random.default_rng(1).choice(len(seen), 3000, replace=False)
    matrix, _ = cv2.findFundamentalMat(seen[few], lit[few], cv2.FM_LMEDS)
    lines = np.concatenate([seen, np.ones((len(seen), 1))], axis=1) @ matrix.T
    away = np.sum(lines * np.concatenate([lit, np.ones((len(lit), 1))], axis=1), axis=1) / np.hypot(*lines[:, :2].T)
    return len(seen), float(np.median(np.abs(away))) / 0.6745


def main() -> int:
    """Measure both directions and write the page."""
    if not IMAGES.is_dir():
        print(f"no images in {IMAGES}; set FRINGEDIC_DATA", file=sys.stderr)
        return 0
    found = {key: row(*key) for key in ((d, c) for d in ("vertical", "horizontal") for c in (False, True))}
    table = "\n".join(words for words, _ in found.values())
    print(table)
    distances = [epipolar(found["vertical", each][1], found["horizontal", each][1]) for each in (False, True)]
    print(distances)
    save_phase_picture(found["vertical", True][1], PAGE.with_suffix(".png"))
    PAGE.write_text(
        f"""# Real fringes

This page shows the phase of a real object from images that another program made, and how its fringe orders are checked.
It is written by `python benchmarks/real_fringes.py`.

*Measured on {date.today()} with the public images of kamino410/phase-shifting, sample_data/object1 (MIT): two
sponges before a wall, with shadows, specular background and steps; camera 1936x1216 px of 8 bits, projector
1920x1080 px, pitches 100 and 66.7 px with three shifts, vertical and horizontal fringes, OpenCV's Gray code of
blocks of 100 px. Command: `fringedic phase FOLDER --description fringes_object_vertical.yaml`. Wrong orders:
points in another block of the Gray code than the fringes say, more than {EDGE} px from shadows and steps
(target: 1e-4 of the points), and all of them. Closure: phase of 100 px against that of 66.7 px, in standard
deviations. Noise: second differences along the fringes on the wall.*

| fringes | corrected | measured | wrong orders | with edges | harmonics [fringe] | closure | noise / sigma [px] |
|---|---|---:|---:|---:|---:|---:|---:|
{table}

![Texture, column on the projector, standard deviation and closure](real_fringes.png)

- **Orders** come from the beat of both pitches, whose own order the code gives.
- **Response.** The projector is not linear (harmonic error as of gamma 2.4 with three shifts). Higher harmonics
  and light that the sponges scatter remain after the correction.
- **Both directions.** Column and row on the projector of {distances[1][0]} points obey one fundamental matrix
  to {distances[0][1]:.2f} projector px (median-based), to {distances[1][1]:.2f} px after the correction; lens
  distortion is part of it.
- **Through the nodes.** A system test takes three images of each direction as a recorded step through camera (files),
  phase node and recorder; up to whole fringes, the recorded phase is that of the command.
- **Not measured** are lines at the edges of the blocks where a bit is neither dark nor bright, shadows, and
  points with a modulation below 4 grey levels.
"""
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
