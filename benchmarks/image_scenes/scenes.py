"""Scenes drawn from their number: texture, motion, what moves apart or in front, light, noise and compression."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from image_scenes.layers import Cover, Layer, Line, Rectangle, Shape, View
from image_scenes.motions import STILL, Affine, Motion, Opening, Sequence, Wave
from image_scenes.textures import Box, Grid, Mixture, Plain, Skin, Spots, Stripes, Texture, Weave

# Share of the scenes; no displacement can be measured in those of the second list, for the reason that it names.
TEXTURES = {"speckle": 0.38, "grid": 0.1, "weave": 0.1, "dots": 0.12, "skin": 0.15}
HOPELESS = {
    "stripes": 0.05,
    "too faint": 0.02,
    "too fine": 0.02,
    "too coarse": 0.02,
    "unrelated": 0.02,
    "moved out": 0.02,
}
KINDS = {"plain": 0.49, "part moved": 0.17, "occluder": 0.17, "crack": 0.17}
PERIODIC = ("grid", "weave", "dots")
SMALL, LARGE = (480, 640), (960, 1280)
OVERLAP = 0.35  # smallest share of the reference that remains in the image
FINE = 4.0  # [px] is the diameter of spots below which a pixel needs more samples
MARGIN = 40.0  # [px] around what is seen of a surface


@dataclass(frozen=True)
class Exposure:
    """Light and camera: grey levels of 8 bits, static vignetting, another light for the deformed image."""

    dark: float
    contrast: float  # [grey levels] from ink to paper
    vignette: float  # loss of light in the corners
    gain: float  # of the light of the deformed image
    slope: tuple[float, float]  # relative change of this light across the image
    noise: float  # standard deviation [grey levels]
    quality: int | None  # of the JPEG compression

    def grey(self, brightness: np.ndarray, *, moved: bool) -> np.ndarray:
        """Return grey levels before noise and rounding."""
        rows, columns = brightness.shape
        y, x = np.mgrid[-0.5 : 0.5 : rows * 1j, -0.5 : 0.5 : columns * 1j]
        light = 1 - self.vignette * 2 * (x**2 + y**2)
        if moved:
            light = light * self.gain * (1 + self.slope[0] * x + self.slope[1] * y)
        grey: np.ndarray = self.dark + self.contrast * light * brightness
        return grey

    def record(self, grey: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Return the image as it is stored."""
        image = np.clip(np.rint(grey + random.normal(0, self.noise, grey.shape)), 0, 255).astype(np.uint8)
        if self.quality is None:
            return image
        done, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        if not done:
            raise ArithmeticError("OpenCV cannot compress the image as JPEG")
        return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))


@dataclass(frozen=True)
class Pair:
    """Both images of a scene.

    Attributes
    ----------
    reference, deformed : (row, column) uint8
        The images.
    clean : (row, column)
        The reference without noise, rounding and compression.
    noise
        Root of the mean variance of both images around their exact grey levels.
    """

    reference: np.ndarray
    deformed: np.ndarray
    clean: np.ndarray
    noise: float


@dataclass(frozen=True)
class Scene:
    """A random scene.

    Attributes
    ----------
    number
        The seed.
    texture, kind
        Keys of `TEXTURES` or `HOPELESS`, and of `KINDS`.
    words
        Its figures in words.
    view
        Surfaces and camera.
    surface
        Texture of the specimen; an occluder has another one, and so has what a moved part reveals.
    exposure
        Light, noise and compression.
    lattice
        The two periods (rows) of the surface [px], None where no displacement repeats.
    """

    number: int
    texture: str
    kind: str
    words: str
    view: View
    surface: Texture
    exposure: Exposure
    lattice: np.ndarray | None

    @classmethod
    def random(cls, number: int) -> Scene:
        """Draw the scene of a number."""
        return _Draw(number).scene()

    @property
    def hopeless(self) -> bool:
        """Whether nothing can be measured, and a refusal with the reason is right."""
        return self.texture in HOPELESS

    def render(self) -> Pair:
        """Return both images."""
        random = np.random.default_rng((self.number, 2))
        clean = [self.exposure.grey(self.view.image(moved=moved), moved=moved) for moved in (False, True)]
        images = [self.exposure.record(each, random) for each in clean]
        variance = np.mean([np.mean((image - grey) ** 2) for image, grey in zip(images, clean, strict=True)])
        return Pair(images[0], images[1], clean[0], float(np.sqrt(variance)))


@dataclass(frozen=True)
class Surface:
    """A drawn texture: its figures in words, its periods as in `Scene`, and the samples that a pixel needs."""

    texture: Texture
    words: str
    lattice: np.ndarray | None = None
    samples: int = 2


def _choose(shares: dict[str, float], random: np.random.Generator) -> str:
    shares_of_all = np.array(list(shares.values()))
    return str(random.choice(list(shares), p=shares_of_all / shares_of_all.sum()))


def _one_of(random: np.random.Generator, ranges: list[tuple[float, float, float]]) -> float:
    """Return a number from one of some ranges (share of the scenes, least, largest)."""
    k = random.choice(len(ranges), p=[each[0] for each in ranges])
    return float(random.uniform(*ranges[k][1:]))


def rotation(angle: float) -> np.ndarray:
    """Return the matrix of a rotation [rad]."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def stretch(strain: float, direction: float) -> np.ndarray:
    """Return the stretch of uniaxial tension along a direction [rad], with a Poisson's ratio of 0.3."""
    turn = rotation(direction)
    return np.asarray(turn @ np.diag([1 + strain, 1 - 0.3 * strain]) @ turn.T)


class _Draw:
    """The random decisions of one scene, in a fixed order."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.random = random = np.random.default_rng((number, 1))
        self.texture = _choose(TEXTURES | HOPELESS, random)
        self.kind = _choose(KINDS, random) if self.texture in TEXTURES else "plain"
        self.shape: Shape = LARGE if random.random() < 0.1 else SMALL
        self.centre = (self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2
        self.words: list[str] = []

    def scene(self) -> Scene:
        """Return the scene."""
        layers = self._layers()
        # The area that a texture has to fill follows from the motions.
        box = self._box(layers)
        surface = self._surface(box, self.random)
        self.words.append(surface.words)
        later = self._surface(box, self.random).texture if self.texture == "unrelated" else None
        textures = {id(_TO_COME): surface.texture}
        if self.kind == "part moved":
            # with the texture that the part had there, a part that stands still would explain its rim as well
            textures[id(_REVEALED)] = self._surface(box, np.random.default_rng((self.number, 3))).texture
        layers = tuple(
            replace(each, texture=textures[id(each.texture)], later=later) if id(each.texture) in textures else each
            for each in layers
        )
        view, exposure = View(self.shape, layers, surface.samples), self._exposure()
        words = ", ".join(self.words)
        return Scene(self.number, self.texture, self.kind, words, view, surface.texture, exposure, surface.lattice)

    def _layers(self) -> tuple[Layer, ...]:
        if self.texture == "moved out":
            return (Layer(_TO_COME, self._moved_out()),)
        gentle = {"plain": 0.0, "part moved": 1.0}.get(self.kind, 0.6)
        still = self.kind == "part moved" and self.random.random() < 0.6
        motion = STILL if still else self._motion(gentle=self.random.random() < gentle)
        if self.kind == "part moved":
            return self._part(motion)
        if self.kind == "occluder":
            return (self._occluder(), Layer(_TO_COME, motion))
        if self.kind == "crack":
            return self._crack(motion)
        return (Layer(_TO_COME, motion),)

    # motions

    def _motion(self, *, gentle: bool) -> Motion:
        """Return an affine motion that keeps enough of the surface in the image, in some scenes with a wave."""
        random = self.random
        if gentle:
            ranges = [(1.0, 0.0, 3.0)], [(1.0, 0.0, 0.02)], [(1.0, 0.0, 20.0)]
        elif self.texture in PERIODIC:
            # a lattice looks the same after some rotations, which would be another ambiguity than its period
            ranges = [(1.0, 0.0, 15.0)], [(1.0, 0.0, 0.05)], [(0.4, 0, 3), (0.35, 3, 40), (0.25, 40, 300)]
        else:
            ranges = (
                [(0.4, 0.0, 2.0), (0.35, 2.0, 30.0), (0.25, 30.0, 180.0)],
                [(0.5, 0.0, 0.02), (0.3, 0.02, 0.15), (0.2, 0.15, 0.6)],
                [(0.4, 0.0, 3.0), (0.35, 3.0, 40.0), (0.25, 40.0, 300.0)],
            )
        degrees = _one_of(random, ranges[0]) * random.choice([-1, 1])
        strain, size = _one_of(random, ranges[1]), _one_of(random, ranges[2])
        gradient = rotation(math.radians(degrees)) @ stretch(strain, random.uniform(0, math.pi))
        if random.random() < 0.3:
            gradient = np.linalg.inv(gradient)  # compression
        waves: tuple[Motion, ...] = ()
        if random.random() < 0.4:
            angle, wavelength = random.uniform(0, 2 * math.pi), random.uniform(320, 700)
            number = 2 * math.pi / wavelength * np.array([math.cos(angle), math.sin(angle)])
            amplitude, direction = random.uniform(0.3, 3), random.uniform(0, 2 * math.pi)
            waves = (
                Wave(
                    (amplitude * math.cos(direction), amplitude * math.sin(direction)),
                    (float(number[0]), float(number[1])),
                    random.uniform(0, 2 * math.pi),
                ),
            )
        # directions are tried until enough of the surface remains in the image, then shorter ways
        for attempt in range(200):
            way, length = random.uniform(0, 2 * math.pi), size * 0.97 ** max(attempt - 20, 0)
            translation = (length * math.cos(way), length * math.sin(way))
            motion = Sequence((Affine(gradient, self.centre, translation), *waves))
            if View(self.shape, (Layer(_TO_COME, motion),)).truth(32).visible.mean() >= OVERLAP:
                break
        self.words += [
            f"rotation {degrees:.1f} degrees",
            f"strain {100 * strain:.1f} %",
            f"translation {length:.1f} px",
        ]
        self.words += ["wave"] if waves else []
        return motion

    def _moved_out(self) -> Motion:
        way, length = self.random.uniform(0, 2 * math.pi), self.random.uniform(1.3, 2) * math.hypot(*self.shape)
        self.words.append(f"translation {length:.0f} px")
        return Affine(np.eye(2), self.centre, (length * math.cos(way), length * math.sin(way)))

    def _place(self, margin: float) -> tuple[float, float]:
        """Return a place in the image; `margin` is the excluded part on each side."""
        rows, columns = self.shape
        return (
            float(columns * self.random.uniform(margin, 1 - margin)),
            float(rows * self.random.uniform(margin, 1 - margin)),
        )

    # what moves apart or in front

    def _part(self, rest: Motion) -> tuple[Layer, ...]:
        """Return a part of the surface, the rest with a hole in the part's place, and what is seen through the hole."""
        random = self.random
        place, angle = self._place(0.3), random.uniform(0, math.pi)
        half = random.uniform(0.1, 0.3) * self.shape[1], random.uniform(0.15, 0.3) * self.shape[0]
        size, way = float(np.exp(random.uniform(math.log(2), math.log(60)))), random.uniform(0, 2 * math.pi)
        degrees, strain = random.choice([0, random.uniform(-8, 8)]), random.choice([0, random.uniform(0, 0.05)])
        gradient = rotation(math.radians(degrees)) @ stretch(strain, random.uniform(0, math.pi))
        own = Affine(gradient, place, (size * math.cos(way), size * math.sin(way)))
        self.words.append(f"part moved by {size:.1f} px, {degrees:.1f} degrees, {100 * strain:.1f} %")
        edge = Rectangle(place, half, angle, random.uniform(5, 0.9 * min(half)))
        return (
            Layer(_TO_COME, Sequence((own, rest)), edge.inside),
            Layer(_TO_COME, rest, edge.outside),
            Layer(_REVEALED, rest),
        )

    def _occluder(self) -> Layer:
        random = self.random
        place, angle = self._place(0.25), random.uniform(0, math.pi)
        degrees, size = random.uniform(-3, 3), random.uniform(2, 40)
        # it moves across itself
        way = (-size * math.sin(angle), size * math.cos(angle))
        motion = Affine(rotation(math.radians(degrees)), place, way)
        cover: Cover
        if random.random() < 0.6:
            half = random.uniform(4, 25)
            cover = Line(place, angle, random.uniform(0, 15), random.uniform(200, 600)).band(half)
            self.words.append(f"cable of {2 * half:.0f} px moved by {size:.1f} px")
        else:
            sides = random.uniform(0.05, 0.15) * self.shape[1], random.uniform(0.05, 0.15) * self.shape[1]
            cover = Rectangle(place, sides, random.uniform(0, math.pi), 0.8 * min(sides)).inside
            self.words.append(f"tool of {2 * sides[0]:.0f} x {2 * sides[1]:.0f} px moved by {size:.1f} px")
        layer = Layer(Plain(random.uniform(0.05, 0.95)), motion, cover)
        if random.random() < 0.5:
            return layer
        return replace(layer, texture=Spots.speckle(random.uniform(3, 12), self._box((layer,)), random))

    def _crack(self, whole: Motion) -> tuple[Layer, ...]:
        random = self.random
        place, angle, opening = self._place(0.35), random.uniform(0, 2 * math.pi), random.uniform(1, 12)
        line = Line(place, angle, random.uniform(0, 6), random.uniform(60, 300))
        if random.random() < 0.5:
            length, shear, mouth = math.inf, random.uniform(-5, 5), place
            self.words.append(f"crack opens by {opening:.1f} px and slides by {abs(2 * shear):.1f} px")
        else:  # `place` is the tip
            length, shear = random.uniform(200, 500), 0.0
            mouth = place[0] - length * math.cos(angle), place[1] - length * math.sin(angle)
            self.words.append(f"crack of {length:.0f} px opens by {opening:.1f} px")
        above, below = (
            Sequence((Opening(mouth, angle, side * opening / 2, length, side * shear), whole)) for side in (1, -1)
        )
        return (
            Layer(_TO_COME, above, line.above),
            Layer(_TO_COME, below, line.below),
            Layer(Plain(self.random.uniform(0, 0.3)), STILL),
        )

    # surface, light, camera

    def _box(self, layers: tuple[Layer, ...]) -> Box:
        """Return the area of the material that is seen in either image."""
        y, x = np.mgrid[0 : self.shape[0] : 16, 0 : self.shape[1] : 16].astype(float)
        seen = [(x, y)] + [each.motion.inverse(x, y) for each in layers]
        low = np.min([[np.min(each) for each in points] for points in seen], axis=0) - MARGIN
        high = np.max([[np.max(each) for each in points] for points in seen], axis=0) + MARGIN
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    def _surface(self, box: Box, random: np.random.Generator) -> Surface:
        """Return a surface of the scene's kind of texture."""
        angle = random.uniform(-0.3, 0.3)
        if self.texture == "stripes":
            number = int(random.choice([1, 6]))
            waves = np.stack([random.uniform(8, 40, number), random.uniform(0, 2 * math.pi, number)], axis=1)
            return Surface(Stripes(random.uniform(0, math.pi), waves), f"{number} waves")
        if self.texture == "skin":
            pitch = random.uniform(10, 30)
            return Surface(Skin(pitch, box, random), f"plateaus of {pitch:.0f} px")
        if self.texture == "dots":
            pitch = random.uniform(8, 24)
            periods = pitch * np.array([[1, 0], random.choice([[0, 1], [0.5, 0.75**0.5]])]) @ rotation(angle).T
            jitter = pitch * random.choice([0, random.uniform(0.15, 0.3)])
            dots = Spots.lattice(periods, pitch * random.uniform(0.3, 0.6), jitter, box, random)
            words = f"pitch {pitch:.1f} px, " + (f"jitter {jitter:.1f} px" if jitter else "perfect")
            return Surface(dots, words, None if jitter else periods)
        if self.texture in ("grid", "weave"):
            pitch, share = random.uniform(8, 24), random.choice([0, random.uniform(0.04, 0.15)])
            pattern = Grid(pitch, angle) if self.texture == "grid" else Weave(pitch / 2, angle)
            words = f"pitch {pitch:.1f} px, " + (f"{100 * share:.0f} % irregular" if share else "perfect")
            if not share:
                return Surface(pattern, words, pattern.periods)
            return Surface(Mixture(pattern, Spots.speckle(random.uniform(3, 8), box, random), share), words)
        sizes = {"too fine": (0.4, 0.6), "too coarse": (150, 250), "speckle": (2, 25)}
        low, high = sizes.get(self.texture, (3, 10))
        diameter = float(np.exp(random.uniform(math.log(low), math.log(high))))
        words, samples = f"speckle of {diameter:.1f} px", 3 if diameter < FINE else 2
        return Surface(Spots.speckle(diameter, box, random), words, samples=samples)

    def _exposure(self) -> Exposure:
        random = self.random
        noise = random.uniform(0.3, 4)
        contrast = float(np.exp(random.uniform(math.log(max(30, 15 * noise)), math.log(170))))
        if self.texture in ("too faint", "too fine"):
            noise = random.uniform(3, 5)
            contrast = random.uniform(0.5, 1.5) if self.texture == "too faint" else random.uniform(3, 8)
        elif self.texture == "too coarse":
            contrast = random.uniform(30, 60)
        dark, gain = random.uniform(15, 50), random.uniform(0.8, 1.15)
        quality = int(random.integers(60, 96)) if random.random() < 0.25 else None
        slope = (float(random.uniform(-0.15, 0.15)), float(random.uniform(-0.15, 0.15)))
        self.words += [f"contrast {contrast:.0f}", f"noise {noise:.1f}", *([f"JPEG {quality}"] if quality else [])]
        return Exposure(dark, contrast, random.uniform(0, 0.15), gain, slope, noise, quality)


_TO_COME = Plain(0.0)  # stands for the texture of the surface until the area that it has to fill is known
_REVEALED = Plain(0.0)  # stands for that of another surface, which is seen where a part was
