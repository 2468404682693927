"""Light without lamps against its integral in float64: of emissive surfaces straight, and of world and surfaces bounced."""

from __future__ import annotations

import dataclasses

import numpy as np

from rtgi_addon.core.frame import Frame
from rtgi_addon.core.synthetic import make_room_frame, nearest_hit
from rtgi_addon.core.techniques import EmissionParams, FinalGatherParams, WorldParams
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.emission import compute_emission
from rtgi_addon.passes.final_gather import compute_final_gather
from rtgi_addon.passes.world import compute_world

PANEL = np.array([[-0.6, -0.3, 2.4], [0.6, -0.3, 2.4], [0.6, 0.3, 2.4], [-0.6, 0.3, 2.4]])
RADIANCE = np.array([3.0, 2.0, 1.0])
GRID = 40                   # parts of the panel along an edge: 3 cm by 1.5 cm, with 0.1 % of its own
FIRST, SECOND = 4000, 40    # the oracle's rays from a point and from each hit: 1 % of noise in the mean of the points


def lit_room(world_radiance: float) -> Frame:
    """The room with a panel of two triangles that shines, hung under the ceiling so that both its sides do."""
    frame = make_room_frame(12, 8, (), world_radiance=world_radiance)
    geometry = frame.geometry
    corners = np.concatenate([geometry.corners_ws, PANEL[[[0, 1, 2], [0, 2, 3]]]]).astype(np.float32)
    emission = np.zeros((len(corners), 3), np.float32)
    emission[-2:] = RADIANCE
    albedo = np.concatenate([geometry.albedo, np.zeros((2, 3, 3), np.float32)])
    material = np.append(geometry.material, [0, 0]).astype(np.int32)
    return dataclasses.replace(frame, geometry=dataclasses.replace(
        geometry, corners_ws=corners, emission=emission, albedo=albedo, material=material))


def points_of(frame: Frame, every: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows and columns (N, 2), positions and normals (N, 3) float64) of some pixels."""
    chosen = np.argwhere(frame.gbuffer.mask)[::every]
    return (chosen, *(a[tuple(chosen.T)].astype(np.float64) for a in (frame.gbuffer.position_ws, frame.gbuffer.normal_ws)))


def panel_irradiance(position: np.ndarray, normal: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(3,) W/m2 of the panel, part by part."""
    s = (np.arange(GRID) + 0.5) / GRID
    u, v = (a.ravel()[:, None] for a in np.meshgrid(s, s))
    place = PANEL[0] + u * (PANEL[1] - PANEL[0]) + v * (PANEL[3] - PANEL[0])
    start = position + 1e-4 * normal
    way = place - start
    square = (way**2).sum(1)
    cosines = np.maximum(way @ normal, 0) * np.abs(way[:, 2]) / square
    t, _ = nearest_hit(np.broadcast_to(start, way.shape), way, corners[:-2])
    return RADIANCE * (cosines / square * (t > 1)).sum() * 1.2 * 0.6 / GRID**2


def cosine_directions(rng: np.random.Generator, normal: np.ndarray) -> np.ndarray:
    """(N, 3) directions by the cosine about normals (N, 3): a point of the unit sphere around each normal's end."""
    way = rng.normal(size=normal.shape)
    way = normal + way / np.linalg.norm(way, axis=1, keepdims=True)
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def bounced(frame: Frame, position: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(3,) W/m2: paths of two segments over matt surfaces that end in the world or on the panel."""
    geometry, corners = frame.geometry, frame.geometry.corners_ws.astype(np.float64)
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    way = cosine_directions(rng, np.tile(normal, (FIRST, 1)))
    start = np.tile(position + 1e-4 * normal, (FIRST, 1))
    t, hit = nearest_hit(start, way, corners)
    met = hit >= 0
    n = face[hit[met]] * -np.sign((face[hit[met]] * way[met]).sum(1))[:, None]
    place = start[met] + t[met, None] * way[met] + 1e-4 * n
    colour = geometry.albedo[hit[met], 0]
    arrived = np.zeros((len(place), 3))
    for _ in range(SECOND):
        _, second = nearest_hit(place, cosine_directions(rng, n), corners)
        arrived += np.where(second[:, None] >= 0, geometry.emission[second], frame.world.radiance[0, 0]) / SECOND
    return np.pi * (colour * arrived).sum(0) / FIRST


def test_light_of_a_panel_in_a_room_equals_its_integral():
    frame = lit_room(0.0)
    at, position, normal = points_of(frame, 3)
    wanted = np.array([panel_irradiance(p, n, frame.geometry.corners_ws) for p, n in zip(position, normal, strict=True)])
    result = compute_emission(frame, EmissionParams(rays=512, lattice_px=1), Context(), 3)
    got = result.light[Transport.EMISSION_DIFFUSE][tuple(at.T)]
    # 512 rays leave 1 % where half of the panel is seen, and the bound on a ray takes at most 1 %
    assert np.sqrt(((got - wanted) ** 2).mean()) < 0.02 * wanted.mean()
    assert abs(got.mean() / wanted.mean() - 1) < 0.01


def test_bounce_of_world_and_panel_equals_paths_of_two_segments():
    frame, rng = lit_room(0.4), np.random.default_rng(7)
    black = np.zeros_like(frame.gbuffer.specular)
    frame = dataclasses.replace(frame, gbuffer=dataclasses.replace(frame.gbuffer, specular=black), materials=tuple(
        dataclasses.replace(m, specular=(0.0, 0.0, 0.0)) for m in frame.materials))
    at, position, normal = points_of(frame, 7)
    wanted = np.array([bounced(frame, p, n, rng) for p, n in zip(position, normal, strict=True)])
    context = Context()
    for compute, params in ((compute_world, WorldParams(rays=1024, lattice_px=1)),
                            (compute_emission, EmissionParams(rays=512, lattice_px=1))):
        context.light |= compute(frame, params, context, 1).light
    result = compute_final_gather(frame, FinalGatherParams(rays=1024, lattice_px=1), context, 3)
    got = result.light[Transport.WORLD_BOUNCE_DIFFUSE][tuple(at.T)]
    # the picture is 12x8 pixels, and what it shows of the light is interpolated between their centres
    assert np.sqrt(((got - wanted) ** 2).mean()) < 0.08 * wanted.mean()
    assert abs(got.mean() / wanted.mean() - 1) < 0.03
