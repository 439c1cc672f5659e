"""Sentences about series of images and about a phase that was measured from image files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.correlation.closure import REFUTED
from fringedic.datasets.quantities import people_unit, strain_measure_of
from fringedic.datasets.sentences import confirmation_sentence
from fringedic.frames.name_order import order_by_name
from fringedic.images.image_series import ImageSeries, MeasuredImage
from fringedic.images.remarks import ImageRemark
from fringedic.surface.strain_measures import TENSORS
from fringedic.wording.numbers import number_text

_DISPLACEMENTS = (("u", "v"), ("displacement_x", "displacement_y"))
_STRAINS = ("e_xx", "e_yy", "e_xy")
_FEW = 0.001  # of the points


def series_sentences(series: ImageSeries, dataset: xr.Dataset) -> Iterator[str]:
    """Yield points, displacement, strain and reference of a series, each with its uncertainty, remarks, and the time.

    Parameters
    ----------
    series
        From `fringedic.measure_images`.
    dataset
        Its dataset.
    """
    measured = [index for index, image in enumerate(series.images) if index and not image.error]
    fractions = dataset["valid_fraction"].values
    worst = min(measured, key=lambda index: float(fractions[index]))
    points = int(dataset.sizes["row"] * dataset.sizes["column"])
    yield (
        f"points: {points} at {len(measured)} images, {100 * float(np.mean(fractions[measured])):.1f} % measured; "
        f"worst: {series.images[worst].name}, {100 * float(fractions[worst]):.1f} %"
    )
    last = dataset.isel(step=measured[-1])
    name = series.images[measured[-1]].name
    moved = next(names for names in _DISPLACEMENTS if names[0] in dataset)
    yield f"displacement of {name}: {_medians(last, moved)}"
    parameters = json.loads(dataset.attrs["parameters"])[-1]["parameters"]["strain"]
    gauge = parameters["virtual_strain_gauge_px"]
    length = f"{gauge:g} px"
    if "pixel_size" in dataset.attrs:
        length += f" ({number_text(1e3 * gauge * float(dataset.attrs['pixel_size']))} mm)"
    measure = TENSORS[strain_measure_of(dataset)]
    yield (
        f"strain of {name}: {_medians(last, _STRAINS)}; {measure.title} ({measure.definition}), e_xy is the tensor "
        f"shear; virtual strain gauge {length}"
    )
    first = series.images[0].name
    summed = [image for image in series.images if image.increment_from]
    if not summed:
        reference = f"reference: {first} for all images"
    else:
        reference = (
            f"reference: {first}; from {summed[0].name} on the surface has changed too much, so that increments from "
            f"{', '.join(dict.fromkeys(image.increment_from for image in summed))} were summed"
        )
    yield reference
    if verdict := confirmation_sentence(dataset):
        yield verdict
    refuted = dataset["refuted_fraction"].values
    if np.nansum(refuted) > 0:
        worst = int(np.nanargmax(refuted))
        yield (
            f"refuted by it, and therefore not valid: {100 * float(np.nanmean(refuted)):.2f} % of the measured points "
            f"(beyond {REFUTED:g} sigma, or beside another motion); worst: {series.images[worst].name}, "
            f"{100 * float(refuted[worst]):.2f} %"
        )
    yield from remark_sentences(series)
    yield f"time: {series.seconds:.1f} s, {series.seconds / len(series.images):.2f} s per image"


def order_sentences(files: Sequence[Path]) -> Iterator[str]:
    """Yield that files are in alphabetical order, as shells expand a pattern, where their numbers have another order.

    Parameters
    ----------
    files
        In the order of the measurement; the first one may be a reference with a name of another kind.

    Examples
    --------
    >>> for sentence in order_sentences([Path("load_0.25.tif"), Path("load_0.tif")]):
    ...     print(sentence.split(";")[0])
    order: load_0.25.tif is before load_0.tif, as given
    """
    for given in (list(files), list(files[1:])):
        numbered = order_by_name(given)
        if given == sorted(given) and given != numbered:
            one, other = next(pair for pair in zip(given, numbered, strict=True) if pair[0] != pair[1])
            yield (
                f"order: {one.name} is before {other.name}, as given; for the order of the numbers give the folder, or "
                "the pattern in quotation marks"
            )
            return


def failure_sentences(series: ImageSeries) -> Iterator[str]:
    """Yield which images have no result, and how many were left when a person stopped the measurement."""
    for image in series.failed:
        yield f"not measured: {image.error}"


def remark_sentences(series: ImageSeries) -> Iterator[str]:
    """Yield what needs attention in the images of a series: their pixels, and what their texture does not tell."""
    by_code: dict[str, list[tuple[MeasuredImage, dict[str, float]]]] = {}
    for image in series.images:
        for remark in image.remarks:
            by_code.setdefault(remark.code, []).append((image, dict(remark.values)))
    if ImageRemark.MOSAIC in by_code:
        yield (
            f"colour mosaic: {series.images[0].name} contains the pixels of a colour sensor as they are (Bayer); all "
            "images were smoothed by 1-2-1 pixels along both axes; save them as monochrome for the full resolution"
        )
    for image, values in by_code.get(ImageRemark.DUPLICATE, []):
        yield (
            f"copy: {image.name} is identical to {series.images[int(values['step'])].name}, pixel by pixel; check the "
            "names of the files and the trigger of the camera"
        )
    if saturated := by_code.get(ImageRemark.SATURATED, []):
        worst, values = max(saturated, key=lambda each: each[1]["share"])
        yield (
            f"saturated: {100 * values['share']:.1f} % of the pixels of {worst.name} are at the lowest or highest grey "
            f"level ({len(saturated)} of {len(series.images)} images are saturated): change the exposure, or mask what "
            "is not the specimen"
        )
    yield from _texture_sentences(by_code)


def _texture_sentences(by_code: dict[str, list[tuple[MeasuredImage, dict[str, float]]]]) -> Iterator[str]:
    if repeated := by_code.get(ImageRemark.REPEATS):
        yield (
            f"periodic: the texture repeats every {repeated[0][1]['period']:.1f} px, and nothing in it decides: "
            f"displacements of {_images(repeated)} are known up to multiples of it; the smallest are given, or those "
            "that continue the image before. A random pattern, or small steps, make them certain"
        )
    if unmatched := by_code.get(ImageRemark.UNMATCHED):
        worst, values = max(unmatched, key=lambda each: each[1]["share"])
        yield (
            f"no displacement: {100 * values['share']:.0f} % of the texture of {worst.name} has none "
            f"({_images(unmatched)}): another motion, another surface, or something in front; a mask helps"
        )
    if binned := by_code.get(ImageRemark.BINNED):
        worst, values = max(binned, key=lambda each: each[1]["binning"])
        yield (
            f"averaged: the texture is coarse and faint, so that {values['binning']:.0f} x {values['binning']:.0f} "
            f"pixels of {worst.name} were averaged; the window is {values['window']:.0f} px wide ({_images(binned)}). "
            "More light or a finer pattern keep the window"
        )


def _images(remarked: Sequence[tuple[MeasuredImage, dict[str, float]]]) -> str:
    return "1 image" if len(remarked) == 1 else f"{len(remarked)} images"


def _medians(step: xr.Dataset, names: tuple[str, ...]) -> str:
    unit = people_unit(step[names[0]])
    values = ", ".join(f"{_word(name)} {number_text(_median(step, name) / unit.factor)}" for name in names)
    sigmas = [
        name
        for name in (
            (name.replace("displacement_", "displacement_sigma_") if "displacement" in name else f"sigma_{name}")
            for name in names
        )
        if name in step
    ]
    sigma = max(_median(step, name) for name in sigmas) / unit.factor
    return f"median {values} {unit.text}; 1 sigma of a point {number_text(sigma)} {unit.text}"


def _word(name: str) -> str:
    return {"displacement_x": "x (right)", "displacement_y": "y (down)", "u": "u (right)", "v": "v (up)"}.get(
        name, name
    )


def _median(step: xr.Dataset, name: str) -> float:
    return float(np.nanmedian(step[name].values))


def phase_sentences(measured: xr.Dataset) -> Iterator[str]:
    """Yield what was measured, its noise, its direction, the errors, and what the checks of the orders found.

    Parameters
    ----------
    measured
        From `fringedic.images.measure_phase_images`.
    """
    pitch = float(measured.attrs["pitch_px"])
    scale = pitch / (2 * np.pi)
    sigma = float(np.nanmedian(measured.sigma)) * scale
    yield (
        f"phase of {measured.attrs['direction']} fringes, pitch {pitch:g} px: {float(measured.valid.mean()):.1%} of "
        f"the image is measured; noise {sigma:.3f} projector px (median)"
    )
    if measured.phase.attrs["relative"]:
        yield "the phase is relative: unwrapped over the image, true up to whole fringes, and wrong behind steps"
    if _falls(measured):
        place = "column falls to the right" if measured.attrs["direction"] == "vertical" else "row falls downwards"
        yield (
            f"the projector's {place} in the image: the shifts of all pitches are listed backwards (reverse their "
            "lists), unless projector or camera is upside down or looks through a mirror"
        )
    uncertain = float(measured.attrs["uncertain_orders"])
    if uncertain > _FEW:
        yield (
            f"orders: {100 * uncertain:.1f} % of the points measured at all pitches are left out, because noise and "
            "other errors of a coarse pitch make their order uncertain: show more shifts or a pitch between them"
        )
    if measured.attrs["light_change"]:
        yield (
            f"light: it changes by {100 * float(measured.attrs['light_change']):.1f} % between the frames of a pitch "
            f"(flicker); the gain of each frame is fitted, which leaves {float(measured.attrs['light_error']):.4f} "
            "fringe RMS, contained in sigma"
        )
    error = float(measured.attrs["harmonic_error"])
    if np.isfinite(error):
        done = "corrected" if measured.attrs["harmonics_corrected"] else "correct_harmonics: true corrects it"
        size = f"{error:.4f} fringe, {error * pitch:.3f} projector px RMS"
        yield f"error by the harmonics of the response: {size}; {done}"
    if "closure" in measured:
        spread = float(np.nanmedian(np.abs(measured.closure))) / 0.6745
        yield f"closure between the two finest pitches: {spread:.1f} standard deviations (1 without systematic errors)"
    if "other_block" in measured:
        wrong = int(measured.other_block.sum())
        yield f"orders: {wrong} of {int(measured.valid.sum())} points are in another block of the Gray code"


def _falls(measured: xr.Dataset) -> bool:
    """Return whether the projector's column falls to the right, or its row downwards, at most points."""
    across = "column" if measured.attrs["direction"] == "vertical" else "row"
    return float(measured.coordinate.diff(across).median()) < 0
