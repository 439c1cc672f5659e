"""The result of a calibration: the rig, how far it can be trusted, and its files."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
import yaml

from fringedic.calibration.files import read_fit, write_fit
from fringedic.calibration.fit_results import FitResult
from fringedic.errors import CalibrationError
from fringedic.rig.model import RigModel
from fringedic.wording.sealed_yaml import ChangedFileError

MODEL_FILE = "calibration.yaml"
FIT_FILE = "calibration_fit.yaml"
RESIDUAL_FILE = "calibration_residuals.nc"


@dataclass(frozen=True, eq=False)
class RigCalibration(FitResult):
    """A calibrated rig and how far it can be trusted.

    Attributes
    ----------
    model
        The rig with the covariance of its parameters.
    pitch, orientation
        Pitch [projector px] and direction of the fringes that the planes were measured with.
    variant
        The model with the smallest information criterion, or the requested one.
    candidates
        The models that were fitted.
    planes
        Every plane beside the model.
    parameters, correlation
        Fitted parameters, and the correlation of their errors, shape (n, n).
    chi_square
        Sum of squares of the blocks' residuals per degree of freedom, in units of the predicted variance.
    residual, predicted, systematic
        Root mean squares over the fitted planes as heights [m]: of pixels, of their predicted noise and of block means.
    held_out
        Root mean square of the block means of that plane kept out of the fit which deviates most [m]; NaN without one.
    height_sigma
        Largest standard deviation of z due to the calibration, over the calibrated volume [m].
    principal_effect
        Change of z for one pixel of error of the projector's assumed principal point, RMS over the planes [m]; NaN when
        the point was fitted.
    residual_map
        ``residual`` [m], ``phase`` and ``sigma`` [rad] of block means with the dimensions (plane, row, column).
    warnings
        What should be better, as codes with values; `fringedic.calibration.sentences` makes sentences of them.
    verdict, reason, go, tested
        Whether the calibration can be used, why, the same as a bool, and whether a plane kept out of the fit was at
        another position than every fitted one.
    bad_images, worst_plane
        Names of the images that contradict the others, and the fitted plane with the largest residual.
    created
        Time of the calibration.
    summary
        The verdict in words as the files contain it; empty before the first saving.
    """

    def reconstruct(
        self, phase: np.ndarray | xr.DataArray, sigma_phase: np.ndarray | xr.DataArray | None = None
    ) -> xr.Dataset:
        """Return the surface of a phase map [rad] (row, column) at the calibrated pitch; see `RigModel.reconstruct`.

        Raises
        ------
        ImageError
            The phase is not an image (row, column), or sigma has another shape.
        """
        return self.model.reconstruct(phase, self.pitch, sigma_phase, self.orientation)

    def age(self, now: datetime | None = None) -> float:
        """Return the time since the calibration [s]."""
        return ((now or datetime.now(UTC)) - self.created).total_seconds()

    def save(self, folder: str | Path, summary: str = "") -> Path:
        """Write the files of the calibration and return the path of the first.

        The files are ``calibration.yaml`` (the model, to which rig files refer), ``calibration_fit.yaml`` (the figures,
        in mm, µm and degree) and ``calibration_residuals.nc``.

        Parameters
        ----------
        folder
            Is created when it does not exist.
        summary
            The verdict in words, stored for people; `fringedic.calibration.sentences.verdict_sentence`.

        Raises
        ------
        OSError
            The folder cannot be written.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self.model.to_yaml(folder / MODEL_FILE)
        compressed = {name: {"zlib": True} for name in self.residual_map.data_vars}
        # by way of memory: HDF5 ends the process when it cannot write to the disk
        content = self.residual_map.to_netcdf(engine="h5netcdf", encoding=compressed)
        (folder / RESIDUAL_FILE).write_bytes(content)
        written = dataclasses.replace(self, summary=summary or self.summary)
        write_fit(written, folder / FIT_FILE, hashlib.sha256(content).hexdigest())
        return folder / MODEL_FILE

    @classmethod
    def load(cls, path: str | Path) -> RigCalibration:
        """Read the files that `save` wrote, also those of older versions.

        Parameters
        ----------
        path
            Their folder, or the file of the model among them.

        Raises
        ------
        CalibrationError
            A file is missing or has another content, or the figures beside the model are those of another calibration.
        """
        path = Path(path)
        try:
            file = path / MODEL_FILE if path.is_dir() else path
            values, digest = read_fit(file.with_name(FIT_FILE))
            model = RigModel.from_yaml(file)
            content = file.with_name(RESIDUAL_FILE).read_bytes()
            if digest not in (None, hashlib.sha256(content).hexdigest()):
                raise CalibrationError(
                    f"{file.with_name(RESIDUAL_FILE)} has changed since it was written: restore it from a copy, or "
                    "calibrate again"
                )
            with xr.open_dataset(io.BytesIO(content), engine="h5netcdf") as stored:
                found = cls(model=model, residual_map=stored.load(), **values)
        except CalibrationError:
            raise
        except ChangedFileError as error:
            raise CalibrationError(f"{file.with_name(FIT_FILE)}: {error}") from error
        except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
            raise CalibrationError(f"{path} does not hold a calibration of the rig: {error!r}") from error
        # Two fits never agree in every digit: equal figures are those of the model.
        distances = [1e-3 * each.value for each in found.parameters if each.name == "camera_distance"]
        if not all(math.isclose(each, found.model.camera_distance, rel_tol=1e-9) for each in distances):
            raise CalibrationError(
                f"{file.with_name(FIT_FILE)} contains the figures of another calibration than {file}: keep each "
                "calibration in a folder of its own"
            )
        return found
