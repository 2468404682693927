"""Errors of a picture against a reference; the formulas and what each of them is for.

All images are linear (H, W, C) or (H, W), `mask` is (H, W) bool and says which pixels count. Sums are float64. A value that
is not finite in the picture is an InputError: a metric that skips it would call a broken picture a good one.

The reference is two independent noisy halves A and B of equal samples; their mean is the reference, their difference tells
its noise. For a picture T that knows nothing of them the mean of (T - A)(T - B) is free of that noise, since its
expectation is the squared error against the truth [1]_.

No metric stands alone: `luminance_bias` sees a picture that is too bright and is blind to where, `ssim` sees structure and
hardly brightness, `block_relative_l1` sees what is left after the eye has averaged fine noise, `after_best_scale` what is
left of that when the brightness is put right. docs/comparison.md says how to read them.

References
----------
.. [1] Rousselle, Knaus, Zwicker. Adaptive Rendering with Non-Local Means Filtering. ACM TOG 31(6), 2012 (half buffers).
"""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError

BLOCK_PX = 8
FIREFLY = 20.0              # values above this many means of the reference are cut in `noise_free_nrmse`
DARK = 0.1                  # a pixel or block darker than this share of the mean is measured against this share
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_SMOOTH_PX = 9              # window of the denominator of `smoothed_relmse`
_SMOOTH_FLOOR = 0.01        # of the mean luminance, so that exposure and units change nothing
_SSIM_WINDOW_PX = 7
_SSIM_C1, _SSIM_C2 = 0.01**2, 0.03**2


def _checked(mask: np.ndarray, test: np.ndarray, *references: np.ndarray) -> list[np.ndarray]:
    """The images as (H, W, C) float64; InputError naming the first that cannot be compared."""
    mask = np.asarray(mask)
    if mask.dtype != np.bool_ or mask.ndim != 2:
        raise InputError(f"mask must be (H, W) bool, got {mask.shape} {mask.dtype}")
    if not mask.any():
        raise InputError("the mask leaves no pixel to compare")
    images = []
    for name, image in (("test image", test), *(("reference", r) for r in references)):
        image = np.asarray(image)
        if image.shape[:2] != mask.shape or image.shape != np.asarray(test).shape:
            raise InputError(f"the {name} is {image.shape}, the test image {np.asarray(test).shape}, the mask {mask.shape}; "
                             "they must be of one size")
        image = np.atleast_3d(image).astype(np.float64)
        broken = np.count_nonzero(~np.isfinite(image).all(-1))
        if broken:
            row, column = np.argwhere(~np.isfinite(image).all(-1))[0]
            raise InputError(f"the {name} has {broken} pixels that are not finite, the first at column {column}, row {row}")
        images.append(image)
    return images


def _positive(value: float) -> float:
    if not value > 0:
        raise InputError("the reference is black where the mask counts; no relative error exists")
    return value


def block_sums(image: np.ndarray, mask: np.ndarray, block: int = BLOCK_PX) -> np.ndarray:
    """Sums (ceil(H/block), ceil(W/block), C) float64 of the masked pixels of each block; at the edges it may be smaller."""
    image = np.atleast_3d(image).astype(np.float64) * mask[..., None]
    height, width, channels = image.shape
    rows, columns = -(-height // block), -(-width // block)
    padded = np.zeros((rows * block, columns * block, channels))
    padded[:height, :width] = image
    return padded.reshape(rows, block, columns, block, channels).sum((1, 3))


def window_sums(image: np.ndarray, size: int) -> np.ndarray:
    """Sums of (H, W) over the odd window of `size` px around each pixel, cut at the edges."""
    half = size // 2
    total = np.pad(image, ((half + 1, half), (half + 1, half))).cumsum(0).cumsum(1)
    return total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]


def block_relative_l1(test: np.ndarray, reference: np.ndarray, mask: np.ndarray, block: int = BLOCK_PX) -> float:
    """sum |T_b - R_b| / sum R_b over the sums T_b, R_b of blocks of pixels: the headline number.

    Fine noise averages out in a block as it does to the eye; wrong light does not. The reference's noise is in it, see
    `block_noise`.
    """
    test, reference = _checked(mask, test, reference)
    expected = block_sums(reference, mask, block)
    return float(np.abs(block_sums(test, mask, block) - expected).sum() / _positive(expected.sum()))


def block_noise(half_a: np.ndarray, half_b: np.ndarray, mask: np.ndarray, block: int = BLOCK_PX) -> float:
    """The share of `block_relative_l1` that the reference's own noise gives a perfect picture.

    (A - B)/2 is distributed as the error of the mean (A + B)/2.
    """
    half_a, half_b = _checked(mask, half_a, half_b)
    a, b = block_sums(half_a, mask, block), block_sums(half_b, mask, block)
    return float(np.abs(a - b).sum() / 2 / _positive((a + b).sum() / 2))


def relative_l1(test: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """sum |T - R| / sum R over pixels."""
    test, reference = _checked(mask, test, reference)
    return float(np.abs(test - reference)[mask].sum() / _positive(reference[mask].sum()))


def energy_ratio(test: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """sum T / sum R: 1.02 is 2 % too bright. Blind to where the light is."""
    test, reference = _checked(mask, test, reference)
    return float(test[mask].sum() / _positive(reference[mask].sum()))


def luminance_of(image: np.ndarray) -> np.ndarray:
    """(H, W) luminance of (H, W, 3) linear Rec. 709; (H, W) and (H, W, 1) are luminance already."""
    image = np.atleast_3d(image)
    return image @ LUMINANCE if image.shape[2] == 3 else image.mean(-1)


def luminance_bias(test: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> float:
    """mean luminance of T over that of R, less one: +0.02 is 2 % too bright. Blind to where the light is."""
    test, reference = _checked(mask, test, reference)
    return float(luminance_of(test)[mask].mean() / _positive(luminance_of(reference)[mask].mean())) - 1


def block_percentile(test: np.ndarray, reference: np.ndarray, mask: np.ndarray, share: float = 0.95,
                     block: int = BLOCK_PX) -> float:
    """Relative error that `share` of the blocks stay below: how bad the bad places are.

    A block's error is sum over channels of |T_b - R_b| / R_b; a block darker than `DARK` means is held against that.
    Blocks with fewer than half of their pixels on surfaces are left out.
    """
    test, reference = _checked(mask, test, reference)
    counted = block_sums(mask.astype(np.float64), mask, block)[..., 0]
    full = counted >= min(block**2, counted.max()) / 2
    expected = block_sums(reference, mask, block)
    error = np.abs(block_sums(test, mask, block) - expected).sum(-1)[full]
    floor = DARK * _positive(reference[mask].sum(-1).mean()) * counted[full]
    return float(np.quantile(error / np.maximum(expected.sum(-1)[full], floor), share))


def after_best_scale(test: np.ndarray, reference: np.ndarray, mask: np.ndarray,
                     block: int = BLOCK_PX) -> tuple[float, float]:
    """(s, `block_relative_l1` of s T): the scale that makes this error least, and what is left of it.

    Tells calibration from structure: where the error falls to little, only the brightness was wrong. sum |s T_b - R_b| is
    least at the median of R_b / T_b weighted by |T_b|; least squares would let a few bright blocks decide. A black picture
    has the scale 1, since none mends it.
    """
    test, reference = _checked(mask, test, reference)
    t, r = block_sums(test, mask, block).ravel(), block_sums(reference, mask, block).ravel()
    lit = t != 0
    scale = 1.0
    if lit.any():
        ratio, weight = r[lit] / t[lit], np.abs(t[lit])
        order = np.argsort(ratio, kind="stable")
        reached = weight[order].cumsum()
        scale = float(ratio[order][np.searchsorted(reached, reached[-1] / 2)])
    return scale, float(np.abs(scale * t - r).sum() / _positive(r.sum()))


def _cut(mask: np.ndarray, firefly: float, *images: np.ndarray) -> tuple[list[np.ndarray], float]:
    """The images with values above `firefly` means of the last two cut, and that mean."""
    mean = _positive(float(images[-2][mask].mean() + images[-1][mask].mean()) / 2)
    return [np.minimum(image, firefly * mean) for image in images], mean


def _smooth_squared(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) square of the luminance of (A + B)/2, averaged over masked pixels of a window, never below the floor."""
    luminance = luminance_of((a + b) / 2) * mask
    count = np.maximum(window_sums(mask.astype(np.float64), _SMOOTH_PX), 1)
    return (np.maximum(window_sums(luminance, _SMOOTH_PX) / count, 0) + _SMOOTH_FLOOR * luminance[mask].mean()) ** 2


def smoothed_relmse(test: np.ndarray, half_a: np.ndarray, half_b: np.ndarray, mask: np.ndarray,
                    firefly: float = FIREFLY) -> float:
    """mean (T - A)(T - B) / (box(luminance of R) + 1 % of its mean)^2: squared relative error without R's noise.

    The denominator is smooth, since that of a single noisy pixel would rule the sum where it is near black. Cut as in
    `noise_free_nrmse`; 0 where noise hides the error.
    """
    (t, a, b), _ = _cut(mask, firefly, *_checked(mask, test, half_a, half_b))
    return max(0.0, float((((t - a) * (t - b)).mean(-1) / _smooth_squared(a, b, mask))[mask].mean()))


def smoothed_relmse_noise(half_a: np.ndarray, half_b: np.ndarray, mask: np.ndarray, firefly: float = FIREFLY) -> float:
    """The noise floor of `smoothed_relmse`: what the noise of (A + B)/2 alone would make of it."""
    (a, b), _ = _cut(mask, firefly, *_checked(mask, half_a, half_b))
    return float((((a - b) ** 2).mean(-1) / 4 / _smooth_squared(a, b, mask))[mask].mean())


def noise_free_nrmse(test: np.ndarray, half_a: np.ndarray, half_b: np.ndarray, mask: np.ndarray,
                     firefly: float = FIREFLY) -> float:
    """sqrt(mean (T - A)(T - B)) / mean R: error per pixel without the reference's noise, 0 where noise hides it.

    Values above `firefly` means are cut in all three images, as a few fireflies of the reference would decide the sum.
    """
    (t, a, b), mean = _cut(mask, firefly, *_checked(mask, test, half_a, half_b))
    return math.sqrt(max(0.0, float(((t - a) * (t - b))[mask].mean()))) / mean


def nrmse_noise(half_a: np.ndarray, half_b: np.ndarray, mask: np.ndarray, firefly: float = FIREFLY) -> float:
    """Root mean square noise of the mean of the halves over the mean, cut as `noise_free_nrmse` cuts."""
    (a, b), mean = _cut(mask, firefly, *_checked(mask, half_a, half_b))
    return math.sqrt(float(((a - b) ** 2)[mask].mean()) / 4) / mean


def share_within(test: np.ndarray, reference: np.ndarray, mask: np.ndarray, relative: float = 0.01,
                 dark: float = DARK) -> float:
    """Share of the masked pixels whose every channel is within `relative` of the reference.

    Where the reference is darker than `dark` means, the tolerance is that of a pixel of `dark` means: one part in a
    hundred of nearly nothing is nothing. A black reference has no tolerance at all.
    """
    test, reference = _checked(mask, test, reference)
    floor = dark * reference[mask].mean()
    allowed = relative * np.maximum(reference[mask], floor)
    return float((np.abs(test[mask] - reference[mask]) <= allowed).all(-1).mean())


def ssim(test: np.ndarray, reference: np.ndarray) -> float:
    """Mean structural similarity (Wang et al. 2004, Eq. 13) of display values in [0, 1], over even 7x7 windows."""
    everywhere = np.ones(np.asarray(test).shape[:2], bool)
    test, reference = _checked(everywhere, test, reference)
    size = _SSIM_WINDOW_PX
    if min(test.shape[:2]) < size:
        raise InputError(f"SSIM needs pictures of at least {size}x{size}, got {test.shape[1]}x{test.shape[0]}")

    def window_mean(image: np.ndarray) -> np.ndarray:
        total = np.pad(image, ((1, 0), (1, 0), (0, 0))).cumsum(0).cumsum(1)
        return (total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]) / size**2

    mean_t, mean_r = window_mean(test), window_mean(reference)
    var_t, var_r = window_mean(test**2) - mean_t**2, window_mean(reference**2) - mean_r**2
    both = window_mean(test * reference) - mean_t * mean_r
    value = ((2 * mean_t * mean_r + _SSIM_C1) * (2 * both + _SSIM_C2)
             / ((mean_t**2 + mean_r**2 + _SSIM_C1) * (var_t + var_r + _SSIM_C2)))
    return float(value.mean())
