"""Error over stated uncertainty of the projector's delay, from simulated measurements beside its target.

The light of every exposure is known exactly; the seeds are of no test.
"""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from correlation_study.scenes import load_test

from fringedic.rig_setup.timing import measure_timing
from fringedic.virtual_rig.configuration import ProjectorConfiguration

SEEDS = range(1000, 1060)
CHANGES, NOISE = 60, 1.0  # changes of the pattern, noise [grey level] of 106
PULSES = {"delay_ms": 37.0, "refresh_hz": 60.0, "refresh_duty": 0.5}
CASES = {
    "pulses of 60 Hz, exposures of 3 ms": (PULSES, 3e-3),
    "pulses of 60 Hz, exposures of 1 ms": (PULSES, 1e-3),
    "steady light, exposures of 3 ms": ({"delay_ms": 37.0}, 3e-3),
    "steady light, delays spread by 4 ms": ({"delay_ms": 45.0, "jitter_ms": 4.0}, 3e-3),
}
frames = load_test("rig_setup/test_timing.py").frames


def error_and_sigma(task: tuple[str, int]) -> tuple[float, float]:
    """Return the error of a measured delay and its standard uncertainty [ms]."""
    case, seed = task
    projector, exposure = CASES[case]
    light = ProjectorConfiguration(**projector)
    timing = measure_timing(frames(light, changes=CHANGES, seed=seed, noise=NOISE, exposure=exposure))
    return 1e3 * timing.delay - light.delay_ms, 1e3 * timing.delay_sigma


def main() -> None:
    """Measure all cases and print them."""
    print(f"{len(SEEDS)} measurements each; target of the z-score: 0.9 to 1.1")
    with ProcessPoolExecutor() as pool:
        for case in CASES:
            error, sigma = np.array(list(pool.map(error_and_sigma, [(case, seed) for seed in SEEDS], chunksize=4))).T
            score = np.sqrt(np.mean((error / sigma) ** 2))
            rms = np.sqrt(np.mean(error**2))
            print(f"{case}: RMS error {rms:.3f} ms, median sigma {np.median(sigma):.3f} ms, z-score {score:.2f}")


if __name__ == "__main__":
    main()
