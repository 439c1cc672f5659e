"""Animations of a map over the steps."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import origin_text
from fringedic.datasets.quantities import strain_words
from fringedic.errors import DatasetError
from fringedic.figures.maps import Scale, map_figure, redraw_map, scale_between
from fringedic.figures.panels import Panel
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

FRAMES = 60  # of longer experiments every n-th step is shown
FRAME_MS, LAST_FRAME_MS = 250, 1500
_GREYS = 40  # of the 256 colours of a GIF; all others are colours of the map, so that no artificial contours appear


def save_animation(dataset: xr.Dataset, file: str | os.PathLike[str], panel: Panel) -> Path:
    """Write a map over the steps as a GIF with one colour scale for all steps.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    file
        The GIF.
    panel
        The map.

    Raises
    ------
    DatasetError
        No step has the map.
    FringedicError
        The package ``matplotlib`` or ``pillow`` is not installed.
    """
    path = Path(file)
    path.write_bytes(animation(dataset, panel))
    return path


def animation(dataset: xr.Dataset, panel: Panel) -> bytes:
    """Return a map over the steps as a GIF; see `save_animation`."""
    with optional_import("figures"):
        from PIL import Image
    drawn = _frames(dataset, panel)
    colours = drawn.figure.axes[0].images[0].get_cmap()
    from PIL import Image

    shades = np.concatenate([colours(np.linspace(0, 1, 256 - _GREYS))[:, :3], np.linspace([0] * 3, [1] * 3, _GREYS)])
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255 * shades).astype(np.uint8).tobytes())
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in drawn.images()]
    stream = io.BytesIO()
    durations = [FRAME_MS] * (len(frames) - 1) + [LAST_FRAME_MS]
    frames[0].save(
        stream,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=durations,
        loop=0,
        comment=origin_text(dataset).encode("ascii"),
    )
    return stream.getvalue()


def animation_frames(dataset: xr.Dataset, panel: Panel) -> list[bytes]:
    """Return a map over the steps as PNG images with one colour scale, for a page that shows one after the other.

    Raises
    ------
    DatasetError
        No step has the map.
    """
    frames = []
    for image in _frames(dataset, panel).images():
        stream = io.BytesIO()
        image.quantize(256).save(stream, format="PNG", optimize=True)
        frames.append(stream.getvalue())
    return frames


@dataclass(frozen=True)
class _Frames:
    """The steps of an animation, and the figure in which one is drawn after the other."""

    dataset: xr.Dataset
    panel: Panel
    steps: list[int]
    scale: Scale
    figure: Figure

    def images(self) -> Iterator[Image.Image]:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas = FigureCanvasAgg(self.figure)
        for step in self.steps:
            if step != self.steps[0]:
                title = _title(self.dataset, step, self.panel)
                redraw_map(self.figure, self.dataset.sel(step=step), self.panel, self.scale, title=title)
            from PIL import Image

            canvas.draw()  # type: ignore[no-untyped-call]
            pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
            yield Image.fromarray(pixels).convert("RGB")


def _frames(dataset: xr.Dataset, panel: Panel) -> _Frames:
    with optional_import("figures"):
        import matplotlib  # noqa: F401
    name = panel.name
    if name not in dataset:
        steps = []
    else:
        steps = [int(step) for step in dataset["step"].values if np.isfinite(dataset[name].sel(step=step).values).any()]
    if not steps:
        raise DatasetError(f"no step has the map {panel.name}")
    steps = steps[:: -(-len(steps) // FRAMES)]
    ends = [np.nanpercentile(dataset[panel.name].sel(step=step).values, (0.5, 99.5)) for step in steps]
    scale = scale_between(dataset[panel.name], float(min(end[0] for end in ends)), float(max(end[1] for end in ends)))
    figure = map_figure(dataset.sel(step=steps[0]), panel, scale, title=_title(dataset, steps[0], panel))
    return _Frames(dataset, panel, steps, scale, figure)


def _title(dataset: xr.Dataset, step: int, panel: Panel) -> str:
    words = strain_words(dataset, panel.name)
    return f"step {step}: {panel.title}{words and f', {words}'}"
