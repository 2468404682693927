"""The metrics are right on pictures whose error is known, and none of them misses what it is there to see."""

import numpy as np
import pytest

from rtgi_addon.compare import metrics
from rtgi_addon.compare.halves import PASSES, Reference, load_reference
from rtgi_addon.errors import InputError

GAIN = 1.02
SHIFT_PX = 1
EXACT = 1e-12               # float64 sums of a few thousand values


@pytest.fixture
def truth(rng):
    """A picture with structure at every scale, values of order 1, odd size so that edge blocks are cut."""
    y, x = np.mgrid[0:45, 0:67]
    smooth = 1.0 + 0.5 * np.sin(x / 9) * np.cos(y / 7)
    edges = np.where((x // 13 + y // 11) % 2, 1.0, 0.3)
    return (smooth * edges)[..., None] * np.array([1.0, 0.8, 0.6]) + 0.05 * rng.random((45, 67, 3))


@pytest.fixture
def mask(truth):
    inside = np.ones(truth.shape[:2], bool)
    inside[:5, :9] = False
    return inside


@pytest.fixture
def halves(truth, rng):
    """Two noisy halves of the truth; 10 % noise a pixel."""
    return truth + 0.1 * rng.standard_normal(truth.shape), truth + 0.1 * rng.standard_normal(truth.shape)


def display(image):
    return image / 2


# how each comparator sees a picture, as "larger is worse", and what a perfect picture scores
COMPARATORS = {
    "block_relative_l1": lambda t, r, m: metrics.block_relative_l1(t, r, m),
    "relative_l1": lambda t, r, m: metrics.relative_l1(t, r, m),
    "noise_free_nrmse": lambda t, r, m: metrics.noise_free_nrmse(t, r, r, m),
    "share_within": lambda t, r, m: 1 - metrics.share_within(t, r, m),
    "ssim": lambda t, r, m: 1 - metrics.ssim(display(t), display(r)),
    "energy_ratio": lambda t, r, m: abs(metrics.energy_ratio(t, r, m) - 1),
    "luminance_bias": lambda t, r, m: abs(metrics.luminance_bias(t, r, m)),
    "block_percentile": lambda t, r, m: metrics.block_percentile(t, r, m),
    "smoothed_relmse": lambda t, r, m: metrics.smoothed_relmse(t, r, r, m),
    "best_scale": lambda t, r, m: abs(metrics.after_best_scale(t, r, m)[0] - 1),
    "block_after_scale": lambda t, r, m: metrics.after_best_scale(t, r, m)[1],
}
# what 2 % make by definition, less rounding; SSIM hardly sees brightness, but more than rounding
SEES_GAIN = {"block_relative_l1": 0.0199, "relative_l1": 0.0199, "noise_free_nrmse": 0.0199, "energy_ratio": 0.0199,
             "share_within": 0.99, "ssim": 1e-5, "luminance_bias": 0.0199, "block_percentile": 0.0199,
             "smoothed_relmse": 3e-4,                                       # 0.02^2 where the picture is even
             "best_scale": 0.0195}                                          # 1/1.02
# less than half of what this picture's edges give
SEES_SHIFT = {"block_relative_l1": 0.01, "relative_l1": 0.02, "noise_free_nrmse": 0.1, "share_within": 0.5, "ssim": 0.02,
              "block_percentile": 0.05, "smoothed_relmse": 0.01, "block_after_scale": 0.01}


@pytest.mark.parametrize("name", COMPARATORS)
def test_a_perfect_picture_has_no_error(name, truth, mask):
    assert COMPARATORS[name](truth, truth, mask) < EXACT


@pytest.mark.parametrize("name", SEES_GAIN)
def test_two_percent_gain_is_seen(name, truth, mask):
    assert COMPARATORS[name](truth * GAIN, truth, mask) > SEES_GAIN[name]


@pytest.mark.parametrize("name", SEES_SHIFT)
def test_shift_by_one_pixel_is_seen(name, truth, mask):
    assert COMPARATORS[name](np.roll(truth, SHIFT_PX, 1), truth, mask) > SEES_SHIFT[name]


def test_every_comparator_sees_a_gain_or_a_shift():
    assert set(SEES_GAIN) | set(SEES_SHIFT) == set(COMPARATORS)


# what two halves that should differ by noise alone differ by, as comparators of one half with the other
NOISES = {"block_noise": metrics.block_noise, "nrmse_noise": metrics.nrmse_noise,
          "smoothed_relmse_noise": metrics.smoothed_relmse_noise}
# half of what 2 % and this picture's edges make of the mean's error, squared for the last; a twentieth of a shift's edges
NOISE_OF_GAIN = {"block_noise": 0.0098, "nrmse_noise": 0.0098, "smoothed_relmse_noise": 5e-5}
NOISE_OF_SHIFT = {"block_noise": 0.005, "nrmse_noise": 0.05, "smoothed_relmse_noise": 0.003}


def test_every_metric_is_tried():
    public = {name for name, thing in vars(metrics).items()
              if callable(thing) and thing.__module__ == metrics.__name__ and not name.startswith("_")}
    helpers = {"block_sums", "window_sums", "luminance_of"}
    assert public - helpers == (set(COMPARATORS) | set(NOISES) | {"after_best_scale"}) - {"best_scale", "block_after_scale"}


@pytest.mark.parametrize("name", NOISES)
def test_noise_of_equal_halves_is_nothing(name, truth, mask):
    assert NOISES[name](truth, truth, mask) < EXACT


@pytest.mark.parametrize("name", NOISES)
def test_a_half_that_is_two_percent_brighter_is_seen(name, truth, mask):
    assert NOISES[name](truth * GAIN, truth, mask) > NOISE_OF_GAIN[name]


@pytest.mark.parametrize("name", NOISES)
def test_a_half_that_is_shifted_by_a_pixel_is_seen(name, truth, mask):
    assert NOISES[name](np.roll(truth, SHIFT_PX, 1), truth, mask) > NOISE_OF_SHIFT[name]


@pytest.mark.parametrize("name", NOISES)
@pytest.mark.parametrize("half", [0, 1])
def test_one_nan_in_a_half_is_an_error(name, half, truth, mask):
    halves = [truth.copy(), truth.copy()]
    halves[half][7, 3, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        NOISES[name](*halves, mask)


@pytest.mark.parametrize("name", ["energy_ratio", "luminance_bias"])
def test_brightness_alone_would_miss_a_shift(name, truth):
    everywhere = np.ones(truth.shape[:2], bool)
    assert COMPARATORS[name](np.roll(truth, SHIFT_PX, 1), truth, everywhere) < EXACT


def test_error_after_the_best_scale_forgives_a_gain_and_names_it(truth, mask):
    scale, left = metrics.after_best_scale(truth * GAIN, truth, mask)
    assert scale == pytest.approx(1 / GAIN, abs=EXACT) and left < EXACT


def test_no_other_scale_leaves_less(truth, halves, mask):
    test = np.roll(0.8 * halves[0], 1, 1)
    scale, left = metrics.after_best_scale(test, truth, mask)
    others = [metrics.block_relative_l1(s * test, truth, mask) for s in (1.0, 0.99 * scale, 1.01 * scale, 1.25)]
    assert left <= min(others) and left == pytest.approx(metrics.block_relative_l1(scale * test, truth, mask), abs=EXACT)


def test_no_scale_mends_a_black_picture(truth, mask):
    assert metrics.after_best_scale(np.zeros_like(truth), truth, mask) == (1.0, 1.0)


def test_luminance_bias_is_signed_and_weighs_colours_as_the_eye_does():
    reference, mask = np.ones((8, 8, 3)), np.ones((8, 8), bool)
    green, blue = reference.copy(), reference.copy()
    green[..., 1], blue[..., 2] = 0.9, 0.9
    assert metrics.luminance_bias(green, reference, mask) == pytest.approx(-0.07152, abs=EXACT)
    assert metrics.luminance_bias(blue, reference, mask) == pytest.approx(-0.00722, abs=EXACT)


def test_block_percentile_is_the_error_of_the_bad_places():
    reference, mask = np.ones((80, 80, 3)), np.ones((80, 80), bool)
    test = reference.copy()
    test[:8] = 1.5                                           # ten blocks of a hundred
    assert metrics.block_percentile(test, reference, mask) == pytest.approx(0.5, abs=EXACT)
    assert metrics.block_percentile(test, reference, mask, 0.8) < EXACT


def test_block_percentile_leaves_out_slivers_of_surface_beside_the_sky():
    reference = np.ones((16, 16, 3))
    test, mask = reference.copy(), np.zeros((16, 16), bool)
    mask[:8], mask[8] = True, True                           # whole blocks, and one row of the blocks below
    test[8] = 3.0
    assert metrics.block_percentile(test, reference, mask) < EXACT


def test_smoothed_relmse_does_not_change_with_exposure(truth, halves, mask):
    a, b = halves
    seen = metrics.smoothed_relmse(1.05 * truth, a, b, mask)
    assert metrics.smoothed_relmse(1e4 * 1.05 * truth, 1e4 * a, 1e4 * b, mask) == pytest.approx(seen, rel=1e-9)


def test_smoothed_relmse_does_not_see_the_noise_of_the_halves(truth, halves, mask):
    # in the dark squares the noise is a third of the light, and the estimate of one pair of halves has a spread of 3 %
    exact = metrics.smoothed_relmse(1.2 * truth, truth, truth, mask)
    assert metrics.smoothed_relmse(1.2 * truth, *halves, mask) == pytest.approx(exact, rel=0.12)


def test_smoothed_relmse_of_the_truth_is_below_its_floor(truth, halves, mask):
    assert metrics.smoothed_relmse(truth, *halves, mask) < 0.3 * metrics.smoothed_relmse_noise(*halves, mask)


def test_noise_floor_of_the_relmse_is_what_the_mean_of_the_halves_scores(truth, halves, mask):
    a, b = halves
    mean = (a + b) / 2
    # two estimates of one variance from 8,700 values each: 2 %, doubled
    assert metrics.smoothed_relmse_noise(a, b, mask) == pytest.approx(metrics.smoothed_relmse(mean, truth, truth, mask),
                                                                      rel=0.06)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", COMPARATORS)
def test_one_value_that_is_not_finite_is_an_error(name, value, truth, mask):
    broken = truth.copy()
    broken[7, 3, 1] = value
    with pytest.raises(InputError, match="1 pixels that are not finite, the first at column 3, row 7"):
        COMPARATORS[name](broken, truth, mask)


@pytest.mark.parametrize("name", COMPARATORS)
def test_nan_outside_the_mask_is_an_error_too(name, truth, mask):
    broken = truth.copy()
    broken[0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        COMPARATORS[name](broken, truth, mask)


@pytest.mark.parametrize("name", COMPARATORS)
def test_nan_in_the_reference_is_an_error(name, truth, mask):
    broken = truth.copy()
    broken[7, 3, 1] = np.nan
    with pytest.raises(InputError, match="the reference has 1 pixels"):
        COMPARATORS[name](truth, broken, mask)


@pytest.mark.parametrize("name", COMPARATORS)
def test_pictures_of_different_size_are_an_error(name, truth, mask):
    with pytest.raises(InputError, match="one size"):
        COMPARATORS[name](truth, truth[:-1], mask)


@pytest.mark.parametrize("name", [name for name in COMPARATORS if name != "ssim"])
def test_what_the_mask_leaves_out_does_not_count(name, truth, mask):
    changed = truth.copy()
    changed[~mask] *= 5
    assert COMPARATORS[name](changed, truth, mask) < EXACT


def test_empty_mask_is_an_error(truth):
    with pytest.raises(InputError, match="no pixel"):
        metrics.relative_l1(truth, truth, np.zeros(truth.shape[:2], bool))


@pytest.mark.parametrize("metric", [metrics.block_relative_l1, metrics.relative_l1, metrics.energy_ratio])
def test_black_reference_is_an_error(metric, truth, mask):
    with pytest.raises(InputError, match="black"):
        metric(truth, np.zeros_like(truth), mask)


def test_error_in_the_cut_blocks_at_the_edge_counts():
    reference, test = np.ones((9, 9, 3)), np.ones((9, 9, 3))
    test[8, 8] = 2.0
    assert metrics.block_relative_l1(test, reference, np.ones((9, 9), bool)) == pytest.approx(1 / 81, abs=EXACT)


def test_opposite_errors_within_a_block_cancel_and_across_blocks_do_not():
    reference = np.ones((8, 16))
    within, across = reference.copy(), reference.copy()
    within[0, 0], within[0, 1] = 1.5, 0.5
    across[0, 0], across[0, 8] = 1.5, 0.5
    mask = np.ones(reference.shape, bool)
    assert metrics.block_relative_l1(within, reference, mask) == 0
    assert metrics.block_relative_l1(across, reference, mask) == pytest.approx(1 / 128, abs=EXACT)


def test_energy_ratio_is_signed(truth, mask):
    assert metrics.energy_ratio(0.9 * truth, truth, mask) == pytest.approx(0.9, abs=EXACT)


def test_noise_free_nrmse_does_not_see_the_noise_of_the_halves(truth, halves, mask):
    # the products of noise average to nothing up to 0.01/sqrt(8700), 4 % of the error found: three times that is allowed
    seen = metrics.noise_free_nrmse(1.05 * truth, *halves, mask)
    exact = metrics.noise_free_nrmse(1.05 * truth, truth, truth, mask)
    assert seen == pytest.approx(exact, rel=0.12)
    assert metrics.nrmse_noise(*halves, mask) > exact


def test_noise_free_nrmse_of_the_truth_is_far_below_the_noise(truth, halves, mask):
    assert metrics.noise_free_nrmse(truth, *halves, mask) < 0.3 * metrics.nrmse_noise(*halves, mask)


def test_nrmse_noise_is_that_of_the_mean_of_the_halves(truth, halves, mask):
    # noise 0.1 a half gives 0.1/sqrt(2) for the mean; 2 % for the fluctuation of the estimate
    expected = 0.1 / np.sqrt(2) / truth[mask].mean()
    assert metrics.nrmse_noise(*halves, mask) == pytest.approx(expected, rel=0.02)


def test_one_firefly_of_the_reference_does_not_decide_the_nrmse(truth, halves, mask):
    a, b = halves
    spoiled = a.copy()
    spoiled[20, 20] = 1e6
    assert metrics.noise_free_nrmse(1.05 * truth, spoiled, b, mask) < 2 * metrics.noise_free_nrmse(1.05 * truth, a, b, mask)


def test_block_noise_is_what_a_perfect_picture_scores(truth, halves, mask):
    a, b = halves
    # both are means of |noise| over 54 blocks and 3 channels: each has a spread of 6 %
    assert metrics.block_noise(a, b, mask) == pytest.approx(metrics.block_relative_l1(truth, (a + b) / 2, mask), rel=0.25)


def test_share_within_counts_pixels_with_any_channel_off():
    reference, mask = np.ones((10, 10, 3)), np.ones((10, 10), bool)
    test = reference.copy()
    test[0, :5, 2] = 1.011
    test[1, :5, 2] = 1.009
    assert metrics.share_within(test, reference, mask) == pytest.approx(0.95, abs=EXACT)


def test_share_within_forgives_what_is_nothing_beside_the_mean():
    reference, mask = np.ones((10, 10, 3)), np.ones((10, 10), bool)
    reference[0] = 1e-6
    test = reference.copy()
    test[0] = 2e-6
    assert metrics.share_within(test, reference, mask) == 1.0


def test_share_within_sees_light_where_there_is_none():
    reference, mask = np.ones((10, 10, 3)), np.ones((10, 10), bool)
    reference[0] = 0.0
    test = reference.copy()
    test[0] = 0.005
    assert metrics.share_within(test, reference, mask) == pytest.approx(0.9, abs=EXACT)


def test_ssim_of_unrelated_noise_is_low(rng):
    assert metrics.ssim(rng.random((40, 40)), rng.random((40, 40))) < 0.2


def test_ssim_refuses_a_picture_smaller_than_its_window():
    with pytest.raises(InputError, match="7x7"):
        metrics.ssim(np.ones((6, 20)), np.ones((6, 20)))


# ---- references ----

CHANNELS = {"Combined": 4, "Depth": 1}


@pytest.fixture
def reference(rng):
    halves = [{name: rng.random((6, 8, CHANNELS.get(name, 3)), np.float32) for name in PASSES} for _ in range(2)]
    for half in halves:
        half["Depth"][:2] = 1e10
    return Reference(*halves, samples=5)


def test_saved_reference_comes_back(reference, tmp_path):
    reference.save(tmp_path / "r.npz")
    again = load_reference(tmp_path / "r.npz", (8, 6))
    assert again.samples == 5
    assert all(np.array_equal(again.half_b[name], reference.half_b[name]) for name in PASSES)


def test_reference_counts_surfaces_only(reference):
    assert not reference.mask[:2].any() and reference.mask[2:].all()


def test_bounce_of_a_reference_has_its_colour_in_it(reference):
    a, _ = reference.halves("bounce")
    assert np.array_equal(a, reference.half_a["Diffuse Indirect"] * reference.half_a["Diffuse Color"])


def test_reference_of_another_size_is_refused(reference, tmp_path):
    reference.save(tmp_path / "r.npz")
    with pytest.raises(InputError, match="8x6, the picture 16x9"):
        load_reference(tmp_path / "r.npz", (16, 9))


def test_missing_reference_is_refused(tmp_path):
    with pytest.raises(InputError, match="there is no reference"):
        load_reference(tmp_path / "r.npz")


def test_file_that_is_no_reference_is_refused(tmp_path):
    (tmp_path / "r.npz").write_bytes(b"text")
    with pytest.raises(InputError, match="is no reference"):
        load_reference(tmp_path / "r.npz")


def test_archive_without_the_passes_is_refused(tmp_path):
    np.savez(tmp_path / "r.npz", other=1)
    with pytest.raises(InputError, match="is no reference"):
        load_reference(tmp_path / "r.npz")
