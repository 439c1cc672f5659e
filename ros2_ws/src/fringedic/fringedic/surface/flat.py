"""Strain of a flat specimen from its displacement in the image alone."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.errors import SurfaceError
from fringedic.surface.planes import WIDEST_WINDOW
from fringedic.surface.strain import compute_strain
from fringedic.surface.strain_measures import GREEN_LAGRANGE, TENSORS, flat_fields, strain_attributes
from fringedic.wording.arguments import check_arguments, dataset, number, one_of, optional, whole

_FAR = 1e6  # distance of the camera [px]: its lines of sight are parallel, as the evaluation of a flat specimen assumes
_AXES = {"11": "xx", "22": "yy", "12": "xy"}


@check_arguments(
    SurfaceError,
    displacement=dataset("displacement_x", "displacement_y", "sigma_x", "sigma_y"),
    window=whole(high=WIDEST_WINDOW),
    pixel_size=optional(number(1e-12)),
    measure=one_of(*TENSORS),
)
def flat_strain(
    displacement: xr.Dataset, *, window: int, pixel_size: float | None = None, measure: str = GREEN_LAGRANGE
) -> xr.Dataset:
    """Return the strain of a flat specimen that the camera sees perpendicularly.

    It is computed from that of `surface_strain` for a flat surface and parallel lines of sight. A motion towards the
    camera magnifies the image and appears as a strain of the same size in all directions; only the shape distinguishes
    them.

    Parameters
    ----------
    displacement
        From `fringedic.measure_displacement`, with its uncertainties.
    window
        Width of the window of the slopes [px].
    pixel_size
        Size of a pixel on the specimen [m], for the length of the virtual strain gauge in mm; the strain needs none.
    measure
        With the deformation gradient F = R U: ``"green-lagrange"``, (F^T F - 1)/2; ``"logarithmic"``, ln U (Hencky
        1928); or ``"engineering"``, U - 1 (Biot 1939), whose principal values are changes of length over length. None
        of them contains the rotation R. Standard deviations are propagated to first order.

    Returns
    -------
    Dataset
        Over (row, column): ``e_xx`` (x to the right), ``e_yy`` (y upwards), ``e_xy`` (in every measure the tensor
        shear, half the engineering shear), principal strains ``e_1`` >= ``e_2``, ``e_von_mises``, the standard
        deviations ``sigma_e_xx``, ``sigma_e_yy``, ``sigma_e_xy`` and the expected errors by smoothing
        ``resolution_e_xx``, ``resolution_e_yy``, ``resolution_e_xy``, all [1]. The attributes ``strain_measure`` and
        ``shear_strain`` name measure and kind of shear, ``virtual_strain_gauge_px`` is the length that a value is
        measured over, ``virtual_strain_gauge_mm`` the same with a known scale.

    Raises
    ------
    SurfaceError
        The window contains fewer than 3 x 3 points, or the displacement has no uncertainties.

    Examples
    --------
    >>> import numpy as np
    >>> import fringedic
    >>> texture = np.random.default_rng(1).normal(size=(64, 64)).astype(np.float32)
    >>> field = fringedic.measure_displacement(texture, np.roll(texture, 1, axis=0), window=16)
    >>> strain = flat_strain(field, window=21)
    >>> bool(abs(strain.e_yy.median()) < 1e-3)
    True
    """
    column, row = np.meshgrid(displacement["column"].values, displacement["row"].values)
    zero = np.zeros(column.shape, np.float32)
    x, y, sigma_x, sigma_y = (
        displacement[name].values for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
    )
    fields = {"x": column.astype(np.float32), "y": -row.astype(np.float32), "z": zero}
    fields |= {"u": x, "v": -y, "w": zero}
    fields |= {"sigma_u": sigma_x, "sigma_v": sigma_y, "sigma_w": zero}
    fields |= {"displacement_sigma_x": sigma_x, "displacement_sigma_y": sigma_y}
    fields |= {"noise_z": zero, "noise_z_deformed": zero}
    attributes = displacement.attrs
    strain = compute_strain(
        xr.Dataset(
            {name: (("row", "column"), values) for name, values in fields.items()},
            {name: displacement[name] for name in ("row", "column")},
            {
                "displacement_window_px": attributes.get("window_px", 1),
                "displacement_method": attributes.get("method", "dense"),
                "z_filter_px": 0.0,
                "camera_distance": _FAR,
            },
        ),
        window,
        ["von_mises"],
        tensor=measure,
    )
    strain = strain.rename({str(name): _name_in_image(str(name)) for name in strain})
    meanings = flat_fields(measure)
    found = strain[list(meanings)]
    for name, meaning in meanings.items():
        found[name].attrs["long_name"] = meaning
    gauge = float(strain.attrs["virtual_strain_gauge_px"])
    found.attrs = {"window_px": window, **strain_attributes(measure), "virtual_strain_gauge_px": gauge}
    if pixel_size is not None:
        found.attrs["virtual_strain_gauge_mm"] = 1e3 * pixel_size * gauge
    return found


def _name_in_image(name: str) -> str:
    first, _, last = name.rpartition("_")
    return f"{first}_{_AXES.get(last, last)}"
