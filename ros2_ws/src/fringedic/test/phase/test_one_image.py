"""Phase from one image, and the correction of lens blur, against the exact phase of the virtual rig."""

import numpy as np
import pytest

from fringedic.errors import ImageError, PhaseError
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import Orientation
from fringedic.patterns.sequences import fringe_sequence, one_image_sequence
from fringedic.phase import absolute_phase, correct_lens_blur, one_image_phase
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

NOISE = CameraNoise(read=1.05, shot=0.02)


def surface(floor: float, orientation: str = "vertical") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return grey image, fringe image and exact phase [rad] at a pitch of 10 px, at half the paper's image size."""
    projector = {} if orientation == "vertical" else {"x_mm": 1.5, "y_mm": 180.0}
    entries = {
        "preset": "sphere",
        "seed": 7,
        "camera": {"columns": 640, "rows": 480},
        "projector": projector,
        "texture": {"floor": floor},
    }
    twin = VirtualRig(VirtualRigConfiguration.from_dict(entries))
    rows, columns = twin.projector_shape
    grey, fringes = (
        twin.expose(image, 0.0, index)
        for index, image in enumerate(one_image_sequence(columns, rows, 10, orientation, grey=True))
    )
    view = twin.view(0.0)
    position = (
        view.projector_column - (columns - 1) / 2 if orientation == "vertical" else (rows - 1) / 2 - view.projector_row
    )
    return grey, fringes, 2 * np.pi * position / 10


@pytest.mark.parametrize("orientation", ["vertical", "horizontal"])
@pytest.mark.parametrize(
    ("floor", "divided", "target"), [(0.999, False, 0.005), (0.12, False, 0.017), (0.12, True, 0.005)]
)
def test_one_image_gives_the_phase(orientation: str, floor: float, divided: bool, target: float) -> None:
    grey, fringes, truth = surface(floor, orientation)
    result = one_image_phase(
        fringes, white=grey if divided else None, orientation=Orientation[orientation.upper()], noise=NOISE
    )
    turns = (result.phase.values - truth) / (2 * np.pi)
    offset = np.round(np.nanmedian(turns))
    error = turns - offset
    inner = np.s_[40:-40, 40:-40]
    rms = float(np.sqrt(np.nanmean(error[inner] ** 2)))
    score = float(np.nanstd((error / (result.sigma.values / (2 * np.pi)))[inner]))
    assert result.phase.attrs["relative"] == 1
    assert float(result.valid.mean()) > 0.97
    assert rms < target
    assert not (np.abs(error) > 0.5).any()
    if floor < 0.5 and not divided:
        assert 0.85 < score < 1.15, "texture dominates, and sigma contains it"
        left = np.abs(np.corrcoef(result.texture.values[inner].ravel(), grey[inner].ravel())[0, 1])
        assert left > 0.9, f"the texture without fringes is that of the surface: correlation {left:.3f}"


def test_orders_come_from_a_phase_that_is_known_roughly() -> None:
    _, fringes, truth = surface(0.999)
    result = one_image_phase(fringes, noise=NOISE, coarse=truth + 2.0)
    assert result.phase.attrs["relative"] == 0
    assert np.nanmedian(np.abs(result.phase.values - truth)) < 0.01 * 2 * np.pi
    assert not (np.abs(result.phase.values - truth) > np.pi).any()


def test_an_image_without_fringes_is_refused() -> None:
    grey, fringes, _ = surface(0.12)
    with pytest.raises(PhaseError, match="no period stands out"):
        one_image_phase(grey)
    with pytest.raises(PhaseError, match="every pixel"):
        one_image_phase(np.full((100, 100), 255, np.uint8))
    with pytest.raises(PhaseError, match="too small"):
        one_image_phase(fringes[:10, :10])
    with pytest.raises(ImageError, match="the white image is"):
        one_image_phase(fringes, white=grey[1:])


def test_blur_on_a_texture_is_corrected() -> None:
    """The blur acts on fringes and texture; without noise all of the error is due to it."""
    errors = {}
    for blur in (0.0, 0.8):
        entries = {
            "preset": "sphere",
            "ideal": True,
            "camera": {"columns": 480, "rows": 360},
            "texture": {"floor": 0.4},
            "sensor": {"bits": 16, "lens_blur_px": blur, "read_noise_grey_level": 0.0, "shot_noise_grey_level": 0.0},
        }
        twin = VirtualRig(VirtualRigConfiguration.from_dict(entries))
        rows, columns = twin.projector_shape
        sequence = fringe_sequence(columns, rows, [columns, 80, 10], [4, 4, 8])
        frames = np.array([twin.expose(image, 0.0, index) for index, image in enumerate(sequence)])
        result = absolute_phase(frames, sequence.patterns, noise=20.0)
        height = twin.truth(0.0).z.values
        rig = RigModel(**twin.optics())
        for name, phase in (
            ("as seen", result.phase.values),
            ("corrected", correct_lens_blur(result.phase, result.modulation, blur)),
        ):
            # at the border the lens mixes in light from outside of the image
            difference = 1e6 * (rig.reconstruct(phase, 10.0).z.values - height)[5:-5, 5:-5]
            errors[blur, name] = float(np.sqrt(np.nanmean(difference**2)))
    assert errors[0.8, "as seen"] > 5
    assert errors[0.8, "corrected"] < 2
    assert errors[0.0, "corrected"] == errors[0.0, "as seen"] < 0.5


def test_blur_is_left_alone_beside_gaps() -> None:
    phase = np.add.outer(np.zeros(5), 0.2 * np.arange(6)).astype(np.float32)
    modulation = np.exp(np.add.outer(np.zeros(5), 0.5 * np.arange(6)))
    phase[2, 2] = np.nan
    corrected = correct_lens_blur(phase, modulation, 0.5)
    moved = corrected - phase
    assert np.isnan(corrected[2, 2])
    assert np.isnan(corrected).sum() == 1
    assert np.allclose(moved[0, 1:-1], -0.25 * 0.2 * 0.5, atol=1e-6)
    assert moved[2, 1] == moved[2, 3] == moved[0, 0] == 0
    with pytest.raises(ImageError, match="do not belong together"):
        correct_lens_blur(phase, modulation[1:], 0.5)
