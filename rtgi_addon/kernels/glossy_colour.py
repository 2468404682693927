"""From what Cycles' Glossy Color says that a surface reflects to what it does reflect."""

from __future__ import annotations

from .brdf import reflected_share
from .jit import pixel_jit
from .vec3 import ZERO, Vec3, dot, f32, load_pixel, normalized_or, scaled, sub

LEAST_COLOUR = f32(1e-4)


@pixel_jit
def correct_colours(begin, end, specular, normal, position, roughness, f0, keeps_energy, eye, backwards, is_flat, albedos):
    """Turn Glossy Color `specular` (H, W, 3) into directional reflectance towards the viewer, in place.

    `normal`, `position` (H, W, 3); `roughness`, `f0`, `keeps_energy` (H, W), the last two as `core.frame.Material` has them.
    The viewer is at `eye` (3,), or with `is_flat` infinitely far along `backwards` (3,). `albedos`: `brdf.albedo_table()`.
    """
    far = Vec3(backwards[0], backwards[1], backwards[2])
    at = Vec3(eye[0], eye[1], eye[2])
    for i in range(begin, end):
        for j in range(specular.shape[1]):
            colour = max(specular[i, j, 0], max(specular[i, j, 1], specular[i, j, 2]))
            if not colour > LEAST_COLOUR:
                continue
            viewer = far if is_flat else normalized_or(sub(at, load_pixel(position, i, j)), far)
            cosine = max(dot(load_pixel(normal, i, j), viewer), ZERO)
            share = reflected_share(colour, cosine, roughness[i, j] * roughness[i, j], f0[i, j], keeps_energy[i, j] > ZERO,
                                    albedos)
            shown = scaled(load_pixel(specular, i, j), share)
            specular[i, j, 0], specular[i, j, 1], specular[i, j, 2] = shown.x, shown.y, shown.z
