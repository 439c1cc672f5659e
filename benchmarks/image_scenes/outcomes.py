"""What the library makes of a scene: right, refused with the reason, wrong or lost."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace

import cv2
import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt

from fringedic import measure_displacement
from fringedic.correlation.closure import displacement_closure, refuted_points
from fringedic.errors import CorrelationError
from image_scenes.layers import Truth
from image_scenes.scenes import Pair, Scene

WINDOW, SPACING = 32, 4  # [px]
RIGHT, WRONG = 4.0, 5.0  # standard deviations
SHARE = 0.999  # of the valid points of a right scene that are within RIGHT
PRECISE = 0.1  # [px] is the largest Cramer-Rao bound of a measurable point
FOUND = 0.8  # of the measurable points of a right scene
EMPTY = 0.01  # of all points: fewer are no result
CONFIRMED = 3.0  # standard deviations of the closure
# What the message of a refusal has to name.
REASONS = {
    "stripes": r"direction|aperture|stripe",
    "too faint": r"faint|contrast|noise",
    "too fine": r"fine|faint|contrast|noise",
    "too coarse": r"coarse|wider|larger window|faint|contrast",
    "unrelated": r"same surface",
    "moved out": r"same surface|out of the image|left the image",
}
OUTCOMES = ("right", "refused", "other reason", "partially wrong", "wrong", "lost")


@dataclass(frozen=True)
class Result:
    """What was measured of a scene.

    Attributes
    ----------
    scene, texture, kind, words
        As in `Scene`; `scene` is its number.
    outcome
        One of `OUTCOMES`.
    message
        Of the refusal, if it was refused.
    points, measurable, valid
        Numbers of points: all, those that should be found, those with a displacement that the closure does not refute
        (none beside the edge of a surface, where pixels show two materials).
    refuted, needless
        Numbers of points with a displacement that the closure refutes (none beside an edge either), and of those that
        are measurable and within `RIGHT` standard deviations.
    found
        Share of the measurable points that have a displacement.
    within
        Share of the valid points within `RIGHT` standard deviations.
    wrong, confirmed
        Numbers of valid points beyond `WRONG` standard deviations, and of those that the closure confirms.
    score
        Root mean square of error over sigma of the valid points.
    seconds
        Time of the measurement and its closure.
    """

    scene: int
    texture: str
    kind: str
    words: str
    outcome: str
    message: str
    points: int
    measurable: int
    valid: int = 0
    refuted: int = 0
    needless: int = 0
    found: float = 0.0
    within: float = float("nan")
    wrong: int = 0
    confirmed: int = 0
    score: float = float("nan")
    seconds: float = 0.0


def find_measurable(pair: Pair, truth: Truth) -> np.ndarray:
    """Return the points whose window is visible as a whole, with texture enough for `PRECISE` by the noise alone.

    The Cramer-Rao bound of the worse direction for two noisy images, of a square of the window's width.
    """
    row, column = np.gradient(pair.clean)
    xx, xy, yy = (
        cv2.boxFilter(each, cv2.CV_64F, (WINDOW, WINDOW), normalize=False)[::SPACING, ::SPACING]
        for each in (column * column, row * column, row * row)
    )
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    bound = np.sqrt(2 * pair.noise**2 / np.maximum(least, 1e-9))
    whole = np.zeros(truth.visible.shape, bool)
    for layer in np.unique(truth.layer):
        own = np.pad(truth.visible & (truth.layer == layer), 1)
        whole |= SPACING * distance_transform_edt(own)[1:-1, 1:-1] >= WINDOW
    return np.asarray(whole & (bound < PRECISE))


def repeated_truth(scene: Scene, truth: Truth, field: xr.Dataset) -> Truth:
    """Return the displacement that is equal to the true one up to whole periods, where the result says that it repeats.

    Each surface has one number of periods, the nearest to the measured displacement.
    """
    stated = field.attrs.get("repeats_px")
    if scene.lattice is None or stated is None:
        return truth
    multiples = np.reshape(stated, (-1, 2)) @ np.linalg.inv(scene.lattice)
    if np.abs(multiples - np.rint(multiples)).max() > 0.1:
        return truth
    periods = np.rint(multiples) @ scene.lattice  # exactly
    y, x = np.meshgrid(field.row.values.astype(float), field.column.values.astype(float), indexing="ij")
    moved = {"x": truth.x.copy(), "y": truth.y.copy()}
    for number, layer in enumerate(scene.view.layers):
        own = (truth.layer == number) & field.valid.values
        if layer.texture is not scene.surface or not own.any():
            continue
        at = x[own], y[own]
        base = np.stack(layer.motion.forward(*at))
        # the motion carries the periods along: (1 + gradient) times each
        steps = [np.stack(layer.motion.forward(at[0] + period[0], at[1] + period[1])) - base for period in periods]
        error = [field[f"displacement_{axis}"].values[own] - getattr(truth, axis)[own] for axis in "xy"]
        whole = np.linalg.pinv(np.stack(steps, axis=1).transpose(2, 0, 1)) @ np.stack(error, axis=1)[..., None]
        shift = np.rint(np.median(whole[..., 0], axis=0)) @ periods
        for axis, place, there in zip("xy", at, layer.motion.forward(at[0] + shift[0], at[1] + shift[1]), strict=True):
            moved[axis][own] = there - place
    return replace(truth, x=moved["x"], y=moved["y"])


def measure_pair(pair: Pair) -> tuple[xr.Dataset, xr.Dataset, np.ndarray]:
    """Return the displacement of a pair, its closure and the points that this refutes, as `fringedic.images` does."""
    field = measure_displacement(pair.reference, pair.deformed, window=WINDOW, spacing=SPACING)
    closure = displacement_closure(pair.reference, pair.deformed, field)
    return field, closure, refuted_points(closure, field)


def measure(number: int) -> Result:
    """Make a scene, measure it and classify the outcome."""
    scene = Scene.random(number)
    pair, truth = scene.render(), scene.view.truth(SPACING)
    measurable = find_measurable(pair, truth)
    known = (number, scene.texture, scene.kind, scene.words)
    counts = (measurable.size, int(measurable.sum()))
    started = time.perf_counter()
    try:
        field, closure, refuted = measure_pair(pair)
    except CorrelationError as error:
        seconds = time.perf_counter() - started
        return Result(*known, judge_refusal(scene, measurable, str(error)), str(error), *counts, seconds=seconds)
    seconds = time.perf_counter() - started
    refuted &= ~truth.mixed
    valid = field.valid.values & ~truth.mixed & ~refuted
    number_valid, number_refuted = int(valid.sum()), int(refuted.sum())
    if not number_valid:
        outcome = "refused" if scene.hopeless else "lost"
        return Result(*known, outcome, "", *counts, refuted=number_refuted, seconds=seconds)
    truth = repeated_truth(scene, truth, field)
    errors = [field[f"displacement_{axis}"].values - getattr(truth, axis) for axis in "xy"]
    scores = [error / field[f"sigma_{axis}"].values for axis, error in zip("xy", errors, strict=True)]
    # where another surface is in the place of the first, every displacement is wrong
    score = np.nan_to_num(np.maximum(*np.abs(scores)), nan=np.inf)
    wrong = valid & (score > WRONG)
    found = float(valid[measurable].mean()) if measurable.any() else 1.0
    within = float(np.mean(score[valid] <= RIGHT))
    return Result(
        *known,
        judge_result(scene, float(valid.mean()), found, within),
        "",
        *counts,
        number_valid,
        number_refuted,
        int(np.count_nonzero(refuted & measurable & (score <= RIGHT))),
        found,
        within,
        int(wrong.sum()),
        count_confirmed(closure, wrong),
        float(np.sqrt(np.mean(np.square(scores)[:, valid]))),
        seconds,
    )


def judge_refusal(scene: Scene, measurable: np.ndarray, message: str) -> str:
    """Return the outcome of a scene that is refused."""
    if not scene.hopeless and measurable.mean() >= EMPTY:
        return "lost"
    causes = [scene.texture] if scene.hopeless else ["too faint", "too coarse"]
    return "refused" if any(re.search(REASONS[each], message) for each in causes) else "other reason"


def judge_result(scene: Scene, valid: float, found: float, within: float) -> str:
    """Return the outcome of a scene with a result, from the shares of its points."""
    if scene.hopeless and valid < EMPTY:
        return "refused"
    if within < SHARE:
        return "partially wrong" if within >= 0.5 else "wrong"
    return "right" if found >= FOUND or scene.hopeless else "lost"


def count_confirmed(closure: xr.Dataset, wrong: np.ndarray) -> int:
    """Return how many wrong points the closure confirms."""
    small = np.abs(closure.closure_x.values) <= CONFIRMED, np.abs(closure.closure_y.values) <= CONFIRMED
    return int(np.count_nonzero(wrong & small[0] & small[1]))
