"""Displacement and strain of a series of images, without a rig: one dataset, written image by image."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import numpy as np
import xarray as xr
from pydantic import Field

from fringedic.correlation import grey_residual
from fringedic.correlation.closure import refuted_points
from fringedic.datasets.confirmation import confirmed_fraction
from fringedic.datasets.quantities import layout_of_images
from fringedic.datasets.rows import Row, displacement_maps
from fringedic.datasets.stores import dataset_path
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import DatasetError, FringedicError, ImageError, reason_of
from fringedic.frames.files import image_files, read_grey, require_size
from fringedic.frames.mosaic import has_mosaic, smooth_mosaic
from fringedic.images.remarks import SATURATED_SHARE, ImageRemark, field_remarks, saturated_share
from fringedic.metadata import Metadata
from fringedic.steps.closures import ClosureChecks, closure_maps
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import DicParameters, Parameters
from fringedic.steps.recorded_parameters import StepSettings
from fringedic.steps.remarks import Remark
from fringedic.steps.statistics import measured_part_and_rms
from fringedic.steps.step_results import DicResult
from fringedic.surface.flat import flat_strain
from fringedic.surface.planes import WIDEST_WINDOW
from fringedic.surface.strain_measures import GREEN_LAGRANGE, TENSORS, strain_attributes
from fringedic.wording.arguments import array, check_arguments, number, one_of, optional, path, several, whole

STRAIN_WINDOW = 41  # [px], by default
_ALL = "images"  # name of the experiment for the tracker


class StrainParameters(Parameters):
    """Parameters of the strain of flat specimens."""

    strain_window_px: int = Field(description="Width of the window of the strain [px].")
    strain_measure: str = Field(GREEN_LAGRANGE, description="Measure of the strain.")
    virtual_strain_gauge_px: float | None = Field(None, description="Length that a value is measured over [px].")


class MeasuredImage(NamedTuple):
    """What is known of an image after its measurement, for the progress.

    Attributes
    ----------
    step
        Its number, 0 for the reference.
    name
        Of its file.
    error
        Why it has no result; empty when it has one.
    increment_from
        Name of the image that it was compared with when that is not the reference; otherwise empty.
    remarks
        What needs attention in it, measured or not, with the codes of `fringedic.images.remarks.ImageRemark`.
    """

    step: int
    name: str
    error: str = ""
    increment_from: str = ""
    remarks: tuple[Remark, ...] = ()


@dataclass
class ImageSeries:
    """Outcome of `measure_images`.

    Attributes
    ----------
    dataset
        The file.
    images
        The images up to the last one that was measured or failed, the reference first.
    interrupted
        Whether a person stopped the measurement before the last image.
    seconds
        Duration [s].
    """

    dataset: Path
    images: list[MeasuredImage] = field(default_factory=list)
    interrupted: bool = False
    seconds: float = float("nan")

    @property
    def failed(self) -> list[MeasuredImage]:
        """The images without a result."""
        return [image for image in self.images if image.error]


@check_arguments(
    DatasetError,
    images=several(path, least=1),
    output=path,
    window=whole(8, 256),
    spacing=whole(1, 256),
    strain_window=whole(high=WIDEST_WINDOW),
    strain_measure=one_of(*TENSORS),
    pixel_size=optional(number(1e-12)),
    mask=optional(array(2)),
)
def measure_images(  # noqa: PLR0913 (options of a public function, all by keyword)
    images: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    *,
    window: int = 32,
    spacing: int = 4,
    strain_window: int = STRAIN_WINDOW,
    strain_measure: str = GREEN_LAGRANGE,
    pixel_size: float | None = None,
    mask: np.ndarray | None = None,
    metadata: Metadata | None = None,
    overwrite: bool = False,
    progress: Callable[[MeasuredImage, int], None] | None = None,
) -> ImageSeries:
    """Measure displacement and strain of a series of images of a flat specimen against the first one.

    Each image is compared with the first one, so that errors do not add up. When the surface has changed so much that
    too few points agree, the latest good image becomes the new reference and the increments are summed. An image that
    cannot be measured has its reason in the variable ``error``, and the series goes on. After Ctrl-C the dataset holds
    the images that were measured.

    Points that the independent check refutes, as beside a cable in front of the surface or a crack, are not valid: they
    are NaN, the strain is computed without them, and ``refuted_fraction`` is their share. Copies of an image,
    saturation and the colour mosaic of a sensor have a remark (``remarks``); a mosaic is smoothed in all images.

    Parameters
    ----------
    images
        The reference, then the others in order; a folder stands for its images by number.
    output
        The dataset, ``.nc`` or ``.zarr``, for `fringedic.open_experiment`.
    window, spacing
        As of `fringedic.measure_displacement` [px].
    strain_window
        Width of the window of the strain [px].
    strain_measure
        ``"green-lagrange"``, ``"logarithmic"`` or ``"engineering"``, see `fringedic.surface.flat_strain`.
    pixel_size
        Size of a pixel on the specimen [m]; None keeps lengths in pixels.
    mask
        Booleans (row, column), True where the surface is measured; None: all of the image.
    metadata
        Specimen and virtual extensometers for the report.
    overwrite
        Replace an existing dataset.
    progress
        Called after each image with it and the number of all images.

    Returns
    -------
    ImageSeries
        File and images.

    Raises
    ------
    ImageError
        There are fewer than two images, or the reference cannot be read.
    FringedicError
        The settings do not fit the images, or none of them shows the surface of the reference.
    DatasetError
        The output exists or cannot be written.

    Examples
    --------
    >>> series = measure_images(["before.tif", "after.tif"], "stretched.nc", pixel_size=50e-6)  # doctest: +SKIP
    >>> dataset = fringedic.open_experiment(series.dataset)  # doctest: +SKIP
    """
    files = image_files(Path(each) for each in images)
    if len(files) < 2:
        raise ImageError("give a reference image and at least one deformed image")
    target = dataset_path(files[0], output, overwrite)
    reference = read_grey(files[0])
    if mask is not None and mask.shape != reference.shape:
        raise ImageError(
            f"the mask has {mask.shape[1]}x{mask.shape[0]} px, the images have "
            f"{reference.shape[1]}x{reference.shape[0]} px: give a mask of the same size"
        )
    if 3 * spacing > min(reference.shape):
        raise ImageError(
            f"spacing is {spacing} px, and the images have {reference.shape[1]}x{reference.shape[0]} px: give at most "
            f"{min(reference.shape) // 3}"
        )
    measuring = _Measuring(
        window,
        spacing,
        StrainParameters(strain_window_px=strain_window, strain_measure=strain_measure),
        pixel_size,
        mask,
    )
    series, started = ImageSeries(target), monotonic()
    attributes: dict[str, object] = {"experiment": target.stem, "image_height": reference.shape[0]}
    attributes["image_width"] = reference.shape[1]
    attributes |= strain_attributes(strain_measure)
    if pixel_size is not None:
        attributes["pixel_size"] = pixel_size
    with DatasetWriter(target, attributes, layout_of_images(pixel_size is not None, strain_measure)) as writer:
        try:
            for step, file in enumerate(files):
                row, image = measuring.measure(step, file)
                series.images.append(image)
                writer.add(row, measuring.settings(metadata))
                if progress is not None:
                    progress(image, len(files))
        except KeyboardInterrupt:
            if not any(image.step and not image.error for image in series.images):
                raise
            series.interrupted = True
        if len(series.failed) == len(series.images) - 1:
            measuring.raise_reason()
    series.seconds = monotonic() - started
    return series


class _Measuring:
    """Measures image after image."""

    def __init__(
        self, window: int, spacing: int, strain: StrainParameters, pixel_size: float | None, mask: np.ndarray | None
    ) -> None:
        # masks are NaN in the reference, and the fraction is one of the mask's points: a small region is no failure
        self._parameters = DicParameters(window=window, spacing=spacing, minimum_valid_fraction=0.0, kept_steps=1)
        self._strain = strain
        self._tracker = DisplacementTracker(self._parameters)
        self._checks = ClosureChecks()
        self._scale, self._mask = pixel_size, None if mask is None else mask.astype(bool)
        self._files: dict[int, Path] = {}
        self._has_mosaic = False
        self._earlier: dict[int, np.ndarray] = {}  # the reference and the image before, as they were read
        self._refuted: dict[int, np.ndarray] = {}  # of the images that later ones may be compared with
        self._reference: np.ndarray | None = None
        self._reason: FringedicError | None = None

    def settings(self, metadata: Metadata | None) -> StepSettings:
        """Return the parameters that the dataset contains."""
        parameters: dict[str, Parameters] = {"dic": self._parameters, "strain": self._strain}
        return StepSettings(parameters, None, {}, metadata)

    def raise_reason(self) -> None:
        """Raise the first error of an image, if there was one."""
        if self._reason is not None:
            raise self._reason

    def measure(self, step: int, file: Path) -> tuple[Row, MeasuredImage]:
        """Return the row of an image; the reference raises its errors, the others have them in their row."""
        self._files[step] = file
        row = Row(step, image=file.name)
        texture = None
        remarks: tuple[Remark, ...] = ()
        try:
            grey = texture = self._read(file)
            if step == 0:
                self._has_mosaic = has_mosaic(grey)
            remarks = self._examine(step, grey)
            row.remarks = _as_json(remarks)
            if self._has_mosaic:
                texture = smooth_mosaic(grey)
            if step == 0 and self._mask is not None:
                texture = np.where(self._mask, texture, np.float32(np.nan))
            result = self._tracker.step(_ALL, step, step, texture)
        except FringedicError as error:
            if step == 0:
                raise
            row.error = (
                str(error) if texture is None else f"{file}: {reason_of(error)}"
            )  # errors of reading name the file
            self._reason = self._reason or type(error)(row.error)
            return row, MeasuredImage(step, file.name, row.error, remarks=remarks)
        remarks += field_remarks(result.field.attrs)
        row.remarks = _as_json(remarks)
        closure = self._checks.closure(result, texture, self._parameters.kept_steps)
        closures, refuted = closure_maps(closure), self._find_refuted(result, closure)
        field, scale = _without(result.field, refuted), self._scale
        if step:
            row.refuted_fraction = float(refuted.sum() / max(1, int(result.field.valid.sum())))
        spacing = self._parameters.spacing
        fraction, length = measured_part_and_rms(field.displacement_x.values, field.displacement_y.values)
        wanted = 1.0 if self._mask is None else float(self._mask[::spacing, ::spacing].mean())
        row.valid_fraction, row.rms_displacement = fraction / max(wanted, 1e-12), length * (scale or 1.0)
        row.reference_step, row.correlated_step = result.reference_step, result.correlated_step
        row.maps = {"texture": texture, **displacement_maps(field)}
        if self._reference is None:
            self._reference = texture
        else:
            moved = field.displacement_x.values, field.displacement_y.values
            row.maps["grey_residual"] = grey_residual(self._reference, texture, *moved, spacing)
        row.maps |= closures
        row.confirmed_fraction = confirmed_fraction(closures, spacing)
        if scale is not None:
            maps = row.maps
            row.maps |= {"u": scale * maps["displacement_x"], "v": -scale * maps["displacement_y"]}
            row.maps |= {f"sigma_{name}": scale * maps[f"displacement_sigma_{axis}"] for name, axis in ("ux", "vy")}
        strain = flat_strain(field, window=self._strain.strain_window_px, measure=self._strain.strain_measure)
        row.maps |= {str(name): values.values for name, values in strain.items()}
        gauge = strain.attrs["virtual_strain_gauge_px"]
        self._strain = self._strain.model_copy(update={"virtual_strain_gauge_px": gauge})
        link = result.correlated_step
        earlier = self._files[link].name if link else ""
        return row, MeasuredImage(step, file.name, increment_from=earlier, remarks=remarks)

    def _read(self, file: Path) -> np.ndarray:
        """Return the grey levels of an image of the reference's size."""
        image = read_grey(file)
        if self._reference is not None:
            require_size(file, image, self._files[0], self._reference.shape)
        return image

    def _examine(self, step: int, grey: np.ndarray) -> tuple[Remark, ...]:
        """Return the remarks of an image, from its grey levels as they were read, and keep these for the next one."""
        remarks = [Remark(ImageRemark.MOSAIC)] if step == 0 and self._has_mosaic else []
        same = [number for number, earlier in self._earlier.items() if np.array_equal(earlier, grey)]
        if same:
            remarks.append(Remark(ImageRemark.DUPLICATE, {"step": min(same)}))
        share = saturated_share(grey if self._mask is None else grey[self._mask])
        if share >= SATURATED_SHARE:
            remarks.append(Remark(ImageRemark.SATURATED, {"share": share}))
        self._earlier = {0: self._earlier.get(0, grey), step: grey}
        return tuple(remarks)

    def _find_refuted(self, result: DicResult, closure: xr.Dataset | None) -> np.ndarray:
        """Return the points that the closure refutes; of summed increments, those of the image they start from."""
        link = self._refuted.get(result.correlated_step)
        if closure is not None:
            refuted = refuted_points(closure, result.field)
        else:
            refuted = np.zeros(result.field.valid.shape, bool) if link is None else link & result.field.valid.values
        self._refuted = {result.step: refuted} if link is None else {result.correlated_step: link, result.step: refuted}
        return refuted


def _as_json(remarks: Sequence[Remark]) -> str:
    return json.dumps([{"code": each.code, **each.values} for each in remarks]) if remarks else ""


def _without(field: xr.Dataset, points: np.ndarray) -> xr.Dataset:
    """Return a displacement without some of its points."""
    if not points.any():
        return field
    kept = xr.DataArray(~points, dims=("row", "column"))
    return field.drop_vars("valid").where(kept).assign(valid=field.valid & kept).assign_attrs(field.attrs)
