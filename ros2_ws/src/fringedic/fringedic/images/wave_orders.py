"""Orders of the fringes of all pitches of an image stack: from the coarsest pitch, a Gray code, or beats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import xarray as xr

from fringedic.configuration.fringe_images import FringeImageDescription
from fringedic.errors import ErrorCode, PhaseError, StepError
from fringedic.phase.beats import combine_beats
from fringedic.phase.fringe_order import assign_orders, unwrap_spatial
from fringedic.phase.harmonic_correction import HarmonicError, fit_harmonic_error
from fringedic.phase.layout import nearly_alike, unambiguous_range
from fringedic.phase.order_certainty import fit_order_certainty

TURN = 2 * np.pi
_LARGEST_BLOCK = 0.75  # of a period: the middle of a block is then known to 3/8 of a period, less than half
_LARGEST_OFFSET = 0.25  # of a period, between fringes and Gray code
_LEAST_AGREEMENT = 0.7  # length of the mean of exp(i difference) of fringes and Gray code, over that of perfect ones
_LEAST_CERTAIN = 0.5  # part of the pixels measured at all pitches; unrelated phases agree at a few percent
_ADVICE = (
    "show more shifts (N shifts cancel the harmonics of the response up to N - 2) or a pitch between them, or make the "
    "response linear (gamma 1)"
)


@dataclass(frozen=True)
class Wave:
    """Wrapped phase of one pitch, zero at column or row 0.

    Attributes
    ----------
    period
        [projector px].
    phase, sigma
        Phase and its standard deviation [rad], shape (row, column).
    shifts
        q; 0 for a beat of two pitches.
    origin
        Phase [rad] where that of the pattern is zero.
    """

    period: float
    phase: np.ndarray
    sigma: np.ndarray
    shifts: int = 0
    origin: float = 0.0

    def corrected(self, error: HarmonicError) -> Wave:
        """Return the wave without a harmonic error, as it is where this is unknown; sigma is that of its noise."""
        if np.isnan(error.ratio):
            return self
        true = error.correct(self.phase - self.origin)
        return replace(self, phase=true + self.origin, sigma=self.sigma / error.growth(true).astype(np.float32))


@dataclass(frozen=True)
class WaveOrders:
    """Absolute phase of the finest pitch.

    Attributes
    ----------
    phase
        [rad], zero at column or row 0, with the attribute ``relative``; NaN where the order is not certain.
    sigma
        Its standard deviation [rad].
    uncertain
        Part of the pixels measured at all pitches whose order is not certain.
    by_beats
        Whether the phase is the weighted mean of all pitches.
    harmonics
        Errors of the pitches, coarse to fine; the orders are free of them, and with `correct_harmonics` the phase too.
    """

    phase: xr.DataArray
    sigma: np.ndarray
    uncertain: float
    by_beats: bool
    harmonics: list[HarmonicError]


def solve_orders(waves: list[Wave], blocks: np.ndarray | None, description: FringeImageDescription) -> WaveOrders:
    """Return the absolute phase of the finest pitch, or a relative one where nothing determines its order.

    Parameters
    ----------
    waves
        Of the pitches, coarse to fine.
    blocks
        Number of the block of a Gray code at each pixel, NaN where unknown.
    description
        What the images show.

    Raises
    ------
    PhaseError
        The pitches determine no orders, or their errors leave the orders of most pixels uncertain.
    StepError
        Fringes and Gray code do not belong together.
    """
    pitches = [wave.period for wave in waves]
    if blocks is None and nearly_alike(pitches) and unambiguous_range(pitches) >= description.projector_px:
        return _from_beats(waves, description)
    return _coarse_to_fine(waves, blocks, description)


def _coarse_to_fine(waves: list[Wave], blocks: np.ndarray | None, description: FringeImageDescription) -> WaveOrders:
    levels, own = list(waves), [_own_error(wave, description) for wave in waves]
    block = description.gray_code.block_px if description.gray_code is not None else description.projector_px
    reach = block / _LARGEST_BLOCK if blocks is not None else float(description.projector_px)
    if levels[0].period < reach and len(levels) > 1:
        levels.insert(0, _beat(*(wave.corrected(error) for wave, error in zip(levels[:2], own[:2], strict=True))))
    coarsest, finest = levels[0], levels[-1]
    if coarsest.period < reach:
        if blocks is not None:
            raise PhaseError(
                f"blocks of {block:g} px do not determine the order of fringes of {coarsest.period:g} px: show fringes "
                f"of {reach:g} px or more, or a second pitch whose beat is that long",
                code=ErrorCode.INVALID_SEQUENCE,
            )
        last = finest.corrected(own[-1]) if description.correct_harmonics else finest
        return WaveOrders(unwrap_spatial(last.phase), last.sigma, 0.0, False, own)
    middle = np.asarray(0.5 if blocks is None else blocks + 0.5) * block - 0.5
    if blocks is not None:
        _check_code(coarsest, block, middle, description)
    phase = assign_orders(coarsest.phase, np.broadcast_to(TURN * middle / coarsest.period, coarsest.phase.shape))
    measured = np.logical_and.reduce([np.isfinite(wave.phase) for wave in levels]) & np.isfinite(phase.values)
    certain, harmonics = measured, []
    for coarse, fine in pairwise(levels):
        ratio = coarse.period / fine.period
        expected = own[-1].ratio if coarse.shifts == finest.shifts and np.isfinite(own[-1].ratio) else 0.0
        raw = np.where(certain, phase.values - coarse.origin, np.nan), coarse.sigma
        wrapped = fine.phase - fine.origin, fine.sigma
        found = fit_order_certainty(raw, wrapped, ratio, coarse.shifts, expected=expected)
        if coarse.shifts:
            harmonics.append(found.error)
        predicted, spread = found.predict(*raw, ratio)
        phase = assign_orders(fine.phase, predicted + fine.origin)
        certain = certain & found.certain(raw, (phase.values - fine.origin, fine.sigma), ratio)
        if certain.sum() < _LEAST_CERTAIN * measured.sum():
            noise, rest = (float(each) / TURN for each in (np.nanmedian(spread), found.rest))
            rest_words = f"{rest:.2f}" if rest < 0.5 else "half a"
            raise PhaseError(
                f"the phase of pitch {coarse.period:g} px does not determine the orders of pitch {fine.period:g} px: "
                f"its noise is {noise:.2f} fringe of that pitch, its other errors {rest_words} fringe RMS; {_ADVICE}",
                code=ErrorCode.INVALID_SEQUENCE,
            )
    uncertain = 1 - float(certain[measured].mean()) if measured.any() else 0.0
    last = replace(finest, phase=np.where(certain, phase.values, np.nan))
    last = last.corrected(own[-1]) if description.correct_harmonics else last
    absolute = xr.DataArray(last.phase, dims=("row", "column"), attrs={"relative": 0})
    return WaveOrders(absolute, last.sigma, uncertain, False, [*harmonics, own[-1]])


def _check_code(coarsest: Wave, block: float, middle: np.ndarray, description: FringeImageDescription) -> None:
    """Raise `StepError` when the coarsest fringes do not lie as the blocks of the Gray code do."""
    code = TURN * middle / coarsest.period
    # the code is that of the middle of each block
    least = _LEAST_AGREEMENT * float(np.sinc(block / coarsest.period))
    for sign in (1, -1):
        away = np.exp(1j * (sign * coarsest.phase - code))
        mean = complex(np.mean(away[np.isfinite(away)]))
        if abs(mean) > least:
            break
    else:
        raise StepError(
            "fringes and Gray code do not belong together: check pitches, shifts and width of the blocks",
            code=ErrorCode.WRONG_PATTERN,
        )
    if sign < 0:
        raise StepError(
            "the fringes grow against the Gray code: reverse the lists of shifts", code=ErrorCode.WRONG_PATTERN
        )
    offset = float(np.angle(mean)) / TURN
    if abs(offset) > _LARGEST_OFFSET:
        origin = description.origin - offset * coarsest.period
        raise StepError(
            f"the fringes are displaced by {offset * coarsest.period:.0f} px against the Gray code: origin_px "
            f"{origin:.0f} would fit",
            code=ErrorCode.WRONG_PATTERN,
        )


def _from_beats(waves: list[Wave], description: FringeImageDescription) -> WaveOrders:
    """Return the absolute phase of the finest wave from all waves."""
    own = [_own_error(wave, description) for wave in waves]
    if description.correct_harmonics:
        waves = [wave.corrected(error) for wave, error in zip(waves, own, strict=True)]
    middle = 0.5 * (description.projector_px - 1)
    turned = [np.asarray(wave.phase) - TURN * middle / wave.period for wave in waves]
    wrapped = np.array([each - TURN * np.round(each / TURN) for each in turned], np.float32)
    sigmas = np.array([wave.sigma for wave in waves], np.float32)
    pitches = [wave.period for wave in waves]
    phase, sigma = combine_beats(wrapped, sigmas, pitches, known_noise=True)
    measured = np.isfinite(wrapped).all(axis=0)
    share = float(np.isfinite(phase[measured]).mean()) if measured.any() else 1.0
    if share < _LEAST_CERTAIN:
        named = ", ".join(f"{pitch:g}" for pitch in pitches)
        raise PhaseError(
            f"the phases of pitches {named} px agree at {100 * share:.0f} % of the measured points only: set "
            f"correct_harmonics, check pitches and shifts, and {_ADVICE}",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    absolute = xr.DataArray(phase + TURN * middle / pitches[-1], dims=("row", "column"), attrs={"relative": 0})
    return WaveOrders(absolute, sigma, 1 - share, True, own)


def _beat(coarse: Wave, fine: Wave) -> Wave:
    """Return the difference of two waves, whose period is longer than both (heterodyne)."""
    period = 1 / (1 / fine.period - 1 / coarse.period)
    sigma = np.hypot(fine.sigma, coarse.sigma)
    return Wave(period, fine.phase - coarse.phase, sigma, origin=fine.origin - coarse.origin)


def _own_error(wave: Wave, description: FringeImageDescription) -> HarmonicError:
    """Return the harmonic error of a wave from its own phase; its ratio is NaN where too few fringes are in view."""
    phase = xr.DataArray(wave.phase - wave.origin, dims=("row", "column"))
    return fit_harmonic_error(phase, wave.shifts, description.orientation)
