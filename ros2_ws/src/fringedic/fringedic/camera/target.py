"""The printable grid for `fringedic.measure_distortion`: lines of exact pitch, and a ruler to check the scale.

It is written as rectangles, without a drawing library: the file contains the geometry in millimetre without rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from fringedic.errors import GridError

PAGES = {"A4": (297.0, 210.0), "A3": (420.0, 297.0)}  # width and height [mm], landscape
_MARGIN = 12.0  # [mm] printers do not print on the edge of the paper
_FOOT = 20.0  # [mm] under the grid, for ruler and text
_RULER = 100.0  # [mm]
_CROSS = 8.0  # [mm] length of the marks at the centre lines of the grid
_FINEST = 0.2  # [mm] a line of 0.1 mm is 2.4 dots of a printer with 600 dots per inch
_FEWEST = 12  # periods along the shorter side; `find_carriers` needs as many
_POINTS_PER_MM = 72 / 25.4
_TEXT_MM = 3.2


@dataclass(frozen=True)
class Rectangle:
    """A black rectangle [mm], from the page's lower left corner; `turned` ones belong to the grid."""

    x: float
    y: float
    width: float
    height: float
    turned: bool = False


@dataclass(frozen=True)
class Target:
    """A page with a grid of crossed lines, half black and half white along each direction.

    Attributes
    ----------
    pitch
        Period of the lines along both directions [m].
    page
        "A4" or "A3", landscape.
    turn
        Turn of the grid on the page [rad], counter-clockwise, so that the period of a sheet that is parallel to the
        camera is not a multiple of the pixel.

    Raises
    ------
    GridError
        The page is unknown, or the pitch is too fine to be printed or too coarse for the page.

    Examples
    --------
    >>> from fringedic.camera.target import Target
    >>> target = Target(pitch=0.5e-3, page="A4")
    >>> target.area
    (12.0, 32.0, 273.0, 166.0)
    """

    pitch: float
    page: str = "A4"
    turn: float = math.radians(2.0)

    def __post_init__(self) -> None:
        if self.page not in PAGES:
            raise GridError(f"page {self.page!r} is unknown; choose from {', '.join(PAGES)}")
        if not abs(self.turn) <= math.pi / 4:
            raise GridError(f"the grid cannot be turned by {math.degrees(self.turn):g} degree; 45 are the most")
        _, _, width, height = self.area
        pitch = 1e3 * self.pitch
        if not pitch >= _FINEST:
            raise GridError(f"lines of {pitch:g} mm pitch cannot be printed; {_FINEST} mm is the finest")
        if pitch > min(width, height) / _FEWEST:
            raise GridError(f"a pitch of {pitch:g} mm is too coarse for {self.page}: fewer than {_FEWEST} periods")

    @property
    def area(self) -> tuple[float, float, float, float]:
        """x, y, width and height of the grid on the page [mm], y upwards."""
        width, height = PAGES[self.page]
        return _MARGIN, _MARGIN + _FOOT, width - 2 * _MARGIN, height - 2 * _MARGIN - _FOOT

    def rectangles(self) -> list[Rectangle]:
        """Return the black rectangles, without the text.

        Turned rectangles are given before the rotation about the centre of the area, which clips them: first the lines
        along y, then those along x, one of each through the centre.
        """
        x, y, width, height = self.area
        centre_x, centre_y = x + width / 2, y + height / 2
        pitch, reach = 1e3 * self.pitch, 0.5 * math.hypot(width, height)
        count = math.ceil(reach / pitch)
        offsets = [n * pitch - pitch / 4 for n in range(-count, count + 1)]
        black = [
            Rectangle(centre_x + offset, centre_y - reach, pitch / 2, 2 * reach, turned=True) for offset in offsets
        ]
        black += [
            Rectangle(centre_x - reach, centre_y + offset, 2 * reach, pitch / 2, turned=True) for offset in offsets
        ]
        # outside the grid, because a mark inside would disturb its phase
        thin = 0.3
        black += [
            Rectangle(centre_x - thin / 2, y - _CROSS - 1, thin, _CROSS),
            Rectangle(centre_x - thin / 2, y + height + 1, thin, _CROSS),
            Rectangle(x - _CROSS - 1, centre_y - thin / 2, _CROSS, thin),
            Rectangle(x + width + 1, centre_y - thin / 2, _CROSS, thin),
        ]
        black.append(Rectangle(x, _MARGIN, _RULER, thin))
        black += [
            Rectangle(x + ten - thin / 2, _MARGIN, thin, 5.0 if ten in (0, _RULER) else 2.5)
            for ten in range(0, int(_RULER) + 1, 10)
        ]
        return black

    def text(self) -> tuple[float, float, str]:
        """Return x and y [mm] of the text beside the ruler, and the text."""
        x, _, _, _ = self.area
        words = (
            f"pitch {1e3 * self.pitch:g} mm, {self.page} | print at 100 %; the ruler is {_RULER:g} mm long. "
            f"If it is not: pitch = {1e3 * self.pitch:g} mm x measured length / {_RULER:g} mm"
        )
        return x, _MARGIN + 7.0, words

    def save(self, path: str | Path) -> None:
        """Write the page as PDF or SVG, depending on the ending of the name.

        Raises
        ------
        GridError
            The name has another ending.
        """
        path = Path(path)
        formats = {".pdf": self._pdf, ".svg": self._svg}
        if path.suffix.lower() not in formats:
            raise GridError(f"{path}: the grid is written as .pdf or .svg")
        path.write_bytes(formats[path.suffix.lower()]())

    def _svg(self) -> bytes:
        width, height = PAGES[self.page]
        x, y, area_width, area_height = self.area
        top = height - y - area_height  # SVG counts from the top
        centre = f"{x + area_width / 2:.6g} {top + area_height / 2:.6g}"

        def drawn(black: Rectangle) -> str:
            upper = height - black.y - black.height
            return f'<rect x="{black.x:.6f}" y="{upper:.6f}" width="{black.width:.6f}" height="{black.height:.6f}"/>'

        black = self.rectangles()
        text_x, text_y, words = self.text()
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
            f'viewBox="0 0 {width:g} {height:g}">',
            f'<clipPath id="area"><rect x="{x:g}" y="{top:g}" width="{area_width:g}" height="{area_height:g}"/>'
            "</clipPath>",
            '<g clip-path="url(#area)">',
            f'<g id="grid" transform="rotate({-math.degrees(self.turn):.6f} {centre})">',
            *(drawn(each) for each in black if each.turned),
            "</g></g>",
            '<g id="marks">',
            *(drawn(each) for each in black if not each.turned),
            "</g>",
            f'<text x="{text_x:g}" y="{height - text_y:g}" font-size="{_TEXT_MM}" font-family="sans-serif">{words}'
            "</text>",
            "</svg>",
        ]
        return "\n".join(lines).encode()

    def _pdf(self) -> bytes:
        """Return one page; the content is in millimetre, scaled to points as a whole."""
        width, height = PAGES[self.page]
        x, y, area_width, area_height = self.area
        centre_x, centre_y = x + area_width / 2, y + area_height / 2
        c, s = math.cos(self.turn), math.sin(self.turn)
        shift_x, shift_y = centre_x - c * centre_x + s * centre_y, centre_y - s * centre_x - c * centre_y

        def drawn(black: Rectangle) -> str:
            return f"{black.x:.6f} {black.y:.6f} {black.width:.6f} {black.height:.6f} re"

        black = self.rectangles()
        text_x, text_y, words = self.text()
        content = "\n".join(
            [
                f"{_POINTS_PER_MM:.9f} 0 0 {_POINTS_PER_MM:.9f} 0 0 cm",
                "q",
                f"{x:g} {y:g} {area_width:g} {area_height:g} re W n",
                f"{c:.9f} {s:.9f} {-s:.9f} {c:.9f} {shift_x:.9f} {shift_y:.9f} cm",
                # separate paths: in one path the winding rule would decide on the colour of the crossings
                *(f"{drawn(each)} f" for each in black if each.turned),
                "Q",
                *(f"{drawn(each)} f" for each in black if not each.turned),
                f"BT /F1 {_TEXT_MM} Tf {text_x:g} {text_y:g} Td ({words}) Tj ET",
            ]
        ).encode()
        box = f"[0 0 {width * _POINTS_PER_MM:.4f} {height * _POINTS_PER_MM:.4f}]"
        objects = [
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
            "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
            f"<< /Length {len(content)} >>\nstream\n".encode() + content + b"\nendstream",
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        ]
        file = bytearray(b"%PDF-1.4\n")
        places = []
        for number, each in enumerate(objects, start=1):
            places.append(len(file))
            file += f"{number} 0 obj\n".encode() + each + b"\nendobj\n"
        table = len(file)
        file += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode()
        file += b"".join(f"{place:010d} 00000 n \n".encode() for place in places)
        file += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n".encode()
        return bytes(file)
