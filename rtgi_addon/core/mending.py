"""Numbers in a frame that no kernel can work with, put right once at the door: NaN, infinity, normals without a length.

A sound frame comes back as it is, the same object, for the price of a sum over its images.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .frame import Frame, GBuffer, Geometry, Light, LightView, World

# float32 holds the fourth power of a distance, with room for the factors beside it, up to 1e9 m
LARGEST_M = 1e9
# 1e12 W from a lamp of 1 mm2 is 3e17 W/(m2 sr); squares of what is larger leave float32: a broken pixel, not a bright one
LARGEST_LIGHT = 1e18
SHORTEST_NORMAL = 1e-3      # a normal shorter than this has lost its direction to the rounding of half floats
UNIT = 1e-2                 # how far from 1 a squared length may be: interpolated and half-float normals are this good


def _is_sound(values: np.ndarray, largest: float) -> bool:
    """Whether every value is a number of at most this size."""
    if not values.size:
        return True
    low, high = values.min(), values.max()       # either is NaN where a value is
    return bool(low >= -largest and high <= largest)


def _mended_colour(values: np.ndarray, nothing: float = 0.0, largest: float = LARGEST_LIGHT) -> tuple[np.ndarray, int]:
    """(the values with `nothing` for what is not a number in [0, largest], how many pixels that were)."""
    if _is_sound(values, largest) and values.size and values.min() >= 0:
        return values, 0
    with np.errstate(invalid="ignore"):
        is_good = (values >= 0) & (values <= largest)
    if is_good.all():
        return values, 0
    bad = ~is_good
    return np.where(is_good, values, np.float32(nothing)), int(np.count_nonzero(bad.any(-1) if bad.ndim == 3 else bad))


def mend_gbuffer(g: GBuffer) -> tuple[GBuffer, dict[str, int]]:
    """A view without broken numbers, and how many pixels each image had of them.

    A pixel without a usable depth, place or normal sees nothing; a colour that is not a number is black, a roughness 1;
    normals get length 1.
    """
    found: dict[str, int] = {}
    changes: dict[str, np.ndarray] = {}
    mask = g.mask
    with np.errstate(invalid="ignore", over="ignore"):
        length2 = np.einsum("...i,...i", g.normal_ws, g.normal_ws)
        bad_depth = ~(g.depth > 0) | (mask & (g.depth > LARGEST_M))
        is_unit = np.abs(length2 - 1) < UNIT
        lost = {"depth": bad_depth}
        if not _is_sound(g.position_ws, LARGEST_M):
            lost["position"] = mask & ~(np.abs(g.position_ws) <= LARGEST_M).all(-1)
        if not (is_unit | ~mask).all() or not np.isfinite(length2).all():
            has_direction = (length2 > SHORTEST_NORMAL**2) & (length2 < LARGEST_M**2)
            lost["normal"] = mask & ~has_direction
            scale = np.where(is_unit | ~has_direction, 1, 1 / np.sqrt(np.where(has_direction, length2, 1)))
            normal_ws = (g.normal_ws * scale[..., None]).astype(np.float32)
            normal_ws[~mask & ~has_direction] = (0.0, 0.0, 1.0)      # nothing is seen there, but filters pass over it
            changes["normal_ws"] = normal_ws
    found |= {name: int(np.count_nonzero(where)) for name, where in lost.items() if where.any()}
    for name, nothing, largest in (("albedo", 0.0, LARGEST_LIGHT), ("specular", 0.0, LARGEST_LIGHT), ("roughness", 1.0, 1e3),
                                   ("emission", 0.0, LARGEST_LIGHT), ("f0", 0.0, 1.0)):
        values, count = _mended_colour(getattr(g, name), nothing, largest)
        if count:
            changes[name], found[name] = values, count
    broken = np.zeros(g.shape, bool)
    for where in lost.values():
        broken |= where
    if broken.any():
        def without(values: np.ndarray, nothing: float | tuple[float, ...]) -> np.ndarray:
            return np.where(broken if values.ndim == 2 else broken[..., None], np.asarray(nothing, np.float32), values)

        for name, nothing in (("depth", np.inf), ("position_ws", 0.0), ("normal_ws", (0.0, 0.0, 1.0)), ("albedo", 0.0),
                              ("specular", 0.0), ("roughness", 1.0), ("emission", 0.0), ("f0", 0.0)):
            changes[name] = without(changes.get(name, getattr(g, name)), nothing)
    if not changes:
        return g, found
    return dataclasses.replace(g, **{name: np.ascontiguousarray(values) for name, values in changes.items()}), found


def _words(found: dict[str, int], what: str) -> list[str]:
    return [f"{what}: {count} pixels of {name} hold no usable number and count as nothing" for name, count in found.items()]


def _mend_view(view: LightView, name: str) -> tuple[LightView, list[str]]:
    gbuffer, found = mend_gbuffer(view.gbuffer)
    flux, count = _mended_colour(view.incident_flux)
    if count:
        found["incident flux"] = count
    if gbuffer is view.gbuffer and not count:
        return view, []
    return dataclasses.replace(view, gbuffer=gbuffer, incident_flux=flux), _words(found, f"Light view of {name}")


def _mend_geometry(geometry: Geometry) -> tuple[Geometry, list[str]]:
    if _is_sound(geometry.corners_ws, LARGEST_M):
        keep, lines = None, []
    else:
        with np.errstate(invalid="ignore"):
            keep = (np.abs(geometry.corners_ws) <= LARGEST_M).all((1, 2))
        lines = [f"Geometry: {np.count_nonzero(~keep)} triangles have corners that are no usable numbers and are left out"]
        names = ("corners_ws", "albedo", "emission", "material")
        changes = {name: np.ascontiguousarray(getattr(geometry, name)[keep]) for name in names}
        if geometry.cutouts is not None:
            changes["cutouts"] = dataclasses.replace(geometry.cutouts,
                                                     row=np.ascontiguousarray(geometry.cutouts.row[keep]))
        if geometry.normals_ws is not None:
            changes["normals_ws"] = np.ascontiguousarray(geometry.normals_ws[keep])
        geometry = dataclasses.replace(geometry, **changes)
    for name in ("albedo", "emission"):
        values, count = _mended_colour(getattr(geometry, name))
        if count:
            lines.append(f"Geometry: {count} values of {name} are no usable numbers and count as nothing")
            geometry = dataclasses.replace(geometry, **{name: values})
    return geometry, lines


def _mend_light(light: Light) -> tuple[Light, list[str]]:
    if (_is_sound(light.power, LARGEST_LIGHT) and _is_sound(light.world_from_light, LARGEST_M)
            and _is_sound(np.array([light.radius_m, light.size_x_m, light.size_y_m]), LARGEST_M)):
        return light, []
    matrix = light.world_from_light if _is_sound(light.world_from_light, LARGEST_M) else np.eye(4)
    return (dataclasses.replace(light, power=np.zeros(3), world_from_light=matrix, radius_m=0.0, size_x_m=0.0, size_y_m=0.0),
            [f"Lamp {light.name}: its power, place or size is no usable number; it is left dark"])


def mend_frame(frame: Frame) -> Frame:
    """The frame with what no technique can work with put right, and a warning for each sort of it.

    The same object comes back where nothing is wrong, which is nearly always. What stays holds exactly as it was.
    """
    lines: list[str] = []
    gbuffer, found = mend_gbuffer(frame.gbuffer)
    lines += _words(found, "Camera view")
    lights, views = list(frame.lights), list(frame.views)
    for index, light in enumerate(lights):
        lights[index], more = _mend_light(light)
        lines += more
    for index, view in enumerate(views):
        views[index], more = _mend_view(view, frame.lights[view.light_index].name)
        lines += more
    geometry = frame.geometry
    if geometry is not None:
        geometry, more = _mend_geometry(geometry)
        lines += more
    radiance, count = _mended_colour(frame.world.radiance)
    if count:
        lines.append(f"World: {count} pixels of its light are no usable numbers and count as black")
    same = (gbuffer is frame.gbuffer and geometry is frame.geometry and not count
            and all(a is b for a, b in zip(lights, frame.lights, strict=True))
            and all(a is b for a, b in zip(views, frame.views, strict=True)))
    if same:
        return frame
    return dataclasses.replace(frame, gbuffer=gbuffer, lights=tuple(lights), views=tuple(views), geometry=geometry,
                               world=World(radiance) if count else frame.world, warnings=(*frame.warnings, *lines))
