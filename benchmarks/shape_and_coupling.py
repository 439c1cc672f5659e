"""Time of each step from frames to strain on full images, beside its target.

Frames come from the digital twin at 1280x960 (8-bit, misaligned rig); the displacement is the twin's own. Every time is
the best of several runs after the kernels are compiled.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numba
import numpy as np

from fringedic.patterns import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.rig import RigModel
from fringedic.surface import couple, surface_strain, to_local_frame
from fringedic.virtual_rig import VirtualRig

RUNS = 7


def milliseconds(work: Callable[[], object]) -> float:
    """Return the best time of several runs [ms]."""
    work()
    times = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def main() -> None:
    """Measure and print the table."""
    twin = VirtualRig.from_preset("plate")
    rig = RigModel(**twin.optics())
    distorted = dataclasses.replace(rig, projector_k1=0.1)
    sequence = fringe_sequence(rig.projector_width, rig.projector_height, [800, 160, 40, 10], [4, 4, 4, 8])
    projections = list(sequence.projections)
    position = 0.2 * twin.maximum_position
    stacks = [
        np.array([twin.expose(image, crosshead, 100 * step + index) for index, image in enumerate(sequence)])
        for step, crosshead in enumerate((0.0, position))
    ]
    phases = [absolute_phase(frames, projections) for frames in stacks]
    shapes = [rig.reconstruct(each.phase, 10.0, each.sigma) for each in phases]
    truth = twin.truth(position)
    displacement = truth[["displacement_x", "displacement_y"]].assign(
        sigma_x=0 * truth.displacement_x, sigma_y=0 * truth.displacement_y
    )
    cloud = couple(*shapes, displacement, z_filter=2.0)
    finest = slice(-8, None)
    rows: list[tuple[str, Callable[[], object], float | None]] = [
        ("absolute phase, 20 frames", lambda: absolute_phase(stacks[0], projections), 120),
        ("phase, 8 frames", lambda: absolute_phase(stacks[0][finest], projections[finest]), 40),
        ("reconstruction", lambda: rig.reconstruct(phases[0].phase, 10.0, phases[0].sigma), 25),
        ("reconstruction, distorted", lambda: distorted.reconstruct(phases[0].phase, 10.0, phases[0].sigma), 25),
        ("coupling", lambda: couple(*shapes, displacement), None),
        ("coupling, filter of 2 px", lambda: couple(*shapes, displacement, z_filter=2.0), None),
        ("local frame", lambda: to_local_frame(cloud), None),
        ("strain over 85 px", lambda: surface_strain(cloud, window=85), None),
    ]
    print(f"{'1280x960, ' + str(numba.get_num_threads()) + ' threads':32} {'ms':>8} {'target':>8}")
    for name, work, target in rows:
        print(f"{name:32} {milliseconds(work):8.1f} {target if target is not None else '-':>8}")


if __name__ == "__main__":
    main()
