"""The in-plane step: textures to displacement images against the reference step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt

from fringedic.correlation import Reference, measure_displacement
from fringedic.correlation.increments import PixelGrid, Total, compose, interpolation_noise
from fringedic.errors import CorrelationError, ErrorCode
from fringedic.steps.parameters import DicParameters
from fringedic.steps.references import LatestSteps, References, StepKey, check_fraction, no_reference, size_mismatch
from fringedic.steps.statistics import measured_part_and_rms
from fringedic.steps.step_results import DicResult

MEDIAN_POINTS = 20_000  # of a field, from which its median displacement is computed
TURNED = 0.97  # of the agreement so far, below which a prediction may be wrong: the motion may have turned
WORTH = 0.1  # fraction of the points in view that a later reference has to gain, because composing adds noise
_INVERTING = 5  # repetitions that solve p + d(p) = x for p; each lessens the error by the strain
_NOT_COMPARABLE = ("spacing", "region", "method")  # changes after which fields do not continue those before


@dataclass(frozen=True)
class _Link:
    """A step whose texture later steps can be correlated with.

    Attributes
    ----------
    field
        Its displacement against the reference step; None for the reference step itself.
    prepared
        Its texture, once it is prepared for correlation.
    """

    step: int
    texture: np.ndarray
    field: xr.Dataset | None = None
    prepared: Reference | None = None


class DisplacementTracker:
    """Measures the in-plane displacement of each step against the reference step's texture.

    The extrapolated displacement of the previous two steps is the initial value of the next one. The measurement itself
    is against the reference image, so that errors do not accumulate. When the texture has changed so much that too few
    points agree with the reference image, the latest good step replaces it, and its displacement is composed with the
    increments measured against it, until that texture changes too much as well. The reference texture, the textures of
    the latest ``kept_steps`` steps (any of them can become the reference) and four displacement fields stay in memory.

    Parameters
    ----------
    parameters
        May be replaced between steps by assigning to `parameters`.
    """

    def __init__(self, parameters: DicParameters) -> None:
        self._parameters = parameters
        self._references = References()
        self._textures: LatestSteps[np.ndarray] = LatestSteps()
        self._prepared: tuple[StepKey, Reference] | None = None
        self._measured_against: StepKey | None = None
        self._history: list[tuple[int, xr.Dataset]] = []
        self._link: _Link | None = None
        self._last: _Link | None = None
        self._agreed = 0.0
        self._expected = 0.0  # agreement of a step whose prediction is right
        self._mask: np.ndarray | None = None  # of the region in the reference step
        self._wanted = 1.0  # fraction of the grid's points that lie in the region

    @property
    def parameters(self) -> DicParameters:
        """Parameters of the following steps."""
        return self._parameters

    @parameters.setter
    def parameters(self, parameters: DicParameters) -> None:
        if any(getattr(parameters, name) != getattr(self._parameters, name) for name in _NOT_COMPARABLE):
            self._begin()
        if parameters != self._parameters:
            self._parameters = parameters
            self._prepared = None
            if self._link is not None:
                self._link = replace(self._link, prepared=None)

    def set_reference(self, experiment: str, step: int) -> None:
        """Make a step the reference of the following ones; it may be a step that is still to come."""
        self._references.set(experiment, step)

    def step(self, experiment: str, step: int, stamp: int, texture: np.ndarray) -> DicResult:
        """Measure one step; the displacement of the reference step is zero at every point that can be measured.

        Parameters
        ----------
        texture
            The surface without fringes [grey level], float32 (row, column).

        Raises
        ------
        StepError
            The reference step was not measured or is no longer kept (`ErrorCode.NO_REFERENCE`), the texture has another
            size than the reference (`FRAME_MISMATCH`), or fewer points are measured than
            ``parameters.minimum_valid_fraction`` (`TOO_FEW_VALID`).
        CorrelationError
            The texture does not show the surface of the reference.
        """
        parameters = self._parameters
        key = (experiment, step)
        reference_key = (experiment, self._references.of(experiment, step))
        reference = self._reference(reference_key, key, texture)
        if reference_key != self._measured_against or key == reference_key:
            self._begin()
            self._measured_against = reference_key
        link = self._link or _Link(reference_key[1], texture, prepared=reference)
        if key == reference_key:
            measured, agreed = self._measure(link, texture)
        else:
            link, measured, agreed = self._follow(link, texture, step)
        field = measured
        if key == reference_key:
            field = _at_rest(measured)
        elif link.field is not None:
            field = self._composed(link.field, measured)
        fraction, length = measured_part_and_rms(field.displacement_x.values, field.displacement_y.values)
        fraction /= self._wanted
        check_fraction("a displacement", fraction, parameters.minimum_valid_fraction, key)

        self._references.succeeded(experiment, step)
        self._prepared = (reference_key, reference)
        self._textures.keep(key, texture, parameters.kept_steps, reference_key)
        self._agreed = max(self._agreed, agreed)
        self._expected = max(self._expected, agreed)
        if link.field is not None and link.step != (self._link.step if self._link else None):
            self._history = []
        self._link = link if link.field is not None else None
        self._history = [*self._history[-1:], (step, field if key == reference_key else measured)]
        self._last = _Link(step, texture, field)
        return DicResult(
            experiment=experiment,
            step=step,
            stamp=stamp,
            reference_step=reference_key[1],
            correlated_step=link.step,
            field=field,
            valid_fraction=fraction,
            rms=length,
        )

    def _begin(self) -> None:
        """Forget the history: the following steps are correlated with the reference step."""
        self._history = []
        self._link = self._last = None
        self._agreed = self._expected = 0.0

    def _measure(
        self, link: _Link, texture: np.ndarray, initial: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[xr.Dataset, float]:
        """Return the displacement against a link and the fraction of points that agree; without `initial` globally."""
        assert link.prepared is not None
        measured = measure_displacement(link.prepared, texture, initial=initial, method=self._parameters.method)
        return measured, _agreement(measured, texture.shape)

    def _attempt(
        self, link: _Link, texture: np.ndarray, initial: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[xr.Dataset, float] | None:
        """Measure; None when the texture does not show the surface of the link."""
        try:
            return self._measure(link, texture, initial)
        except CorrelationError as error:
            if error.code is not ErrorCode.NO_CORRELATION:
                raise
            return None

    def _follow(self, link: _Link, texture: np.ndarray, step: int) -> tuple[_Link, xr.Dataset, float]:
        """Correlate with the present link, or with the latest step when the present link lost too many points.

        Returns
        -------
        link, measured, agreed
            The link that was used, the displacement against it, and the fraction of points that agree.
        """
        link = self._prepare(link)
        try:
            measured, agreed = self._search(link, texture, self._predicted(step))
        except CorrelationError as error:
            if (
                error.code is not ErrorCode.NO_CORRELATION
                or (other := self._correlate_with_last(link, texture)) is None
            ):
                raise
            return other
        if agreed >= self._parameters.rereference_fraction * self._agreed:
            return link, measured, agreed
        other = self._correlate_with_last(link, texture)
        if other is not None and other[2] > agreed + WORTH:
            return other
        return link, measured, agreed

    def _search(
        self, link: _Link, texture: np.ndarray, predicted: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[xr.Dataset, float]:
        """Return the displacement against a link and the fraction that agrees: where the prediction fails, globally.

        Raises
        ------
        CorrelationError
            The texture does not show the surface of the link.
        """
        found = None if predicted is None else self._attempt(link, texture, predicted)
        if found is None:
            return self._measure(link, texture)
        # A wrong prediction leaves the motion to be found as another one beside it. Of a periodic texture, a start
        # without a prediction would lose the count of the repetitions.
        agrees = found[1] >= TURNED * self._expected and found[0].attrs.get("motions", 1) == 1
        if agrees or "repeats_px" in found[0].attrs:
            return found
        anew = self._attempt(link, texture)
        best = found if anew is None or anew[1] < found[1] else anew
        self._expected = best[1]  # no better start is known: the next step is as good as this one
        return best

    def _correlate_with_last(self, link: _Link, texture: np.ndarray) -> tuple[_Link, xr.Dataset, float] | None:
        """Correlate with the latest step; None when it is the link itself, is not to be used, or does not agree."""
        last = self._last
        if self._parameters.rereference_fraction == 0 or last is None or last.step == link.step:
            return None
        last = self._prepare(last)
        found = self._attempt(last, texture)
        return None if found is None else (last, *found)

    def _prepare(self, link: _Link) -> _Link:
        """Prepare the texture of a link for correlation."""
        if link.prepared is not None:
            return link
        parameters, mask = self._parameters, self._mask
        if mask is not None and link.field is not None:
            mask = moved_mask(mask, link.field)  # a window beyond the region would see what moves differently
        prepared = Reference(link.texture, window=parameters.window, spacing=parameters.spacing, mask=mask)
        return replace(link, prepared=prepared)

    def _composed(self, link: xr.Dataset, measured: xr.Dataset) -> xr.Dataset:
        """Compose the displacement that leads to the link with the increment measured against it."""
        grid = PixelGrid.of(measured)
        total = compose(
            Total(_vectors(link), _sigmas(link) ** 2),
            grid,
            _vectors(measured),
            _sigmas(measured),
            grid,
            noise_gain=interpolation_noise(grid.spacing, None, self._parameters.window, self._parameters.method),
        )
        return _with_values(measured, *total.displacement, *np.sqrt(total.variance))

    def _reference(self, reference_key: StepKey, key: StepKey, texture: np.ndarray) -> Reference:
        if self._prepared is not None and self._prepared[0] == reference_key and key != reference_key:
            reference = self._prepared[1]
        else:
            image = texture if key == reference_key else self._textures.get(reference_key)
            if image is None:
                raise no_reference(key, reference_key)
            parameters = self._parameters
            mask = None if parameters.region is None else parameters.region.mask_for(image.shape)
            self._wanted = 1.0 if mask is None else float(mask[:: parameters.spacing, :: parameters.spacing].mean())
            reference = Reference(image, window=parameters.window, spacing=parameters.spacing, mask=mask)
            measured = np.isfinite(image)
            self._mask = mask if measured.all() else measured if mask is None else mask & measured
        shape = self._textures.get(reference_key, texture).shape
        if shape != texture.shape:
            raise size_mismatch("texture", key, reference_key, (texture.shape, shape))
        return reference

    def _predicted(self, step: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Extrapolate the displacement of the latest two steps; None, for a global search, before there are two.

        Steps count by their numbers: a step may have failed, and a reference may lie between them or after them.
        """
        if len(self._history) < 2 or self._history[0][0] == self._history[1][0]:
            return None
        (earlier_step, earlier), (last_step, last) = ((number, _vectors(field)) for number, field in self._history)
        predicted = last + np.float32((step - last_step) / (last_step - earlier_step)) * (last - earlier)
        predicted = np.where(np.isnan(predicted), last, predicted)
        return predicted[0], predicted[1]


_VECTOR, _SIGMA = ("displacement_x", "displacement_y"), ("sigma_x", "sigma_y")


def _vectors(field: xr.Dataset) -> np.ndarray:
    """Return (d_x, d_y) of a field, (2, row, column) [px]."""
    return np.stack([field[name].values for name in _VECTOR])


def _sigmas(field: xr.Dataset) -> np.ndarray:
    """Return the standard deviations of (d_x, d_y), (2, row, column) [px]."""
    return np.stack([field[name].values for name in _SIGMA])


def _with_values(field: xr.Dataset, *values: np.ndarray) -> xr.Dataset:
    """Return a field on the same points with other displacements and standard deviations."""
    names = (*_VECTOR, *_SIGMA)
    arrays = (np.ascontiguousarray(each, np.float32) for each in values)
    fields = {name: field[name].copy(data=each) for name, each in zip(names, arrays, strict=False)}
    return field.assign(fields)


def _at_rest(measured: xr.Dataset) -> xr.Dataset:
    """Return the displacement of the reference step: zero where it can be measured."""
    zero = np.where(measured.valid.values, np.float32(0), np.float32(np.nan))
    return _with_values(measured, zero, zero)


def moved_mask(mask: np.ndarray, field: xr.Dataset) -> np.ndarray:
    """Return where a part of the reference image is in the image that its displacement leads to.

    Parameters
    ----------
    mask
        bool (row, column), of the reference image.
    field
        Displacement at the points of its grid [px]; where it is not known, that of the nearest point holds.

    Returns
    -------
    ndarray
        bool (row, column): the point p of the reference that is seen at x, p + d(p) = x, lies in the part.
    """
    vectors = _vectors(field)
    unknown = np.isnan(vectors[0])
    if unknown.all():
        return mask
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    vectors = vectors[:, nearest[0], nearest[1]]
    spacing = float(field.row[1] - field.row[0])
    seen = np.indices(mask.shape, dtype=np.float32)
    seen_y, seen_x = seen[0], seen[1]
    x, y = seen_x, seen_y
    for _ in range(_INVERTING):
        column, row = x / spacing, y / spacing
        d_x, d_y = (cv2.remap(each, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for each in vectors)
        x, y = seen_x - d_x, seen_y - d_y
    inside = cv2.remap(mask.view(np.uint8), x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(inside, dtype=bool)


def _agreement(measured: xr.Dataset, shape: tuple[int, ...]) -> float:
    """Return measured points over the points that would be in view if all had moved like the median."""
    valid = measured.valid.values
    count = int(np.count_nonzero(valid))
    staying = 1
    for axis, name, length in (("row", "displacement_y", shape[0]), ("column", "displacement_x", shape[1])):
        known = measured[name].values[valid][:: max(1, count // MEDIAN_POINTS)]
        there = measured[axis].values + (float(np.median(known)) if count else 0.0)
        staying *= int(np.count_nonzero((there >= 0) & (there <= length - 1)))
    return count / max(1, staying)


def white_texture(image: np.ndarray) -> np.ndarray:
    """Return the texture of a white exposure: the image itself as float32 [grey level]."""
    return image.astype(np.float32)
