"""Light put together into pictures as Blender keeps them: row 0 at the bottom."""

from __future__ import annotations

from .jit import pixel_jit
from .vec3 import ZERO


@pixel_jit
def add_light(begin, end, light, colour, scale, is_coloured, out):
    """Add `scale` * `light` (H, W, 3), and times `colour` (H, W, 3) if it `is_coloured`, to `out` (H, W, 3) upside down."""
    last = out.shape[0] - 1
    for i in range(begin, end):
        for j in range(out.shape[1]):
            for c in range(3):
                given = scale * light[i, j, c]
                out[last - i, j, c] += given * colour[i, j, c] if is_coloured else given


@pixel_jit
def take_out_colour(begin, end, colour, out):
    """Divide `out` (H, W, 3), upside down, by `colour` (H, W, 3); what has no colour becomes 0."""
    last = out.shape[0] - 1
    for i in range(begin, end):
        for j in range(out.shape[1]):
            for c in range(3):
                out[last - i, j, c] = out[last - i, j, c] / colour[i, j, c] if colour[i, j, c] > ZERO else ZERO
