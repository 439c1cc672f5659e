"""Displacement of random scenes: right, refused with the reason, wrong or lost.

Writes docs/validation/anybodys_images.md. No code of the library makes the images.
`python benchmarks/anybodys_images.py --scenes 40 --first 0` measures fewer scenes and writes nothing.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # one scene per process

import numpy as np
from image_scenes.layers import BORDER, Layer, Truth, View
from image_scenes.motions import Affine
from image_scenes.outcomes import (
    EMPTY,
    FOUND,
    OUTCOMES,
    PRECISE,
    RIGHT,
    SHARE,
    SPACING,
    WINDOW,
    WRONG,
    Result,
    find_measurable,
    measure,
    measure_pair,
)
from image_scenes.scenes import HOPELESS, KINDS, LARGE, OVERLAP, SMALL, TEXTURES, Exposure, Pair, Scene, rotation
from image_scenes.textures import Spots
from system import machine

from fringedic import measure_displacement
from fringedic.errors import CorrelationError

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "anybodys_images.md"
SCENES = 300
DEGREES = range(0, 181, 10)
LISTED = 25  # worst scenes on the page


@dataclass(frozen=True)
class Turned:
    """Measurement of a rotation in one step: found share, root mean square of error [px] and of error over sigma."""

    degrees: int
    found: float
    error: float
    score: float


PLAIN_LIGHT = Exposure(30.0, 150.0, 0.0, 1.0, (0.0, 0.0), 1.5, None)


def simple_pair(shape: tuple[int, int], degrees: float, translation: tuple[float, float]) -> tuple[Pair, Truth]:
    """Return a speckle of 4 px that turns about the middle of the image and moves."""
    centre = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    reach = 50 + max(shape) / 2 * 2**0.5
    box = (centre[0] - reach, centre[0] + reach, centre[1] - reach, centre[1] + reach)
    motion = Affine(rotation(np.radians(degrees)), centre, translation)
    view = View(shape, (Layer(Spots.speckle(4.0, box, np.random.default_rng(11)), motion),))
    scene = Scene(int(degrees), "speckle", "plain", "", view, view.layers[0].texture, PLAIN_LIGHT, None)
    return scene.render(), view.truth(SPACING)


def measure_rotation(degrees: int) -> Turned:
    """Measure one rotation."""
    pair, truth = simple_pair(SMALL, degrees, (1.3, -0.6))
    try:
        field, _, refuted = measure_pair(pair)
    except CorrelationError:
        return Turned(degrees, 0.0, float("nan"), float("nan"))
    valid = field.valid.values & ~refuted
    errors = np.stack([field[f"displacement_{axis}"].values - getattr(truth, axis) for axis in "xy"])[:, valid]
    sigma = np.stack([field[f"sigma_{axis}"].values for axis in "xy"])[:, valid]
    found = float(valid[find_measurable(pair, truth)].mean())
    error, score = (float(np.sqrt(np.mean(each**2))) for each in (errors, errors / sigma))
    return Turned(degrees, found, error, score)


def measure_time(shape: tuple[int, int], repeats: int = 9) -> float:
    """Return the median time [s] of a small translation."""
    pair, _ = simple_pair(shape, 0.0, (1.3, -0.6))
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        measure_displacement(pair.reference, pair.deformed, window=WINDOW, spacing=SPACING)
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds)


def line(result: Result) -> str:
    """Return the line of a scene."""
    figures = f"found {100 * result.found:.1f} %"
    if result.valid:
        figures += (
            f", within {RIGHT:g} sigma {100 * result.within:.2f} %, beyond {WRONG:g} sigma {result.wrong} of "
            f"{result.valid} (confirmed {result.confirmed}), refuted {result.refuted} "
            f"(measurable and right {result.needless}), z {result.score:.2f}"
        )
    what = f"{result.texture}, {result.kind}: {result.words}"
    return f"{result.scene} {result.outcome}: {what}; {figures}; {result.seconds:.2f} s{_reason(result)}"


def _reason(result: Result) -> str:
    return f"; {result.message}" if result.message else ""


def measure_scenes(numbers: range, workers: int) -> list[Result]:
    """Measure scenes and print a line about each, with the remaining time."""
    started, results = time.perf_counter(), []
    with ProcessPoolExecutor(workers) as pool:
        for result in pool.map(measure, numbers):
            results.append(result)
            left = (time.perf_counter() - started) / len(results) * (len(numbers) - len(results)) / 60
            print(f"[{len(results)}/{len(numbers)}, {left:.1f} min left] {line(result)}", flush=True)
    return results


def tally(results: Iterable[Result], by: str, names: Iterable[str]) -> str:
    """Return the rows of a table of outcomes by kind of texture or of scene."""
    rows, results = [], list(results)
    for name in [*names, ""]:
        chosen = [each for each in results if name in ("", getattr(each, by))]
        if chosen:
            counts = Counter(each.outcome for each in chosen)
            good = counts["right"] + counts["refused"]
            cells = [
                name or "all",
                len(chosen),
                *(counts[each] for each in OUTCOMES),
                f"{100 * good / len(chosen):.0f} %",
            ]
            rows.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(rows)


def tables(results: list[Result]) -> str:
    """Return both tables of outcomes."""
    heading = f"| {{}} | scenes | {' | '.join(OUTCOMES)} | right or refused |\n|---|{'---:|' * (len(OUTCOMES) + 2)}\n"
    return (
        f"{heading.format('texture')}{tally(results, 'texture', TEXTURES | HOPELESS)}\n\n"
        f"{heading.format('scene')}{tally(results, 'kind', KINDS)}"
    )


def targets(results: list[Result], turned: list[Turned], seconds: list[float]) -> str:
    """Return the table of figures with their targets."""
    good = sum(each.outcome in ("right", "refused") for each in results)
    valid, wrong, confirmed, refuted, needless = (
        sum(getattr(each, name) for each in results) for name in ("valid", "wrong", "confirmed", "refuted", "needless")
    )
    found = sum(each.found >= FOUND for each in turned)
    seen = [each for each in turned if each.found > 0]
    worst = max(each.error for each in seen) / turned[0].error
    low, high = (limit(each.score for each in seen) for limit in (min, max))
    rows = [
        ("scenes that are right or refused with the reason", f"{100 * good / len(results):.1f} %", "≥ 99 %"),
        (f"valid points wrong by more than {WRONG:g} sigma", f"{100 * wrong / max(valid, 1):.3f} %", "≤ 0.01 %"),
        ("of these confirmed by the closure", f"{confirmed} of {wrong}", "0"),
        (
            f"points refuted by the closure, and of these measurable and within {RIGHT:g} sigma",
            f"{refuted} of {valid + refuted}, {needless}",
            "",
        ),
        (f"rotations of {DEGREES[0]} to {DEGREES[-1]} degrees that are found", f"{found} of {len(turned)}", "all"),
        ("RMS error over that without rotation, largest", f"{worst:.2f}", "≤ 1.5"),
        ("z of the rotations", f"{low:.2f} to {high:.2f}", "0.9 to 1.1"),
    ]
    rows += [
        (f"time of a small translation, {shape[1]}x{shape[0]} px, one thread", f"{each:.2f} s", "")
        for shape, each in zip((SMALL, LARGE), seconds, strict=True)
    ]
    lines = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"| figure | measured | target |\n|---|---:|---:|\n{lines}"


def worst_scenes(results: list[Result]) -> str:
    """Return the table of the scenes that are neither right nor refused with the reason."""
    order = ("wrong", "partially wrong", "lost", "other reason")
    bad = [each for each in results if each.outcome in order]
    bad.sort(key=lambda each: (order.index(each.outcome), -each.wrong, each.found))
    rows = [
        f"| {each.scene} | {each.outcome} | {each.texture}, {each.kind}: {each.words} | {100 * each.found:.0f} % | "
        f"{each.wrong} of {each.valid} | {each.confirmed} |"
        for each in bad[:LISTED]
    ]
    if not rows:
        return "All scenes are right or refused with the reason."
    more = f"\n\n{len(bad) - LISTED} more are not listed." if len(bad) > LISTED else ""
    heading = (
        f"| number | outcome | scene | found | beyond {WRONG:g} sigma | confirmed |\n|---:|---|---|---:|---:|---:|\n"
    )
    return heading + "\n".join(rows) + more


def page(results: list[Result], turned: list[Turned], seconds: list[float], computer: str) -> str:
    """Return the page."""
    return f"""# Images of any kind: measured figures

This page shows how often the displacement of a random scene is right, how often a scene that cannot be measured is
refused with its reason, and which scenes fail. It is written by `python benchmarks/anybodys_images.py`. No code of the
library makes the images: every pixel is the mean of the brightness of the material at Gauss points of its area, found
by exact inverse maps.

*{len(results)} scenes of {SMALL[1]}x{SMALL[0]} px, one in ten of {LARGE[1]}x{LARGE[0]} px, 8 bits; window {WINDOW} px,
spacing {SPACING} px, no prediction, one step; points that the independent closure refutes are not valid, as in
`fringedic.images`. Noise 0.3 to 4 grey levels, contrast 30 to 170 and at least 15 times the noise, another light in
the deformed image, JPEG (quality 60 to 95) in a quarter of the scenes.
Measured on {computer}.*

## Figures

{targets(results, turned, seconds)}

Rotations: speckle of 4 px, contrast 150, noise 1.5 grey levels, every 10 degrees.

## Outcomes

{tables(results)}

- **Right:** at least {100 * SHARE:.1f} % of the valid points are within {RIGHT:g} standard uncertainties of the exact
  displacement, and at least {100 * FOUND:.0f} % of the measurable points are valid. A point is measurable if the
  material around it is visible for {WINDOW} px in both images and the Cramer-Rao bound of its window is below
  {PRECISE:g} px (from the gradients of the exact reference and the noise). Points that are hidden in the deformed image
  count with the motion of their material. Pixels within {BORDER:g} px of a border show both sides and are not judged.
- **Refused:** nothing can be measured, and the message names the reason, or less than {100 * EMPTY:.0f} % of the points
  are valid. **Other reason:** the message names another one.
- **Partially wrong, wrong:** fewer valid points are within {RIGHT:g} standard uncertainties; in wrong scenes less than
  half of them.
- **Lost:** the scene is measurable, but refused, or less than {100 * FOUND:.0f} % of the measurable points are valid.

## Scenes

- **Textures:** speckle, random spots 2 to 25 px wide at half of their ink; grid, weave and dots with a pitch of 8 to
  24 px; skin, plateaus of 10 to 30 px between furrows, with a faint grain.
- **Lattices:** half of the grids, weaves and dots are perfect. A displacement that differs by whole periods is right if
  the result states the periods (attribute `repeats_px`); each surface may differ by one number of them, carried along
  by its motion. The others have an irregularity of 4 to 15 % of the contrast, or dots out of place by up to 15 to 30 %
  of the pitch; there the displacement has to be the true one.
- **Not measurable:** stripes of one direction; a contrast below the noise, also because the spots are only 0.4 to
  0.6 px wide; spots of 150 to 250 px; another surface; a translation beyond the image.
- **Plain:** rotation to 180 degrees, strain to 60 %, translation to 300 px (lattices to 15 degrees and 5 %). At least
  {100 * OVERLAP:.0f} % of the reference remain in the image. In 40 % of the scenes a wave of 0.3 to 3 px and 320 to
  700 px.
- **Part moved:** a part moves by 2 to 60 px, turns by up to 8 degrees, stretches by up to 5 %; the rest is still in
  60 % of the scenes. What the part reveals is another surface with the same kind of texture.
- **Occluder:** a cable or a tool, with or without a texture, moves in front by 2 to 40 px.
- **Crack:** it opens by 1 to 12 px across the image, and slides by up to 10 px, or to a tip. Inside it is
  dark, without texture.

To make one scene again, start Python in `benchmarks/`:

```python
from image_scenes.scenes import Scene

scene = Scene.random(17)
pair = scene.render()  # pair.reference, pair.deformed
truth = scene.view.truth()  # truth.x, truth.y [px] at every pixel of the reference, truth.visible
```

`python benchmarks/anybodys_images.py --first 17 --scenes 1` measures it.

## Failures

{worst_scenes(results)}
"""


def main() -> None:
    """Measure the scenes, print the tables and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=SCENES, help="other numbers do not write the page")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene; others do not write the page")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    results = measure_scenes(range(arguments.first, arguments.first + arguments.scenes), arguments.workers)
    print(tables(results), flush=True)
    turned = [measure_rotation(degrees) for degrees in DEGREES]
    seconds = [measure_time(shape) for shape in (SMALL, LARGE)]
    print(f"\n{targets(results, turned, seconds)}\n\n{worst_scenes(results)}")
    if (arguments.scenes, arguments.first) == (SCENES, 0):
        PAGE.write_text(page(results, turned, seconds, machine()), encoding="utf-8")


if __name__ == "__main__":
    main()
