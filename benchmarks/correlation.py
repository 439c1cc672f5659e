"""The in-plane displacement's figures beside their targets, on exact speckle of 1.4 px and 15 % contrast, 12 bits.

Images are sums of Gaussian spots evaluated at displaced points; nothing is interpolated. Prints the table and leaves
the plots of transfer, bias and noise in docs/validation. Takes a few minutes.
"""

from __future__ import annotations

import time
from pathlib import Path
from runpy import run_path

import numpy as np
from matplotlib.figure import Figure

from fringedic.correlation import Reference, measure_displacement

ROOT = Path(__file__).resolve().parents[1]
# The tests' exact images.
EXACT = run_path(str(ROOT / "ros2_ws" / "src" / "fringedic" / "test" / "conftest.py"))
Speckle, camera = EXACT["Speckle"], EXACT["camera"]
PICTURES = ROOT / "docs" / "validation"
WINDOW = 36  # 90 % transfer at about 42 px
INNER = np.s_[..., 45:-45, 45:-45]
PERIODS = (150, 75, 60, 54, 50, 46, 43, 40, 37, 34, 30, 26, 20)


def uniform(dx: float, dy: float):
    """A rigid translation."""
    return lambda x, y: (np.full_like(x, dx), np.full_like(y, dy))


def components(field) -> np.ndarray:
    """(d_x, d_y) as one array (2, row, column)."""
    return np.stack([field.displacement_x, field.displacement_y])


def static_noise(surface: Speckle, window: int, pairs: int = 20) -> float:
    """Standard deviation of the displacement of static pairs with 31 grey levels of noise, the worse component."""
    grey = surface.grey()
    variance = [
        components(measure_displacement(camera(grey, 31, 1000 + k), camera(grey, 31, 2000 + k), window=window))[
            INNER
        ].var(axis=(1, 2))
        for k in range(pairs)
    ]
    return float(np.sqrt(np.mean(variance, axis=0).max()))


def transfer(surface: Speckle, window: int) -> dict[str, np.ndarray]:
    """Gains of both components of 0.1 px waves along x, y and 45 degrees against the 150 px wave."""
    reference = Reference(camera(surface.grey()), window=window)
    y, x = np.mgrid[: surface.shape[0], : surface.shape[1]].astype(float)
    gains: dict[str, np.ndarray] = {}
    for name, (ax, ay) in {"x": (1.0, 0.0), "y": (0.0, 1.0), "45 degrees": (0.5**0.5, 0.5**0.5)}.items():
        found = []
        for period in PERIODS:
            k = 2 * np.pi / period

            def wave(x: np.ndarray, y: np.ndarray, k: float = k, ax: float = ax, ay: float = ay):
                return (0.1 * np.sin(k * (ax * x + ay * y)),) * 2

            d = components(measure_displacement(reference, camera(surface.grey(wave))))[INNER].reshape(2, -1)
            phase = (k * (ax * x + ay * y))[INNER].ravel()
            basis = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)
            found.append(np.linalg.lstsq(basis, d.T, rcond=None)[0][0] / 0.1)
        gains[name] = np.array(found) / found[0]
    return gains


def cut_off(gains: dict[str, np.ndarray]) -> float:
    """Longest period at which any wave and component has lost 10 %."""
    worst = 0.0
    for gain in gains.values():
        for component in gain.T:
            k = int(np.argmax(component < 0.9))
            worst = max(worst, float(np.interp(0.9, component[[k, k - 1]], np.array(PERIODS, float)[[k, k - 1]])))
    return worst


def translations(surface: Speckle, window: int, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shifts, mean errors and standard deviations of the errors (shift, component) of rigid translations."""
    shifts = np.linspace(-0.5, 0.5, 11)
    grey = surface.grey()
    errors = []
    for k, t in enumerate(shifts):
        f, g = camera(grey, noise, 3000 + k), camera(surface.grey(uniform(t, t)), noise, 4000 + k)
        errors.append(components(measure_displacement(f, g, window=window))[INNER] - t)
    e = np.array(errors)
    return shifts, e.mean(axis=(2, 3)), e.std(axis=(2, 3))


def sine(surface: Speckle, period: float, window: int) -> float:
    """RMSE of d_x on a 0.02 px sin x sin field, 8 bits without noise."""

    def motion(x: np.ndarray, y: np.ndarray):
        return 0.02 * np.sin(2 * np.pi * x / period) * np.sin(2 * np.pi * y / period), np.zeros_like(x)

    f, g = (np.rint(surface.grey(m) / 16).clip(0, 255).astype(np.uint8) for m in (None, motion))
    y, x = np.mgrid[: surface.shape[0], : surface.shape[1]].astype(float)
    field = measure_displacement(f, g, window=window)
    return float(np.sqrt(np.mean((field.displacement_x.to_numpy() - motion(x, y)[0])[INNER] ** 2)))


def speed(shape: tuple[int, int] = (960, 1280), runs: int = 15) -> tuple[float, float]:
    """Median times of one new image against a known reference and of preparing the reference [s]."""
    surface = Speckle(shape, 5)
    f, g = surface.image(noise=10, seed=1), surface.image(uniform(0.3, -0.2), noise=10, seed=2)
    measure, prepare = [], []
    for _ in range(runs + 1):
        begin = time.perf_counter()
        reference = Reference(f)
        middle = time.perf_counter()
        measure_displacement(reference, g)
        prepare.append(middle - begin)
        measure.append(time.perf_counter() - middle)
    return float(np.median(measure[1:])), float(np.median(prepare[1:]))


def main() -> None:
    """Measure, print the table, save the plots."""
    surface = Speckle((640, 640), 77)
    print(f"{'figure':66s} {'measured':>12s} {'target':>10s}")

    def row(name: str, value: float, target: str, digits: int = 4) -> None:
        print(f"{name:66s} {value:12.{digits}f} {target:>10s}", flush=True)

    noise, gains = static_noise(surface, WINDOW), transfer(surface, WINDOW)
    cut = cut_off(gains)
    row(f"static noise, 31 GL, window {WINDOW} [px]", noise, "")
    row("period with 10 % amplitude loss, worst of waves and components [px]", cut, "<= 44", 1)
    row("noise x period [px^2]", noise * cut, "<= .35", 3)
    row("overshoot [%]", 100 * (max(float(gain.max()) for gain in gains.values()) - 1), "<= 5", 2)
    biases = {}
    for level, resolution, bias in ((0, "<= .0005", "<= .0001"), (31, "<= .0080", "<= .0005")):
        shifts, mean, deviation = biases[level] = translations(surface, WINDOW, level)
        row(f"resolution, {level} GL [px]", float(np.sqrt(np.mean(deviation**2))), resolution, 5)
        # The mean over both components halves the noise of the bias; errors are independent over about a window.
        points = 2 * (surface.shape[0] - 90) ** 2 / (cut / 2) ** 2
        row(f"bias, largest over the shifts, {level} GL [px]", float(np.abs(mean.mean(axis=1)).max()), bias, 5)
        row("    its standard error [px]", float(deviation.mean() / np.sqrt(points)), "", 5)
    for period, target in ((45, "<= .003"), (130, "<= .0012"), (260, "<= .0012")):
        row(f"0.02 px sine of {period} px, 8 bits, window 32: RMSE [px]", sine(surface, period, 32), target, 5)
    row("0.02 px sine of 260 px, window 96: RMSE [px]", sine(surface, 260, 96), "<= .0007", 5)
    measure, prepare = speed()
    row("1280x960, every pixel, uncertainty and validity included [s]", measure, "<= .08", 3)
    row("    million points per second", 1.2288 / measure, "", 1)
    row("    preparing the reference [s]", prepare, "", 3)

    PICTURES.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, gain in gains.items():
        left.plot(PERIODS, gain[:, 0], "o-", label=f"waves along {name}, d_x")
        left.plot(PERIODS, gain[:, 1], "s--", label=f"waves along {name}, d_y")
    left.axhline(0.9, color="grey", lw=0.8)
    left.set(xlabel="period [px]", ylabel="gain", title=f"Transfer, window {WINDOW} px", xscale="log")
    left.legend(fontsize=7)
    for level, (shifts, mean, deviation) in biases.items():
        right.errorbar(shifts, mean[:, 0], deviation[:, 0], fmt="o-", capsize=3, label=f"{level} GL")
    right.set(xlabel="translation [px]", ylabel="error of d_x [px]", title="Mean and standard deviation of the error")
    right.legend()
    figure.savefig(PICTURES / "correlation.png", dpi=120)


if __name__ == "__main__":
    main()
