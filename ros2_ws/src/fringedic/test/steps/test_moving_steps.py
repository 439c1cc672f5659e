"""Displacement of a specimen that is pulled at a constant rate while its frames are taken, on the virtual rig."""

from dataclasses import replace

import numpy as np

from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import WHITE, PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.rig.model import RigModel
from fringedic.steps import (
    CouplingParameters,
    DicParameters,
    DisplacementTracker,
    PhaseParameters,
    ShapeTracker,
    moving_phase_step,
    phase_step,
)
from fringedic.virtual_rig import ConstantRate, VirtualRig

INTERVAL = 0.05  # [s]
NOISE = PhaseParameters(read_noise_grey_level=1.04, shot_noise_grey_level=0.02)


def moving_stack(rig: VirtualRig, motion: ConstantRate, step: int) -> Stack:
    """Expose a stack whose finest pitch has its middle at time 0 of the motion."""
    rows, columns = rig.projector_shape
    fringes = [
        ProjectedPattern(PatternKind.FRINGES, pitch=pitch, shift=-k % count or count, shifts=count)
        for pitch, count in ((float(columns), 4), (columns / 4, 4), (10.0, 8))
        for k in range(1, count + 1)
    ]
    patterns = [*fringes[:8], WHITE, *fringes[8:], WHITE]
    times = INTERVAL * (np.arange(len(patterns)) - 12.5)
    frames = [
        rig.expose_moving(render_pattern(each, columns, rows), motion, time, 0.4 * INTERVAL, 100 * step + k, instants=2)
        for k, (each, time) in enumerate(zip(patterns, times, strict=True))
    ]
    stamps = [10**9 * (1 + 10 * step) + round(1e9 * time) for time in times]
    records = [
        FrameRecord("e", step, k, len(patterns), each, stamp, 0.4 * INTERVAL)
        for k, (each, stamp) in enumerate(zip(patterns, stamps, strict=True))
    ]
    return Stack("e", step, records, np.array(frames), stamps[-1])


def without_white(stack: Stack) -> Stack:
    """Return the fringe frames of a stack."""
    kept = [k for k, each in enumerate(stack.patterns) if each.kind == PatternKind.FRINGES]
    records = [replace(stack.records[k], index=index, count=len(kept)) for index, k in enumerate(kept)]
    return Stack(stack.experiment, stack.step, records, stack.frames[kept], records[-1].stamp)


def errors_of(rig: VirtualRig, rate: float) -> dict[str, float]:
    """Return the typical error of the displacement between two crosshead positions [m]; a rate of 0 is at rest."""
    displacement = DisplacementTracker(DicParameters(window=24))
    shape = ShapeTracker(CouplingParameters())
    shape.set_calibration(RigModel(**rig.optics()))
    for step, position in enumerate((3e-4, 6e-4)):
        stack = moving_stack(rig, ConstantRate(position, rate), step)
        if rate:
            phase = moving_phase_step(stack, NOISE)
            assert stack.time == 10**9 * (1 + 10 * step)
            assert phase.stamp == stack.stamp
            assert np.isfinite(phase.maps.drift.values).mean() > 0.5
        else:
            phase = phase_step(without_white(stack), NOISE)
        cloud = shape.step(phase, displacement.step("e", step, phase.stamp, phase.texture)).displacement
    truth = rig.truth(6e-4, 3e-4)
    assert float(np.isfinite(cloud.w).mean()) > 0.4
    return {name: float(abs(cloud[name] - truth[name]).median()) for name in ("u", "v", "w")}


def test_a_specimen_that_is_pulled_at_a_constant_rate_is_measured() -> None:
    """It is nearly as exact as at rest: u, v and w have 1.17, 1.09 and 1.06 times its error."""
    rig = VirtualRig.from_preset("plate", size="tiny")
    moving, resting = errors_of(rig, 2e-4), errors_of(rig, 0.0)
    assert moving["w"] < 1.15 * resting["w"], (moving, resting)
    assert max(moving[name] / resting[name] for name in ("u", "v")) < 1.3, (moving, resting)
