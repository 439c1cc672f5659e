"""Rigid motion of a measured surface."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from fringedic.errors import DatasetError
from fringedic.evaluation.motion import motion_of
from fringedic.evaluation.probes import points_in
from fringedic.frames.region import Region
from fringedic.wording.arguments import check_arguments, of_type, optional
from fringedic.wording.arguments import dataset as dataset_of

_POSITION, _DISPLACEMENT = ("x", "y", "z"), ("u", "v", "w")
_IN_IMAGE = {"displacement_x": 1, "displacement_y": -1}  # y of the image points downwards


@check_arguments(DatasetError, dataset=dataset_of(), region=optional(of_type(Region)))
def remove_rigid_motion(dataset: xr.Dataset, region: Region | None = None) -> xr.Dataset:
    """Remove the best-fitting rigid motion from the displacement of each step.

    The rotation and translation with the least squared distances between the reference points and the deformed points
    of the region (Kabsch 1976) are taken back. What remains is the deformation. Strain does not change.

    Parameters
    ----------
    dataset
        From `open_experiment` or `couple`; of images also from `fringedic.measure_displacement`; it is not changed.
    region
        The points that the motion is fitted to; by default all that are measured.

    Returns
    -------
    Dataset
        ``x``, ``y``, ``z`` and the remaining ``u``, ``v``, ``w`` [m], float32, over the dimensions of the dataset, with
        ``rotation`` (rotation vector [rad]) and ``translation`` [m] over (step, axis): a reference point X moved to
        rotation X + translation, plus the remaining displacement turned by the rotation. Of images alone it contains
        the remaining ``displacement_x``, ``displacement_y`` [px]; the motion is that of the image with x to the right
        and y upwards from its middle (from its first pixel if its size is not known), in px without a scale. The
        standard deviations of the displacement, where there are any, are turned with it, without its covariances; they
        do not contain the uncertainty of the fitted motion, which is small beside theirs if the region has many points.

    Raises
    ------
    DatasetError
        The dataset has no displacement, fewer than three points are measured in a step, or no point of the result lies
        in the region.
    ImageError
        The region was drawn in an image of another size.

    References
    ----------
    Kabsch, W. (1976). A solution for the best rotation to relate two sets of vectors. Acta Crystallographica A32,
    922-923.

    Examples
    --------
    A surface that only moves by 2 mm towards the camera does not deform:

    >>> import numpy as np
    >>> import xarray as xr
    >>> column, row = np.meshgrid(np.arange(5), np.arange(4))
    >>> maps = {"x": 1e-3 * column, "y": -1e-3 * row, "z": 0 * row, "u": 0 * row, "v": 0 * row, "w": 2e-3 + 0 * row}
    >>> moved = xr.Dataset({name: (("row", "column"), values) for name, values in maps.items()})
    >>> still = remove_rigid_motion(moved)
    >>> bool(abs(still.w).max() < 1e-9), still.translation.values.round(6).tolist()
    (True, [0.0, 0.0, 0.002])
    """
    motion = motion_of(dataset)
    inside = None if region is None else points_in(region, dataset)
    remaining, uncertain, rotations, translations = [], [], [], []
    for maps in motion.by_step():
        before = maps[:3].astype(float)
        after = before + maps[3:6]
        measured = np.isfinite(after).all(axis=0)
        chosen = measured if inside is None else measured & inside
        if np.count_nonzero(chosen) < 3:
            raise DatasetError("fewer than three points are measured: they do not determine a rigid motion")
        rotation, translation = _fit_motion(before[:, chosen], after[:, chosen])
        # in the orientation of the reference, so that the rest can be compared with it
        back = np.tensordot(rotation.T, after - translation[:, None, None], 1)
        remaining.append((back - before).astype(np.float32))
        if motion.sigmas:
            turned = np.tensordot(rotation.T**2, maps[6:].astype(float) ** 2, 1)
            uncertain.append(np.sqrt(turned).astype(np.float32))
        rotations.append(Rotation.from_matrix(rotation).as_rotvec())
        translations.append(translation)
    left = np.array(remaining)
    dataset = motion.dataset
    stepwise = "step" in dataset.dims
    if motion.spatial:
        fields: dict[str, object] = {name: dataset[name] for name in _POSITION}
        moved = dict(zip(_DISPLACEMENT, left.swapaxes(0, 1), strict=True))
    else:
        fields = {}
        moved = {name: sign * left[:, place] / motion.scale for place, (name, sign) in enumerate(_IN_IMAGE.items())}
    if motion.sigmas:  # of images alone there are two
        moved |= dict(zip(motion.sigmas, np.array(uncertain).swapaxes(0, 1) / motion.scale, strict=False))
    shape = tuple(dataset[next(iter(moved))].dims)
    for name, values in moved.items():
        fields[name] = (shape, values if stepwise else values[0], dict(dataset[name].attrs))
    axes = ("step", "axis") if stepwise else ("axis",)
    for name, unit, table in (("rotation", "rad", rotations), ("translation", motion.unit, translations)):
        fields[name] = (axes, table if stepwise else table[0], {"units": unit})
    coordinates = dataset[[next(iter(moved))]].coords
    return xr.Dataset(fields, {**coordinates, "axis": list("xyz")}, dataset.attrs)


def _fit_motion(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation matrix and translation that bring points (axis, point) closest to where they moved to."""
    centre, goal = before.mean(axis=1), after.mean(axis=1)
    covariance = (after - goal[:, None]) @ (before - centre[:, None]).T
    left, _, right = np.linalg.svd(covariance)
    # a reflection would fit a plane equally well
    rotation = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return rotation, goal - rotation @ centre
