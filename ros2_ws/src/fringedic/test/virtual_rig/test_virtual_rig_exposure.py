"""Light, shadow, noise and grey levels of the virtual rig."""

import math

import numpy as np
import pytest
from scipy.special import erf

from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration


def rig_of(**changes):
    return VirtualRig(VirtualRigConfiguration.from_dict({"size": "tiny", **changes}))


EXACT = {"bits": 16, "read_noise_grey_level": 0.0, "shot_noise_grey_level": 0.0, "ambient_light": 0.0}


def relative_light(rig, image):
    """Return the light on the surface relative to full white, from a 16-bit image and the gain of the view."""
    view = rig.view(0.0)
    return np.where(view.lit, rig.expose(image, 0.0, 0) / np.where(view.lit, view.gain, 1), np.nan)


@pytest.mark.parametrize("orientation", ["columns", "rows", "any"])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_light_is_the_whole_sum_over_projector_pixels(orientation, gamma):
    sigma = 0.8
    rig = rig_of(
        preset="plate",
        texture={"floor": 0.9},
        sensor=EXACT,
        # so narrow that the image ends inside the field
        projector={"gamma": gamma, "defocus_px": sigma, "columns": 40, "rows": 30},
    )
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, rig.projector_shape).astype(np.uint8)
    if orientation == "columns":
        image[:] = image[:1]
    elif orientation == "rows":
        image[:] = image[:, :1]
    light = relative_light(rig, image)
    view = rig.view(0.0)

    def spread(x):
        return 0.5 * (erf((x + 0.5) / (math.sqrt(2) * sigma)) - erf((x - 0.5) / (math.sqrt(2) * sigma)))

    column_weights = spread(view.projector_column[..., None] - np.arange(40))
    row_weights = spread(view.projector_row[..., None] - np.arange(30))
    expected = np.einsum("ijr,rc,ijc->ij", row_weights, (image / 255.0) ** gamma, column_weights)
    digit = 0.5 / view.gain[view.lit].min()
    error = np.nanmax(np.abs(light - expected)[view.lit])
    assert error < digit + 2e-6
    assert (expected[view.lit] < 1e-3).any()
    assert (expected[view.lit] > 0.5).any()


@pytest.mark.parametrize("name", ["plate", "skin", "leather"])
def test_phase_of_the_fringes_is_the_true_projector_column(name):
    rig = rig_of(preset=name, size="small", sensor=EXACT)
    (rows, columns), pitch, shifts = rig.projector_shape, 10, 8
    phase = 2 * np.pi * (np.arange(columns) - (columns - 1) / 2) / pitch
    total = np.zeros(rig.shape, complex)
    for k in range(shifts):
        turn = 2 * np.pi * k / shifts
        pattern = np.round(127.5 + 120 * np.cos(phase - turn)).astype(np.uint8)
        total += rig.expose(np.tile(pattern, (rows, 1)), rig.maximum_position, k) * np.exp(1j * turn)
    column = rig.truth(rig.maximum_position).projector_column.values
    expected = 2 * np.pi * (column - (columns - 1) / 2) / pitch
    error = np.angle(total * np.exp(-1j * expected))[np.isfinite(expected)] / (2 * np.pi)
    assert abs(error.mean()) < 5e-5
    assert error.std() < 3e-4


def test_lambert_cosine_and_distance_on_a_sphere():
    rig = rig_of(preset="sphere", sensor={**EXACT, "ambient_light": 0.5})
    truth, view = rig.truth(0.0), rig.view(0.0)
    radius, apex = 0.12, 4e-3
    centre = np.array([0.0, 0.0, apex - radius])
    points = np.stack([truth[n].values for n in "xyz"], axis=-1)
    normal = (points - centre) / radius
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, atol=1e-9)
    projector = np.array(rig.optics()["projector_position"])
    to_light = projector - points
    distance = np.linalg.norm(to_light, axis=-1)
    falling = (normal * to_light).sum(-1) / distance**3
    at_origin = projector[2] / np.linalg.norm(projector) ** 3
    irradiance = 0.5 * view.gain / view.offset
    error = np.abs(irradiance - falling / at_origin).max()
    assert error < 1e-6
    assert irradiance.max() / irradiance.min() > 1.3


def test_fringes_use_the_scale_of_the_camera_without_leaving_it():
    rig = rig_of(preset="sphere")
    brightest = 250  # of the fringes: clear of the end of the projector's scale
    image = rig.expose(np.full(rig.projector_shape, brightest, np.uint8), 0.0, 0)
    bright = np.percentile(image, 98) / 255
    assert 0.8 < bright < 0.95
    assert image.max() < 255


def test_shadows_of_the_step_match_light_paths_traced_on_the_height():
    rig = rig_of(preset="stepped", size="small", ideal=True)
    truth, view = rig.truth(0.0), rig.view(0.0)
    projector = np.array(rig.optics()["projector_position"])

    def height(x, y):
        block = 0.5 * (np.tanh((x + 0.012) / 0.25e-3) - np.tanh((x - 0.012) / 0.25e-3))
        return -2e-3 + 4e-3 * block + 1e-3 * (1 + np.tanh((y - 0.004) / 0.25e-3))

    some = slice(None, None, 5)  # rows that are traced
    x, y, z = (truth[n].values[some] for n in "xyz")
    np.testing.assert_allclose(z, height(x, y), atol=1e-9)
    clearance = np.full(x.shape, np.inf)
    for t in np.linspace(2e-5, 0.02, 4000):
        x_t, y_t, z_t = x + t * (projector[0] - x), y + t * (projector[1] - y), z + t * (projector[2] - z)
        clearance = np.minimum(clearance, z_t - height(x_t, y_t))
    shadow = clearance < 0
    disagree = shadow == view.lit[some]
    assert 0.02 < shadow.mean() < 0.1
    assert disagree.mean() < 1e-3
    # the block hides what lies left of it, since the light comes from the right
    row = ~view.lit[180]
    assert row[: row.size // 2].sum() > 5
    assert row[row.size // 2 :].sum() == 0

    stepped = rig.expose(np.full(rig.projector_shape, 255, np.uint8), 0.0, 0)
    dark = rig.expose(np.zeros(rig.projector_shape, np.uint8), 0.0, 0)
    assert np.array_equal(stepped[~view.lit], dark[~view.lit])


def test_beside_the_specimen_nothing_changes_with_the_light():
    rig = rig_of(preset="plate", ideal=True)
    beside = np.isnan(rig.view(0.0).X)
    white = rig.expose(np.full(rig.projector_shape, 255, np.uint8), 0.0, 0)
    assert 0.03 < beside.mean() < 0.1
    assert np.unique(white[beside]).tolist() == [3]  # 1 % of 255
    assert not rig.truth(0.0).valid.values[beside].any()


def test_noise_has_the_stated_variance():
    rig = rig_of(preset="plate", sensor={"read_noise_grey_level": 1.0, "shot_noise_grey_level": 0.02})
    quiet = rig_of(preset="plate", ideal=False, sensor=EXACT | {"ambient_light": 0.02})
    white = np.full(rig.projector_shape, 250, np.uint8)
    frames = np.stack([rig.expose(white, 0.0, n) for n in range(400)]).astype(float)
    level = quiet.expose(white, 0.0, 0) / 257.0
    free = (level > 8) & (level < 240)
    variance = frames.var(axis=0, ddof=1)
    stated = 1.0 + 0.02 * level + 1 / 12  # the last is the rounding
    for low, high in ((8, 60), (60, 130), (130, 240)):
        band = free & (level >= low) & (level < high)
        ratio = variance[band].mean() / stated[band].mean()
        assert abs(ratio - 1) < 0.01
    standard = ((frames - level) / np.sqrt(stated))[:, free]
    assert abs(standard.mean()) < 5e-3
    assert abs((standard**3).mean()) < 0.01
    assert abs((standard**4).mean() - 3) < 0.05
    field = frames - level
    neighbours = [np.corrcoef(field[:, a].ravel(), field[:, b].ravel())[0, 1] for a, b in ((60, 61), (60, 62))]
    columns = np.corrcoef(field[:, :, 80].ravel(), field[:, :, 81].ravel())[0, 1]
    successive = np.corrcoef(field[:-1, :, 40].ravel(), field[1:, :, 40].ravel())[0, 1]
    assert np.abs([*neighbours, columns, successive]).max() < 0.02


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16)])
def test_digits_and_saturation(bits, dtype):
    full = 2**bits - 1
    rig = rig_of(preset="rigid", sensor={"bits": bits, "white_level": 1.3, "read_noise_grey_level": 2.0})
    image = rig.expose(np.full(rig.projector_shape, 255, np.uint8), 0.0, 1)
    assert image.dtype == dtype
    assert image.max() == full
    assert 0.05 < (image == full).mean() < 0.6
    dark = rig_of(preset="rigid", sensor={"bits": bits, "ambient_light": 0.0, "read_noise_grey_level": 2.0})
    image = dark.expose(np.zeros(rig.projector_shape, np.uint8), 0.0, 1)
    assert image.min() == 0
    assert image.max() < 20


def test_lens_blur_comes_after_fringes_and_texture():
    """The blurred image is the sharp one filtered, and not blurred fringes on a sharp texture."""
    sensor = {**EXACT, "lens_blur_px": 1.2}
    sharp, blurred = rig_of(preset="plate", sensor=EXACT), rig_of(preset="plate", sensor=sensor)
    image = np.zeros(sharp.projector_shape, np.uint8)
    image[:, ::2] = 250
    row = np.arange(-8, 9)
    weights = np.exp(-(row**2) / (2 * 1.2**2))
    weights /= weights.sum()
    expected = sharp.expose(image, 0.0, 0).astype(float)
    for axis in (0, 1):
        expected = np.apply_along_axis(np.convolve, axis, expected, weights, mode="same")
    inner = np.s_[10:-10, 10:-10]
    error = np.abs(blurred.expose(image, 0.0, 0) - expected)[inner].max()
    assert error < 20  # the filter's tails beyond 8 px hold 1e-10, those beyond scipy's 4 sigma 6e-5


def test_response_and_exposure_time_act_on_the_light():
    linear = rig_of(preset="plate", sensor=EXACT)
    white = np.full(linear.projector_shape, 200, np.uint8)
    light = linear.expose(white, 0.0, 0) / 65535
    bent = rig_of(preset="plate", sensor={**EXACT, "response": 0.6}).expose(white, 0.0, 0) / 65535
    assert np.abs(bent - light**0.6).max() < 1e-3  # near black a digit of the linear image is a large step
    half = linear.expose(white, 0.0, 0, exposure_factor=0.5) / 65535
    assert np.abs(half - 0.5 * light).max() < 2 / 65535
