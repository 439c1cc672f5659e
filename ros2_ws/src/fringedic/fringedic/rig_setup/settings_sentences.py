"""Sentences about recommended settings and a measured noise floor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from fringedic.metadata import NOISE_COLUMNS, NoiseFloorMetadata
from fringedic.rig_setup.advice import Advice, SettingsProblem, SettingsWarning


def settings_report(advice: Advice) -> str:
    """Return an advice as text: images, settings, noise floors, other subsets and warnings, one line each."""
    lines = [*_images(advice), *_settings(advice), *_noise_floors(advice)]
    out = [f"  {name:28s} {text}" if name else f"\n{text}" for name, text in lines]
    out.append("\nOther subsets: expected noise and spatial resolution")
    out += [f"  {window:4d} px   {noise:.4f} px   {period:4.0f} px" for window, noise, period in advice.table]
    if advice.warnings:
        out += ["\nBefore the test", *(f"  - {warning_sentence(warning, advice)}" for warning in advice.warnings)]
    return "\n".join(out).lstrip("\n")


def warning_sentence(warning: SettingsWarning, advice: Advice) -> str:
    """Return the sentence of one warning of an advice."""
    return _SENTENCES[warning.problem](warning, advice)


def _images(advice: Advice) -> list[tuple[str, str]]:
    """Return the lines (name, text) about the images; an empty name begins a section."""
    known = math.isfinite(advice.full_scale)

    def percent(value: float) -> str:
        return f" ({100 * value / advice.full_scale:.1f} %)" if known else ""

    low, high = advice.grey_range
    return [
        ("", "Images (x / y: right / down)"),
        ("image resolution", f"{advice.shape[1]} x {advice.shape[0]} px"),
        ("full scale", f"{advice.full_scale:g} in steps of {advice.quantisation:g}" if known else "not known"),
        ("grey levels, 1 % to 99 %", f"{low:.0f}{percent(low)} to {high:.0f}{percent(high)}"),
        ("saturated, black", f"{100 * advice.saturated:.2f} %, {100 * advice.dark:.2f} % of the pixels"),
        ("dark coverage", f"{100 * advice.coverage:.0f} % (about 50 % is best)"),
        ("image noise", f"{advice.image_noise:.2f} grey levels{percent(advice.image_noise)}"),
        ("contrast", f"{advice.contrast:.1f} grey levels{percent(advice.contrast)}"),
        ("feature size", f"{advice.feature_size[0]:.2f} / {advice.feature_size[1]:.2f} px (3 to 5 px are best)"),
        ("mean intensity gradient", f"{advice.mean_gradient:.1f} grey levels/px"),
    ]


def _settings(advice: Advice) -> list[tuple[str, str]]:
    def length(pixels: float) -> str:
        return f"{pixels:.0f} px" + (
            "" if advice.pixel_size is None else f" ({1e3 * advice.pixel_size * pixels:.3g} mm)"
        )

    features = advice.subset / math.sqrt(advice.feature_size[0] * advice.feature_size[1])
    binned = "" if advice.binning == 1 else f"{advice.window} px with binning by {advice.binning}: "
    strain_window = (advice.strain_window - 1) * advice.spacing + 1
    return [
        ("", "Settings"),
        ("window (width of the subset)", f"{binned}{length(advice.subset)}, {features:.1f} features"),
        ("spacing (of the points)", length(advice.spacing)),
        ("spatial resolution", f"{length(advice.period)}: shortest period that keeps 90 % of its amplitude"),
        ("strain window", f"{strain_window} px ({advice.strain_window} points)"),
        ("virtual strain gauge", f"{length(advice.gauge_length)}: strain window + window - 1"),
        ("with them", f"fringedic measure ... {advice.options}"),
    ]


def _noise_floors(advice: Advice) -> list[tuple[str, str]]:
    def displacement(values: tuple[float, float]) -> str:
        size = advice.pixel_size
        text = " / ".join(f"{value:z.4f}" for value in values) + " px"
        return text + ("" if size is None else " (" + " / ".join(f"{1e6 * size * v:.3g}" for v in values) + " µm)")

    return [
        ("", "Noise floors of these settings (x / y)"),
        ("displacement, spatial", displacement(advice.noise)),
        ("  predicted from the images", displacement(advice.noise_predicted)),
        ("displacement, temporal", displacement(advice.noise_temporal)),
        ("displacement, bias", displacement(advice.bias)),
        ("strain e_xx / e_yy / e_xy", " / ".join(f"{1e6 * value:.0f}" for value in advice.strain_noise) + " µstrain"),
        ("  which is", "that of the in-plane displacement alone: planes over the strain window"),
        ("method", "two static images against the reference; spatial: over the points, averaged over both images;"),
        ("  ", "temporal: between both images, averaged over the points"),
    ]


def _noise_out_of_reach(warning: SettingsWarning, advice: Advice) -> str:
    return (
        f"a noise of {advice.wanted_noise:g} px needs a subset of {warning.limit:.0f} px, more than these images "
        f"allow; expect {warning.value:.2g} px, or average several images or light the surface better"
    )


def _period_too_few_features(warning: SettingsWarning, _: Advice) -> str:
    return (
        f"waves of {warning.value:g} px lose more than 10 % of their amplitude: a subset that keeps them would contain "
        f"fewer than {warning.limit:.0f} features"
    )


def _period_too_noisy(warning: SettingsWarning, advice: Advice) -> str:
    return (
        f"waves of {warning.value:g} px lose more than 10 % of their amplitude: a subset that keeps them would have a "
        f"noise of {warning.limit:.2g} px, and {advice.wanted_noise:g} px are requested"
    )


def _underexposed(warning: SettingsWarning, _: Advice) -> str:
    return f"the brightest pixels reach {100 * warning.value:.0f} % of the range: more light lowers the noise"


def _quantised(warning: SettingsWarning, _: Advice) -> str:
    return (
        f"the noise of {warning.value:.2g} grey levels is less than half a grey level: quantisation errors repeat in "
        "static images, and the errors of a test are larger than the noise floor"
    )


def _excess_noise(warning: SettingsWarning, _: Advice) -> str:
    return (
        f"the displacement scatters by {warning.value:.2g} px, image noise explains {warning.limit:.2g} px: look for "
        "vibration, warm air, a moving lens or flicker"
    )


def _periodic(warning: SettingsWarning, advice: Advice) -> str:
    size = "" if advice.pixel_size is None else f" ({1e3 * advice.pixel_size * warning.value:.3g} mm)"
    return (
        f"the texture repeats every {warning.value:.1f} px{size}: a displacement of more than {warning.limit:.1f} px "
        "between two images is known up to multiples of it unless irregularities of the texture decide; add a random "
        "pattern, or take images in small steps"
    )


def _faint(warning: SettingsWarning, advice: Advice) -> str:
    cause = f"with a gradient energy of only {warning.value:.1f} times that of noise, the texture is faint"
    if advice.binning == 1:
        return f"{cause}, and fewer points are measured: use more light, finer features, a larger window or binning"
    return (
        f"{cause}: blocks of {advice.binning} x {advice.binning} px are averaged, and a window of {advice.window} px "
        f"is a subset of {advice.subset} px; more light or finer features allow a narrower one"
    )


_SENTENCES: dict[SettingsProblem, Callable[[SettingsWarning, Advice], str]] = {
    SettingsProblem.NOISE_OUT_OF_REACH: _noise_out_of_reach,
    SettingsProblem.PERIOD_TOO_FEW_FEATURES: _period_too_few_features,
    SettingsProblem.PERIOD_TOO_NOISY: _period_too_noisy,
    SettingsProblem.SMALL_FEATURES: lambda warning, _: (
        f"features of {warning.value:.1f} px are small: below {warning.limit:g} px they alias; defocus or go closer"
    ),
    SettingsProblem.LARGE_FEATURES: lambda warning, _: (
        f"features of {warning.value:.1f} px are large: 3 to 5 px give less noise in the same subset"
    ),
    SettingsProblem.SATURATED: lambda warning, _: (
        f"{100 * warning.value:.1f} % of the pixels are saturated: shorten the exposure or reduce reflections"
    ),
    SettingsProblem.DARK: lambda warning, _: (
        f"{100 * warning.value:.1f} % of the pixels are black: raise the camera's black level or the light"
    ),
    SettingsProblem.UNDEREXPOSED: _underexposed,
    SettingsProblem.QUANTISED: _quantised,
    SettingsProblem.EXCESS_NOISE: _excess_noise,
    SettingsProblem.MOVED: lambda warning, _: (
        f"the specimen or the camera has moved by {warning.value:.2g} px: the images are not static"
    ),
    SettingsProblem.PERIODIC: _periodic,
    SettingsProblem.FAINT: _faint,
}


def noise_floor_text(metadata: NoiseFloorMetadata) -> str:
    """Return a noise floor as lines of text: camera, then displacement, height and strain as a table."""
    camera = (
        f"{metadata.read_noise_grey_level:g} grey levels without light, and a variance of "
        f"{metadata.shot_noise_grey_level:g} per grey level of brightness"
    )
    lines = [
        f"noise floor of {metadata.steps} steps at rest",
        f"  camera: {camera}; the light flickers by {metadata.flicker_percent:g} %",
        _row("", NOISE_COLUMNS),
        *(_row(f"{quantity.title} [{quantity.unit}]", cells) for quantity, cells in metadata.table()),
    ]
    widths = {"window": metadata.window_px, "spacing": metadata.spacing_px, "strain window": metadata.strain_window_px}
    lines.append("  with " + ", ".join(f"{name} {width} px" for name, width in widths.items() if width))
    return "\n".join(lines)


def _row(title: str, cells: Sequence[str]) -> str:
    return f"  {title:34s}" + "".join(f"{cell:>13s}" for cell in cells)
