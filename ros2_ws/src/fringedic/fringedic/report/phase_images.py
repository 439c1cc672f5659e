"""Sentences about a phase that was measured from image files, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr


def phase_sentences(measured: xr.Dataset) -> Iterator[str]:
    """Yield what was measured, its noise, the error by the response, and what the checks of the orders found.

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
