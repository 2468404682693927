"""Small frames that break renderers, and every technique at its cheapest: what tests of hard cases run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from rtgi_addon.core.frame import Frame, GBuffer, Geometry, LightKind, World
from rtgi_addon.core.mending import mend_frame
from rtgi_addon.core.params import Params
from rtgi_addon.core.radiometry import texel_flux
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import TECHNIQUE_PARAMS
from rtgi_addon.passes import TECHNIQUES
from rtgi_addon.passes.base import Context, PassResult
from tests.plane_frames import geometry_of, quad


def params_with(**changes: dict[str, object]) -> dict[str, Params]:
    """The parameters of every technique, with the changes named by technique."""
    return {name: kind(**changes.get(name, {})) for name, kind in TECHNIQUE_PARAMS.items()}


# the smallest numbers that still run every kernel
CHEAP = params_with(
    direct={"soft_shadow_rays": 4}, world={"rays": 8, "lattice_px": 2},
    rsm={"rays": 8, "clusters": 16, "lattice_px": 2}, vxgi={"resolution": 16, "cones": 8, "lattice_px": 2},
    emission={"rays": 8, "clusters": 16, "lattice_px": 2}, final_gather={"rays": 8, "lattice_px": 2},
    hbao={"steps": 4}, ssao={"samples": 8}, ssdo={"steps": 4}, lpv={"resolution": 8, "directions": 2, "lattice_px": 2},
    ssr={"samples": 4, "lattice_px": 2})
SIZE = (16, 12)


# the techniques whose light another takes for its own
EARLIER = {"ssr": ("direct",), "ssdo": ("direct",), "final_gather": ("world", "emission")}


def run_as_it_is(name: str, frame: Frame, params: Params | None = None, seed: int = 3,
                 earlier: dict[str, Params] = CHEAP) -> PassResult:
    """One technique, after those whose light it takes, which run with the parameters `earlier`."""
    context = Context()
    for other in EARLIER.get(name, ()):
        context.light |= TECHNIQUES[other].compute(frame, earlier[other], context, seed).light
    return TECHNIQUES[name].compute(frame, params or CHEAP[name], context, seed)


def run(name: str, frame: Frame, params: Params | None = None, seed: int = 3,
        earlier: dict[str, Params] = CHEAP) -> PassResult:
    """One technique on the frame as `pipeline.run` mends it."""
    return run_as_it_is(name, mend_frame(frame), params, seed, earlier)


def room(width: int = SIZE[0], height: int = SIZE[1], sky: float = 0.5) -> Frame:
    """The room of `core.synthetic` without its ceiling, a spot lamp, a grey world, and a box whose top shines."""
    frame = make_room_frame(width, height, (LightKind.SPOT,), 0.0, sky)
    emission = frame.geometry.emission.copy()
    emission[-2:] = 1.0
    return dataclasses.replace(frame, geometry=dataclasses.replace(frame.geometry, emission=emission))


def seen(frame: Frame, **images: np.ndarray) -> Frame:
    """The frame with other images of what the camera sees."""
    return dataclasses.replace(frame, gbuffer=dataclasses.replace(frame.gbuffer, **images))


def spoilt(frame: Frame, image: str, value: float, every: int = 5) -> Frame:
    """The frame with `value` in every fifth pixel of one of its images."""
    values = getattr(frame.gbuffer, image).copy()
    values.reshape(-1, *values.shape[2:])[::every] = value
    return seen(frame, **{image: values})


def spoilt_view(frame: Frame, image: str, value: float, every: int = 7) -> Frame:
    """The frame with `value` in every seventh texel of an image of its first view, or of its "incident_flux"."""
    view = frame.views[0]
    values = (view.incident_flux if image == "incident_flux" else getattr(view.gbuffer, image)).copy()
    values.reshape(-1, *values.shape[2:])[::every] = value
    view = (dataclasses.replace(view, incident_flux=values) if image == "incident_flux" else
            dataclasses.replace(view, gbuffer=dataclasses.replace(view.gbuffer, **{image: values})))
    return dataclasses.replace(frame, views=(view, *frame.views[1:]))


def powered(frame: Frame, factor: float) -> Frame:
    """The frame with all its light times `factor`: lamps, what reaches their views, world and emission."""
    lights = tuple(dataclasses.replace(x, power=x.power * factor) for x in frame.lights)
    views = tuple(dataclasses.replace(v, incident_flux=(v.incident_flux.astype(float) * factor).astype(np.float32))
                  for v in frame.views)
    world = World((frame.world.radiance.astype(float) * factor).astype(np.float32))
    geometry = dataclasses.replace(frame.geometry, emission=(frame.geometry.emission * np.float32(factor)))
    out = seen(frame, emission=(frame.gbuffer.emission.astype(float) * factor).astype(np.float32))
    return dataclasses.replace(out, lights=lights, views=views, world=world, geometry=geometry)


def with_triangles(frame: Frame, *meshes: np.ndarray) -> Frame:
    """The frame with further grey triangles in its geometry, which its views do not show."""
    more, old = geometry_of(*meshes), frame.geometry
    return dataclasses.replace(frame, geometry=Geometry(
        *(np.concatenate([getattr(old, name), getattr(more, name)])
          for name in ("corners_ws", "albedo", "emission", "material"))))


def with_normals(frame: Frame) -> Frame:
    """The frame with shading normals that have nothing to do with their triangles."""
    normals = np.random.default_rng(4).integers(-32768, 32768, frame.geometry.corners_ws.shape).astype(np.int16)
    return dataclasses.replace(frame, geometry=dataclasses.replace(frame.geometry, normals_ws=normals))


def lamp_at(frame: Frame, position: tuple[float, float, float]) -> Frame:
    """The frame with its first lamp elsewhere; the lamp's view stays, as if of another lamp, but is taken from there."""
    light, view = frame.lights[0], frame.views[0]
    matrix = light.world_from_light.copy()
    matrix[:3, 3] = position
    light = dataclasses.replace(light, world_from_light=matrix)
    camera = dataclasses.replace(view.camera, world_from_view=matrix)
    view = dataclasses.replace(view, camera=camera, gbuffer=cast_view(camera, frame.geometry),
                               incident_flux=texel_flux(light, camera))
    return dataclasses.replace(frame, lights=(light,), views=(view,))


def mirrors(frame: Frame, roughness: float) -> Frame:
    """The frame with nothing but gloss, for the camera and for the lamps."""
    def polished(g: GBuffer) -> GBuffer:
        return dataclasses.replace(g, albedo=np.zeros_like(g.albedo), specular=np.ones_like(g.specular),
                                   roughness=np.full_like(g.roughness, roughness))

    views = tuple(dataclasses.replace(v, gbuffer=polished(v.gbuffer)) for v in frame.views)
    return dataclasses.replace(frame, gbuffer=polished(frame.gbuffer), views=views)


def looked_at(frame: Frame, position: tuple[float, float, float]) -> Frame:
    """The frame from another place, in the same direction."""
    matrix = frame.camera.world_from_view.copy()
    matrix[:3, 3] = position
    camera = dataclasses.replace(frame.camera, world_from_view=matrix)
    return dataclasses.replace(frame, camera=camera, gbuffer=cast_view(camera, frame.geometry, frame.materials))


def of_any_depth(frame: Frame) -> Frame:
    """The frame with pixels at 1e-3 to 1e6 m, side by side; nothing fits to its triangles."""
    depth = np.exp(np.random.default_rng(2).uniform(np.log(1e-3), np.log(1e6), frame.gbuffer.shape)).astype(np.float32)
    return seen(frame, depth=depth, position_ws=frame.camera.positions_ws(depth))


UP = np.array([0, 0, 1], np.float32)
_NAN, _INF = float("nan"), float("inf")
BROKEN = np.array([[[0, 0, 0.5], [_NAN, 1, 0], [1, 0, 0]], [[0, 0, 0.5], [0, 0, 0.5], [1, 0, 1]],
                   [[0, 0, _INF], [0, 1, 0], [1, 0, 0]], [[0.2, 0.2, 0.3]] * 3])
PIXELS = {"depth": (_NAN, 0.0, 1e30), "position_ws": (_NAN, _INF, 1e30), "normal_ws": (_NAN, 0.0, 3.0),
          "albedo": (_NAN, _INF, 1.0), "specular": (_NAN, _INF, 1.0), "roughness": (_NAN, 0.0, _INF),
          "emission": (_NAN, _INF, 1e30)}
TEXELS = {**PIXELS, "incident_flux": (_NAN, _INF, 1e30)}


def odd_frames() -> dict[str, Callable[[], Frame]]:
    """Name and maker of every frame that a technique has to survive."""
    frames: dict[str, Callable[[], Frame]] = {}
    for image, values in PIXELS.items():
        for value in values:
            frames[f"pixels' {image} {value:g}"] = lambda image=image, value=value: spoilt(room(), image, value)
    for image, values in TEXELS.items():
        for value in values:
            frames[f"texels' {image} {value:g}"] = lambda image=image, value=value: spoilt_view(room(), image, value)
    for value in (_NAN, _INF, 1e30):
        frames[f"sky {value:g}"] = lambda value=value: dataclasses.replace(
            room(), world=World(np.full((4, 8, 3), value, np.float32)))
    for width, height in ((1, 1), (2, 1), (1, 3), (3, 2), (7, 5)):
        frames[f"{width} x {height} pixels"] = lambda width=width, height=height: room(width, height)
    frames["no surface in view"] = lambda: seen(
        room(), depth=np.full(SIZE[::-1], np.inf, np.float32), position_ws=np.zeros((*SIZE[::-1], 3), np.float32))
    frames["no triangles"] = lambda: dataclasses.replace(room(), geometry=Geometry.empty())
    frames["normals in all directions"] = lambda: with_normals(room())
    frames["normals of broken triangles"] = lambda: with_normals(with_triangles(room(), BROKEN))
    frames["no lamps"] = lambda: dataclasses.replace(room(), lights=(), views=())
    frames["lamps without views"] = lambda: dataclasses.replace(room(), views=())
    frames["broken triangles"] = lambda: with_triangles(room(), BROKEN)
    frames["broken triangles only"] = lambda: dataclasses.replace(room(), geometry=geometry_of(BROKEN))
    frames["one plane"] = lambda: dataclasses.replace(room(), geometry=geometry_of(quad((0.0, 0.0, 0.0), 2.0, 2.0)))
    frames["ten thousand triangles at one place"] = lambda: with_triangles(
        room(), np.repeat(quad((0.2, 0.2, 0.3), 0.01, 0.01), 5000, axis=0))
    frames["lamp in the corner"] = lambda: lamp_at(room(), (-1.9999, 1.9999, 1e-4))
    frames["lamp on the floor"] = lambda: lamp_at(room(), (0.4, -0.3, 0.0))
    frames["lamp inside the box"] = lambda: lamp_at(room(), (-0.5, 0.6, 0.7))
    for roughness in (0.0, 1.0):
        frames[f"mirrors of roughness {roughness:g} all around"] = lambda roughness=roughness: mirrors(room(), roughness)
    frames["camera inside the box"] = lambda: looked_at(room(), (-0.5, 0.6, 0.7))
    frames["camera in the box's front face"] = lambda: looked_at(room(), (-0.5, 0.2, 0.7))
    frames["near plane through the box"] = lambda: looked_at(room(), (-0.5, 0.199, 0.7))
    frames["normals turned away"] = lambda: seen(room(), normal_ws=-room().gbuffer.normal_ws)
    # for all but the floor and the box's top
    frames["normals edge on"] = lambda: seen(room(), normal_ws=np.zeros_like(room().gbuffer.normal_ws) + UP)
    frames["depths from 1 mm to 1000 km"] = lambda: of_any_depth(room())
    frames["a million million watts"] = lambda: powered(room(), 1e10)
    return frames


ODD_FRAMES = odd_frames()
