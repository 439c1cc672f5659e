"""Text of a noise floor."""

from __future__ import annotations

from collections.abc import Sequence

from fringedic.metadata import NOISE_COLUMNS, NoiseFloorMetadata


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
