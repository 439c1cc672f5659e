"""The results of the three processing steps, as whole objects that travel from step to step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from fringedic.patterns.pattern import Orientation
from fringedic.phase.findings import Finding
from fringedic.steps.drift_marker import MarkerMotion
from fringedic.steps.remarks import Correction

_STRAINS = ("e_11", "e_22", "e_12")
STRAIN_FIELDS = (*_STRAINS, *(f"{kind}_{name}" for kind in ("sigma", "resolution") for name in _STRAINS))
"""Strain of a step with its standard deviations and smoothing errors."""


@dataclass(frozen=True)
class PhaseResult:
    """The absolute phase of a step.

    Attributes
    ----------
    experiment, step
        The step.
    stamp
        Stamp of its last exposure [ns].
    maps
        float32 images over (row, column): ``phase`` at the finest pitch and its standard deviation ``sigma`` [rad],
        NaN where not measured; where they were asked for or published, ``modulation`` (fringe amplitude) and
        ``texture`` (mean of the whole stack, NaN in background and shadow) [grey level].
    pitch, orientation
        The finest pitch [projector px], to which the phase belongs, and the direction of the fringes.
    valid_fraction
        Pixels with a phase over all pixels.
    rms
        Median of ``sigma`` [rad].
    relative
        The phase is known up to the same number of whole fringes at all pixels.
    harmonic_error
        RMS error of the phase by the harmonics of a nonlinear response [fringe], which ``sigma`` does not contain.
    remarks
        What needs attention although the phase is measured; `fringedic.phase.sentences.describe` puts it into
        words.
    corrections
        What was corrected in the phase: the same for all phases that are compared.
    """

    experiment: str
    step: int
    stamp: int
    maps: xr.Dataset
    pitch: float
    orientation: Orientation = Orientation.VERTICAL
    valid_fraction: float = float("nan")
    rms: float = float("nan")
    relative: bool = False
    harmonic_error: float = float("nan")
    remarks: tuple[Finding, ...] = ()
    corrections: tuple[Correction, ...] = ()

    @property
    def phase(self) -> np.ndarray:
        """Absolute phase [rad], float32 (row, column)."""
        return np.asarray(self.maps.phase.values)

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation of the phase [rad], float32 (row, column)."""
        return np.asarray(self.maps.sigma.values)

    @property
    def modulation(self) -> np.ndarray:
        """Fringe amplitude [grey level], float32 (row, column)."""
        return np.asarray(self.maps.modulation.values)

    @property
    def texture(self) -> np.ndarray:
        """Surface without fringes [grey level], float32 (row, column)."""
        return np.asarray(self.maps.texture.values)


@dataclass(frozen=True)
class DicResult:
    """The in-plane displacement of a step.

    Attributes
    ----------
    experiment, step
        The step.
    stamp
        Stamp of its last exposure [ns].
    reference_step
        The step from whose configuration the displacement counts.
    correlated_step
        The step whose texture was compared with this step's: the reference step, or a later one when increments are
        composed because the texture had changed too much.
    field
        ``displacement_x`` (right), ``displacement_y`` (down) and their standard deviations ``sigma_x``, ``sigma_y``
        [px], float32 over (row, column), NaN where not measured; coordinates are the pixels of the reference image.
        The attributes ``window_px`` and ``method`` name how it was measured: the errors of the strain depend on them.
    valid_fraction
        Measured points over all points of the region.
    rms
        Root mean square of both components together [px].
    """

    experiment: str
    step: int
    stamp: int
    reference_step: int
    correlated_step: int
    field: xr.Dataset
    valid_fraction: float = float("nan")
    rms: float = float("nan")

    @property
    def displacement(self) -> np.ndarray:
        """(d_x, d_y) [px], float32 (row, column, 2), as published."""
        return np.stack([self.field.displacement_x.values, self.field.displacement_y.values], axis=-1)

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviations of (d_x, d_y) [px], float32 (row, column, 2), as published."""
        return np.stack([self.field.sigma_x.values, self.field.sigma_y.values], axis=-1)

    @property
    def origin(self) -> tuple[int, int]:
        """Column and row of the first point [px]."""
        return int(self.field.column[0]), int(self.field.row[0])

    @property
    def spacing(self) -> int:
        """Distance of the points [px]."""
        return int(self.field.attrs["spacing_px"])


@dataclass(frozen=True)
class CouplingResult:
    """Shape and 3D displacement of a step.

    Attributes
    ----------
    experiment, step
        The step.
    stamp
        Stamp of its last exposure [ns].
    reference_step
        The step from whose configuration the displacement counts.
    shape
        ``x``, ``y``, ``z``, ``sigma_z`` of this step's surface at every camera pixel [m], float32 (row, column).
    displacement
        At the points of the displacement grid, float32 (row, column): ``u``, ``v``, ``w`` with ``sigma_u``,
        ``sigma_v``, ``sigma_w`` [m], ``x``, ``y``, ``z`` of the reference surface where they are measured [m], and the
        noise of both heights, ``noise_z`` and ``noise_z_deformed`` [m], from which the noise of a strain follows; when
        asked for ``u_t``, ``v_t``, ``w_n`` [m] and ``e_11``, ``e_22``, ``e_12`` [-] with ``sigma_e_11``,
        ``sigma_e_22``, ``sigma_e_12`` [-] and the expected smoothing errors ``resolution_e_11``, ``resolution_e_22``,
        ``resolution_e_12`` [-].
    valid_fraction
        Measured points over all points of the displacement.
    rms
        Root mean square length of (u, v, w) [m].
    drift
        Motion of the drift marker; None when there is no marker.
    """

    experiment: str
    step: int
    stamp: int
    reference_step: int
    shape: xr.Dataset
    displacement: xr.Dataset
    valid_fraction: float
    rms: float
    drift: MarkerMotion | None = None

    def strain(self) -> xr.Dataset | None:
        """Return x, y, z of the points with a measured strain, NaN elsewhere, and the strain; None without a strain.

        Its windows leave a wider edge than the displacement.
        """
        if "e_11" not in self.displacement:
            return None
        names = [name for name in STRAIN_FIELDS if name in self.displacement]
        measured = np.logical_and.reduce([np.isfinite(self.displacement[name].values) for name in names])
        places = self.displacement[["x", "y", "z"]].where(xr.Variable(("row", "column"), measured))
        return places.assign({name: self.displacement[name] for name in names})


def displacement_field(
    displacement: np.ndarray, sigma: np.ndarray, *, origin: tuple[int, int], spacing: int, window: int, method: str
) -> xr.Dataset:
    """Label published displacement images, for the ``field`` of a `DicResult`.

    Parameters
    ----------
    displacement, sigma
        (d_x, d_y) and their standard deviations [px], (row, column, 2).
    origin
        Column and row of the first point [px].
    spacing
        Distance of the points [px].
    window, method
        How the displacement was measured; window 0 when it is not known (recordings of older versions).
    """
    rows, columns = displacement.shape[:2]
    values = {
        "displacement_x": displacement[..., 0],
        "displacement_y": displacement[..., 1],
        "sigma_x": sigma[..., 0],
        "sigma_y": sigma[..., 1],
    }
    attributes = {"spacing_px": spacing} | ({"window_px": window, "method": method} if window else {})
    return xr.Dataset(
        {name: (("row", "column"), np.ascontiguousarray(value)) for name, value in values.items()},
        coords={"row": origin[1] + spacing * np.arange(rows), "column": origin[0] + spacing * np.arange(columns)},
        attrs=attributes,
    )
