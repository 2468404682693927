"""What reflections do to every pixel of a picture: which lattice it is traced on before, its colour after."""

from __future__ import annotations

import numpy as np

from .jit import pixel_jit
from .reflect import WEIGHT
from .vec3 import ONE, f32

LEAST_SUM = f32(1e-6)       # of the weights of a pixel's rays


@pixel_jit
def _sort_pixels(begin, end, mask, roughness, specular, alphas, sizes, negligible, bright, mirror_roughness, step,
                 is_bright):
    for i in range(begin, end):
        for j in range(mask.shape[1]):
            brightest = max(specular[i, j, 0], max(specular[i, j, 1], specular[i, j, 2]))
            # a mirror shows itself by one ray
            is_bright[i, j] = brightest > bright and roughness[i, j] > mirror_roughness
            if not (mask[i, j] and brightest > negligible):
                continue
            alpha, step[i, j] = roughness[i, j] * roughness[i, j], 1
            for k in range(alphas.shape[0]):
                if alpha >= alphas[k]:
                    step[i, j] = sizes[k]


def sort_pixels(mask, roughness, specular, alphas, sizes, negligible, bright, mirror_roughness):
    """(step (H, W) int64, is_bright (H, W) bool) of glossy pixels.

    The step is 1, or the last of `sizes` (K,) whose number in `alphas` (K,) float32, ascending, the pixel's GGX alpha
    reaches; 0 where nothing is seen or Glossy Color is `negligible`. Bright is Glossy Color above `bright` on a roughness
    above `mirror_roughness`.
    """
    step, is_bright = np.zeros(mask.shape, np.int64), np.empty(mask.shape, np.bool_)
    limits = (f32(negligible), f32(bright), f32(mirror_roughness))
    _sort_pixels(mask.shape[0], mask, roughness, specular, alphas, sizes, *limits, step, is_bright)
    return step, is_bright


@pixel_jit
def _on_lattice(begin, end, step, out):
    for i in range(begin, end):
        for j in range(step.shape[1]):
            s = step[i, j]
            out[i, j] = s > 0 and i % s == 0 and j % s == 0


def on_lattice(step):
    """(H, W) bool: pixels that lie on the lattice of their own `step` (H, W); 0 is none."""
    out = np.empty(step.shape, np.bool_)
    _on_lattice(step.shape[0], step, out)
    return out


@pixel_jit
def _colour_pixels(begin, end, smooth, step, specular, bounce, around):
    for i in range(begin, end):
        for j in range(step.shape[1]):
            if step[i, j] == 0:
                continue
            shown = ONE / max(smooth[i, j, WEIGHT], LEAST_SUM)
            for c in range(3):
                colour = specular[i, j, c] * shown
                bounce[i, j, c] = smooth[i, j, c] * colour
                if around.shape[0] > 0:
                    around[i, j, c] = smooth[i, j, 3 + c] * colour


def colour_pixels(smooth, step, specular, shines):
    """Two pictures (H, W, 3) float32 W/(m2 sr) from sums over the lobe (H, W, FILTERED): the bounce, and what shines itself.

    `specular` (H, W, 3) is what the whole lobe reflects; where `step` is 0 nothing is. The second is black without `shines`.
    """
    bounce, around = np.zeros(specular.shape, np.float32), np.zeros(specular.shape, np.float32)
    _colour_pixels(step.shape[0], smooth, step, specular, bounce, around if shines else around[:0])
    return bounce, around
