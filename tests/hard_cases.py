"""The hard cases of a renderer as numbers: frames that hold one case each, and what a technique makes of it.

Every measure is an error, 0 for a perfect technique. Tests hold them against bounds, and `tools/hard_cases.py` writes them
down, before and after what mends the case.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np

from rtgi_addon.core.frame import Frame, Geometry, Light, LightKind, LightView, Material, World
from rtgi_addon.core.params import Params
from rtgi_addon.core.radiometry import texel_directions, texel_flux
from rtgi_addon.core.synthetic import ROOM_HIGH, ROOM_LOW, box_triangles, cast_view, light_camera, make_room_frame
from rtgi_addon.core.techniques import EmissionParams, LpvParams, RsmParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.kernels import harmonics, ordinates, vpl
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes import TECHNIQUES
from rtgi_addon.passes.base import Transport
from tests.hard_frames import CHEAP, lamp_at, powered, room, run, run_as_it_is, seen
from tests.lpv_scenes import NOTHING, cube, harmonic_source, lit_grid, rectangle, texels
from tests.moved_frames import moved, turn
from tests.plane_frames import geometry_of, looking, quad, view_from
from tests.voxel_rooms import gathered
from tests.voxel_rooms import lit as lit_voxels
from tests.voxel_rooms import room as voxel_room

MATT = (Material("matt", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0), 1.0),)
GLOSSY = (Material("glossy", (0.5, 0.5, 0.5), (0.5, 0.5, 0.5), 0.3),)
BOUNCES = {"rsm": Transport.BOUNCE_DIFFUSE, "vxgi": Transport.BOUNCE_DIFFUSE, "lpv": Transport.BOUNCE_DIFFUSE,
           "final_gather": Transport.WORLD_BOUNCE_DIFFUSE}
WORLDS = dict.fromkeys(("world", "hbao", "ssao", "ssdo"), Transport.WORLD_DIFFUSE)
# hbao, ssao and ssdo know the picture only: they take the sky for open where no surface in view hides it
BY_SCENE = tuple(name for name in TECHNIQUES if name not in ("hbao", "ssao", "ssdo"))
FLOOR_M = 20.0
# irradiance in which the colour of a surface on the way is
SEES_COLOUR = {Transport.BOUNCE_DIFFUSE, Transport.NEAR_DIFFUSE, Transport.WORLD_BOUNCE_DIFFUSE}


def grey_world(radiance: float) -> World:
    """A constant world."""
    return World(np.full((1, 1, 3), radiance, np.float32))


def shining(geometry: Geometry, triangles: slice, radiance: float) -> Geometry:
    """The geometry with triangles that send `radiance` W/(m2 sr)."""
    emission = geometry.emission.copy()
    emission[triangles] = radiance
    return dataclasses.replace(geometry, emission=emission)


def lamp_view(light: Light, geometry: Geometry, width: int, height: int, eye: Camera | None = None) -> LightView:
    """What the first lamp of a frame sees of matt surfaces."""
    eye = eye or light_camera(light, width, height)
    return LightView(0, eye, cast_view(eye, geometry, MATT), texel_flux(light, eye))


def relative(got: np.ndarray, wanted: np.ndarray) -> float:
    """Mean difference over the mean."""
    return float(np.abs(got.astype(np.float64) - wanted).mean() / max(float(np.mean(wanted, dtype=np.float64)), 1e-30))


def farthest(got: dict[Transport, np.ndarray], wanted: dict[Transport, np.ndarray]) -> float:
    """The largest `relative` of the transports that hold light."""
    return max(relative(got.get(t, np.zeros_like(image)), image) for t, image in wanted.items() if image.any())


# ---- 1/r^2 in corners ----
def corner_of_texels(is_square: bool) -> float:
    """Largest relative error on a wall, 0.1 to 2 texels above the edge of a lit floor, summed over points or squares."""
    n, height = 101, np.repeat([0.1, 0.25, 0.5, 1.0, 2.0], 16)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(n) + 0.5, np.arange(n) - n / 2 + 0.5))
    table = texels(np.stack([x, y, np.zeros(n * n)], 1), (0, 0, 1), 1.0)
    across = np.tile((np.arange(16) + 0.5) / 16 - 0.5, 5)
    points = np.stack([np.zeros(80), across, height], 1)
    area = np.ones(n * n) if is_square else None
    got = vpl.gather_all(points, np.tile([1.0, 0, 0], (80, 1)), table, 0.0, area_m2=area)[:, 0]
    wanted = floor_beside_wall(n, n / 2 - across, height) + floor_beside_wall(n, n / 2 + across, height)
    return float(np.abs(got / wanted - 1).max())


def floor_beside_wall(depth: float, width: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Form factor from an element of a wall, `height` above the corner of a rectangle of the floor at a right angle (T4)."""
    inv = 1 / np.sqrt(depth**2 + height**2)
    return (np.arctan(width / height) - height * inv * np.arctan(width * inv)) / (2 * np.pi)


def corner_frame(reach_m: float) -> Frame:
    """The lowest `reach_m` of a wall over a floor of 2 m that a sun lights; a texel of its view is 83 mm wide."""
    geometry = geometry_of(rectangle((0, -1, 0), (2, 0, 0), (0, 2, 0)), rectangle((0, 0, 1), (2, 0, 0), (0, 0, 2)))
    sun = Light("sun", LightKind.SUN, looking((0, -1, 3), (0, -1, 0)), np.full(3, 3.0))
    view = lamp_view(sun, geometry, 24, 24, Camera(Projection.ORTHOGRAPHIC, sun.world_from_light, 24, 24, -1, 1, -1, 1))
    half, place = reach_m / 2, looking((0, -1, reach_m / 2), (0, 0, reach_m / 2), (0, 0, 1))
    camera = Camera(Projection.ORTHOGRAPHIC, place, 16, 12, -0.3, 0.3, -half, half)
    return Frame(camera, cast_view(camera, geometry, MATT), (sun,), (view,), geometry, MATT)


def over_right_in_corner(name: str, params: Params, reach_m: float) -> np.ndarray:
    """(H, W) light of `corner_frame` over what is right there."""
    frame = corner_frame(reach_m)
    x, z = (frame.gbuffer.position_ws[..., axis].astype(float) for axis in (0, 2))
    wanted = 1.5 * (floor_beside_wall(2.0, 1 - x, z) + floor_beside_wall(2.0, 1 + x, z))
    return run(name, frame, params).light[Transport.BOUNCE_DIFFUSE][..., 0] / wanted


def brightest_in_corner(name: str, params: Params, reach_m: float) -> float:
    """The largest pixel over what is right there: 1/r^2 without bound would be a spike."""
    return float(over_right_in_corner(name, params, reach_m).max())


def missing_in_corner(name: str, params: Params, reach_m: float) -> float:
    """Share of the light that is missing; negative where there is too much."""
    return 1 - float(over_right_in_corner(name, params, reach_m).mean())


# ---- grazing angles ----
def floor_frame(tilt: float, half_m: float = FLOOR_M, sky: float = 1.0) -> Frame:
    """A floor under a point lamp, a panel that shines and an even sky, seen at `tilt` rad from 3 m; pixels are glossy."""
    floor, panel = quad((0, 0, 0), half_m, half_m), rectangle((0, 1, 2), (0, 0.5, 0), (0.5, 0, 0))
    camera = view_from(np.array([0, 1 - 3 * np.cos(tilt), 3 * np.sin(tilt)]), np.array([0, 1.0, 0]), 0.4, 16, 12, (0, 0, 1))
    lamp = Light("point", LightKind.POINT, looking((0.3, 1, 1.5), (0.3, 1, 0)), np.full(3, 10.0))
    geometry = shining(geometry_of(floor, panel), slice(-2, None), 3.0)
    return Frame(camera, cast_view(camera, geometry_of(floor), GLOSSY), (lamp,), (lamp_view(lamp, geometry, 32, 16),),
                 geometry, MATT, grey_world(sky))


def bare_floor(frame: Frame, half_m: float = FLOOR_M) -> Frame:
    """The frame without its panel."""
    geometry = geometry_of(quad((0, 0, 0), half_m, half_m))
    views = tuple(dataclasses.replace(v, gbuffer=cast_view(v.camera, geometry, MATT)) for v in frame.views)
    return dataclasses.replace(frame, geometry=geometry, views=views)


def grazing_error(name: str, tilt: float) -> float:
    """Mean relative error against closed forms of what a technique gives to a floor seen at `tilt` rad."""
    frame, mask = floor_frame(tilt), floor_frame(tilt).gbuffer.mask
    p, params = frame.gbuffer.position_ws[mask].astype(float), None
    if name == "direct":
        transport, d = Transport.DIRECT_DIFFUSE, frame.lights[0].position_ws - p
        wanted = 10 * d[:, 2] / (d**2).sum(-1) ** 1.5
    elif name == "emission":
        transport, params = Transport.EMISSION_DIFFUSE, EmissionParams(rays=64, lattice_px=1)
        u = ((np.arange(100) + 0.5) / 100 - 0.5) * 0.5
        panel = np.stack(np.meshgrid(u, 1 + u), -1).reshape(-1, 2)
        r2 = ((panel - p[:, None, :2]) ** 2).sum(-1) + 4
        wanted = (3.0 * 0.25 / len(panel) * 4 / r2**2).sum(-1)
    else:
        frame = dataclasses.replace(bare_floor(frame), lights=(), views=())
        transport = WORLDS.get(name, Transport.WORLD_GLOSSY)
        wanted = np.full(len(p), np.pi if name in WORLDS else 0.5)      # `specular` times the sky's radiance
    return relative(run(name, frame, params).light[transport][mask][:, 0], wanted)


def own_light(name: str, params: Params | None = None, tilt: float = 0.5, turned_rad: float = 0.0) -> float:
    """Bounce that a lone floor, lit by a lamp, gives to itself, over the light of the lamp; 0 is right.

    It is turned in space, so that it cuts cells of a grid askew.
    """
    frame = moved(bare_floor(floor_frame(tilt, 2.0, 0.0), 2.0), turn((1, 2, 0.5), turned_rad))
    direct = run("direct", frame).light[Transport.DIRECT_DIFFUSE].mean()
    return float(run(name, frame, params).light[BOUNCES[name]].mean() / direct)


# ---- thin walls ----
def two_rooms(is_lit: bool) -> Frame:
    """The one or the other half of a closed room under a bright sky: lamp and shining panel in one, no light in the other.

    Between them stands a wall without thickness, off the planes of any grid.
    """
    geometry = geometry_of(box_triangles(ROOM_LOW, ROOM_HIGH), rectangle((0.013, 0, 1.5), (0, 4.2, 0), (0, 0, 3.2)),
                           rectangle((-1, 1.99, 1), (0.5, 0, 0), (0, 0, 0.5)))
    geometry = shining(geometry, slice(-2, None), 5.0)
    lamp = Light("spot", LightKind.SPOT, looking((-1, -0.5, 2.6), (-1, -0.4, 0)), np.full(3, 10.0), spot_size_rad=2.0)
    x = -1.0 if is_lit else 1.0
    camera = view_from(np.array([x, -1.9, 1.5]), np.array([x, 0, 1.2]), 0.7, 16, 12, (0, 0, 1))
    return Frame(camera, cast_view(camera, geometry, GLOSSY), (lamp,), (lamp_view(lamp, geometry, 24, 24),), geometry, MATT,
                 grey_world(1.0))


def leak(name: str, params: Params | None = None) -> float:
    """Light of the dark room over that of the lit one, the worst transport; of the sky over that of an open surface."""
    lit, dark = (run(name, two_rooms(is_lit), params).light for is_lit in (True, False))
    nothing = np.zeros(1, np.float32)
    return max(float(dark.get(t, nothing).mean() / (image.mean() if image.any() else np.pi)) for t, image in lit.items())


# ---- grids ----
def furnace_on_cells(exact: float, offset: float) -> float:
    """Largest error of the light in a box that shines evenly, its walls `offset` cells off the planes between cells."""
    low, high = np.full(3, 3.0) + offset, np.full(3, 13.0) + offset
    scene, points, normals = voxel_room((16, 16, 16), box_triangles(low, high)), [], []
    for across in ((8, 8), (5, 7), (8.5, 4.5), (6.25, 9)):              # corners, edges and middles of cells
        for axis in range(3):
            for sign, face in ((1, low), (-1, high)):
                point, normal = np.insert(np.array(across, float), axis, face[axis] + sign * 1e-4), np.zeros(3)
                normal[axis] = sign
                points.append(point)
                normals.append(normal)
    return float(np.abs(gathered(scene, lit_voxels(scene), np.array(points), np.array(normals), exact, 512) - 1).max())


def fall_off(mode: str) -> float:
    """Largest factor by which light on a texel's axis is off 1/r^2, 2 to 6 cells away."""
    points = np.array([[0.0, 0.0, r] for r in (2, 3, 4, 5, 6)])
    down, wanted, grid = np.tile([0.0, 0.0, -1.0], (5, 1)), 1 / (np.pi * points[:, 2] ** 2), cube(33)
    if mode == "ORDINATES":
        flux, bvh = lit_grid(texels(np.zeros((1, 3)), (0, 0, 1), 1.0), grid)
        got = ordinates.irradiance(points, down, flux, grid, 4, bvh, 1e-5)[:, 0]
    else:
        is_published = mode == "PAPER"
        light = harmonics.propagate(harmonic_source(33, (0, 0, 1)), grid, -np.inf, 8 if is_published else 64,
                                    clamp=is_published)[0]
        got = harmonics.irradiance(points, down, light, grid, build_bvh(NOTHING), 1e-5, by_sight=not is_published,
                                   damps=False)[:, 0]
    return float(np.maximum(got / wanted, wanted / np.maximum(got, 1e-9)).max())


def growth_of_flux(clamp: bool, steps: int) -> float:
    """Flux of a Lambertian texel after steps in open space, over what it sent, less 1."""
    return abs(float(harmonics.propagate(harmonic_source(33, (0, 0, 1)), cube(33), -np.inf, steps, clamp=clamp)[2]) - 1)


def settled(mode: str) -> float:
    """Change of the light in a closed room from 64 steps to 256: light that diverges has no end."""
    frame = make_room_frame(12, 9, (LightKind.SPOT,), 0.0)

    def after(steps: int) -> np.ndarray:
        params = LpvParams(mode=mode, resolution=8, lattice_px=2, iterations=steps, max_iterations=steps, residual=0.0)
        return run("lpv", frame, params).light[Transport.BOUNCE_DIFFUSE]

    return relative(after(256), after(64))


# ---- light in a corner ----
def lamp_in_corner(from_corner_m: float) -> float:
    """Bounce by clusters and shadow rays against the plain sum over all texels, which nothing hides here."""
    frame = lamp_at(make_room_frame(16, 12, (LightKind.SPOT,), 0.0), (-2 + from_corner_m, 2 - from_corner_m, from_corner_m))
    frame = dataclasses.replace(frame, geometry=geometry_of(box_triangles(ROOM_LOW, ROOM_HIGH)))
    frame = lamp_at(frame, tuple(frame.lights[0].position_ws))
    frame = dataclasses.replace(frame, gbuffer=cast_view(frame.camera, frame.geometry, MATT))
    rays, whole = (run("rsm", frame, params).light[Transport.BOUNCE_DIFFUSE] for params in (
        RsmParams(rays=256, clusters=64, lattice_px=1), RsmParams(method="ALL", samples=16384)))
    return relative(rays, whole)


# ---- HDR spikes ----
def spike_in_the_sky(name: str, share: float = 1.0) -> float:
    """Error that this share of an open floor stays below, under a sky whose light comes from one texel of 2048."""
    sky = np.full((32, 64, 3), 0.01, np.float32)
    sky[6, 40] = 1e5
    direction, solid_angle = texel_directions(32, 64)
    wanted = float((sky[..., 0] * solid_angle * np.maximum(direction[..., 2], 0)).sum())
    frame = dataclasses.replace(bare_floor(floor_frame(0.3)), lights=(), views=(), world=World(sky))
    mask = frame.gbuffer.mask
    return float(np.quantile(np.abs(run(name, frame).light[Transport.WORLD_DIFFUSE][mask] / wanted - 1), share))


def tiny_emitter(name: str, params: Params) -> float:
    """Largest error on a floor under a square of 1 mm that sends 1e9 W/(m2 sr)."""
    frame = floor_frame(1.0)
    geometry = geometry_of(quad((0, 0, 0), FLOOR_M, FLOOR_M), rectangle((0, 1, 2), (0, 1e-3, 0), (1e-3, 0, 0)))
    frame = dataclasses.replace(frame, geometry=shining(geometry, slice(-2, None), 1e9), lights=(), views=(), world=World())
    r2 = ((np.array([0, 1.0, 2.0]) - frame.gbuffer.position_ws.astype(float)) ** 2).sum(-1)
    wanted = 1e9 * 1e-6 * 4 / r2**2
    return float(np.abs(run(name, frame, params).light[Transport.EMISSION_DIFFUSE][..., 0] / wanted - 1).max())


def spike_in_a_view(name: str, params: Params) -> float:
    """A texel with a million times its light among others, against that texel alone: what the others add is a thousandth."""
    frame = room()
    view = frame.views[0]
    on_floor = (view.incident_flux[..., 0] > 0) & (view.gbuffer.normal_ws[..., 2] > 0.9)
    # away from edges, where a texel is several small lamps, each with noise of its own
    inside = np.logical_and.reduce([np.roll(on_floor, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    inside = np.argwhere(inside)
    at = tuple(inside[len(inside) // 2])
    flux, alone = view.incident_flux.copy(), np.zeros_like(view.incident_flux)
    flux[at] *= 1e6
    alone[at] = flux[at]
    both, one = (run(name, dataclasses.replace(frame, views=(dataclasses.replace(view, incident_flux=f),)), params)
                 .light[Transport.BOUNCE_DIFFUSE] for f in (flux, alone))
    return relative(both, one)


# ---- numbers ----
def far_away(name: str, distance_m: float, is_kept_near: bool) -> float:
    """A room moved far from the world's origin against the same at it; `is_kept_near` as capture keeps it.

    Capture takes the camera's place off every position in float64; without that, positions lose digits in float32.
    """
    frame, shift = room(), distance_m * np.array([1.0, -1.0, 0.3])
    origin = frame.camera.position_ws + shift if is_kept_near else np.zeros(3)
    there = moved(frame, np.eye(3), shift - origin)
    return farthest(run(name, there).light, run(name, frame).light)


def stretched_normals(name: str, factor: float, is_mended: bool) -> float:
    """Normals `factor` times as long as they should be against the same of length 1."""
    frame = room()
    other = seen(frame, normal_ws=frame.gbuffer.normal_ws * np.float32(factor))
    return farthest((run if is_mended else run_as_it_is)(name, other).light, run(name, frame).light)


def repainted(frame: Frame, albedo: float) -> Frame:
    """The frame with one albedo everywhere, and no gloss."""
    def painted(g):
        return dataclasses.replace(g, albedo=np.full_like(g.albedo, albedo), specular=np.zeros_like(g.specular))

    views = tuple(dataclasses.replace(v, gbuffer=painted(v.gbuffer)) for v in frame.views)
    geometry = dataclasses.replace(frame.geometry, albedo=np.full_like(frame.geometry.albedo, albedo))
    materials = tuple(dataclasses.replace(m, albedo=(albedo,) * 3, specular=(0.0,) * 3) for m in frame.materials)
    return dataclasses.replace(frame, gbuffer=painted(frame.gbuffer), views=views, geometry=geometry, materials=materials)


def beside_broken(name: str, what: str, is_mended: bool) -> float:
    """What one pixel of NaN changes in all others, over their light; infinite where they are not finite."""
    frame = room()
    values = getattr(frame.gbuffer, what).copy()
    values[5, 8] = np.nan
    try:
        got = (run if is_mended else run_as_it_is)(name, seen(frame, **{what: values})).light
    except (ValueError, IndexError):
        return float("inf")
    others = np.ones(frame.gbuffer.shape, bool)
    others[5, 8] = False
    wanted = run(name, frame).light
    black = np.zeros_like(frame.gbuffer.albedo)             # vxgi has no emission where its grid holds none
    change = [relative(got.get(t, black)[others], image[others]) for t, image in wanted.items() if image.any()]
    return max(change) if np.isfinite(change).all() else float("inf")


def of_power(name: str, factor: float) -> float:
    """A room lit by `factor` times its power, scaled back, against the room."""
    wanted = run(name, room()).light
    got = {t: image.astype(np.float64) / factor for t, image in run(name, powered(room(), factor)).light.items()}
    return farthest(got, wanted)


def white_against_grey(name: str) -> float:
    """Light between white surfaces, over what the albedo says, against that between grey ones."""
    grey, white = (run(name, repainted(room(), a)).light for a in (0.5, 1.0))
    return farthest({t: image / np.float32(2 if t in SEES_COLOUR else 1) for t, image in white.items()}, grey)


def on_threads(name: str) -> int:
    """Values of the picture that differ between one thread and all."""
    found = []
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        with kernel_session(threads):
            found.append(run(name, room(33, 19)).light)
    return sum(int(np.count_nonzero(found[1][t] != image)) for t, image in found[0].items())


def as_plain_python(light: dict[str, np.ndarray], name: str) -> float:
    """Compiled kernels against `plain_python_light`."""
    wanted = run(name, room()).light
    return farthest({t: light[f"{name}|{t.value}"] for t in wanted}, wanted)


_ALL_TECHNIQUES = """\
import sys
import numpy as np
from tests.hard_frames import CHEAP, room, run
np.savez(sys.argv[1], **{f"{name}|{transport.value}": image for name in CHEAP
                         for transport, image in run(name, room()).light.items()})
"""


def plain_python_light(folder: Path) -> dict[str, np.ndarray]:
    """{"technique|transport": light} of the room by kernels that are not compiled, from another process."""
    root, path = Path(__file__).resolve().parent.parent, folder / "light.npz"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-W", "ignore", "-c", _ALL_TECHNIQUES, str(path)], cwd=root, env=environment, check=True)
    with np.load(path) as data:
        return dict(data)


# ---- pixels ----
def with_holes(frame: Frame) -> tuple[Frame, np.ndarray]:
    """The frame with every third pixel of every third row looking past everything; (H, W) bool of the others' surfaces."""
    depth = frame.gbuffer.depth.copy()
    depth[::3, ::3] = np.inf
    is_seen = np.isfinite(depth)
    position = np.where(is_seen[..., None], frame.gbuffer.position_ws, 0).astype(np.float32)
    return seen(frame, depth=depth, position_ws=position), is_seen


def change_by_holes(name: str) -> float:
    """Largest change of a transport's mean over the surfaces that are left, the near bounce of ssdo aside."""
    frame = room(25, 19)
    holes, is_seen = with_holes(frame)
    whole, got, surface = run(name, frame).light, run(name, holes).light, is_seen & frame.gbuffer.mask
    return max(abs(float(got[t][surface].mean() / image[surface].mean()) - 1) for t, image in whole.items()
               if image[surface].any() and t is not Transport.NEAR_DIFFUSE)


def in_other_units(name: str, scale: float) -> float:
    """The room with lengths times `scale` and fluxes times its square against the room."""
    return farthest(run(name, moved(room(), np.eye(3), scale=scale)).light, run(name, room()).light)


def pole_frame(width: int = 41, height: int = 31) -> tuple[Frame, np.ndarray]:
    """The room with an upright glossy strip one pixel wide half-way to the back wall, and a side wall that shines.

    Also (H, W) bool: the strip's pixels.
    """
    frame = room(width, height)
    pixel = 2 * np.tan(np.radians(35)) * 1.9 / width                    # at the strip, 1.9 m from the camera
    strip = rectangle((pixel * 8, 0, 1.5), (pixel, 0, 0), (0, 0, 2.4))
    old, more = frame.geometry, geometry_of(strip)
    old = shining(old, slice(0, 2), 0.5)                                # the red wall, so that what shines lights the strip
    geometry = Geometry(*(np.concatenate([getattr(more, n), getattr(old, n)])
                          for n in ("corners_ws", "albedo", "emission", "material")))
    frame = dataclasses.replace(
        frame, geometry=geometry, gbuffer=cast_view(frame.camera, geometry, frame.materials, np.full(3, 0.5)),
        views=tuple(dataclasses.replace(v, gbuffer=cast_view(v.camera, geometry, frame.materials)) for v in frame.views))
    g = frame.gbuffer
    strip_px = g.mask & (np.abs(g.position_ws[..., 1]) < 1e-3)
    return seen(frame, specular=np.where(strip_px[..., None], np.float32(0.5), g.specular),
                roughness=np.where(strip_px, np.float32(0.5), g.roughness)), strip_px


def pole_error(name: str, lattice_px: int) -> float:
    """Light of the strip's pixels gathered every `lattice_px` pixels against every pixel; the mean over the strip."""
    frame, strip = pole_frame()
    # the dim lobes of surfaces between, a sixth of the rays each, have more noise than what is drawn by the cosine
    number = 1024 if name == "final_gather" else 256
    many = {key: number for key in ("rays", "cones", "samples") if hasattr(CHEAP[name], key)}
    every, coarse = (run(name, frame, dataclasses.replace(CHEAP[name], **many, lattice_px=step)).light
                     for step in (1, lattice_px))
    return max(abs(float(coarse[t][strip].mean() / image[strip].mean()) - 1) for t, image in every.items()
               if image[strip].mean() > 0.01 * image.mean())
