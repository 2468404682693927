"""Whatever the frame and the parameters: each technique gives finite light of the documented shape, twice the same bits.

Frames are the room of `core.synthetic` seen from anywhere, through any camera, in any unit, of any surfaces, with holes.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtgi_addon import pipeline
from rtgi_addon.core.frame import Cutouts, Frame, Geometry, LightKind, World
from rtgi_addon.core.params import Params
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import TECHNIQUE_PARAMS, default_settings
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.passes import TECHNIQUES
from rtgi_addon.passes.base import Context
from rtgi_addon.planner import CapturePlan, plan_frame
from tests.hard_frames import run, seen
from tests.moved_frames import moved, turn
from tests.plane_frames import looking

pytestmark = pytest.mark.usefixtures("one_thread")

# the most that a parameter is given: enough for every branch, and a hundred pictures a second
MOST = {"resolution": 16, "cascades": 3, "directions": 4, "iterations": 8, "max_iterations": 8, "exact_voxels": 64,
        "clusters": 32, "lattice_px": 4, "slices": 3, "blur": 2, "step_px": 8}
MOST_OF_ANY = 12


def values_of(field: dataclasses.Field) -> st.SearchStrategy[Any]:
    """What a parameter may be, to its ends where that costs nothing."""
    meta = field.metadata
    if meta["choices"]:
        return st.sampled_from([c[0] for c in meta["choices"]])
    if isinstance(field.default, bool):
        return st.booleans()
    if isinstance(field.default, int):
        low = int(meta["low"])
        return st.integers(low, max(low, min(int(meta["high"]), MOST.get(field.name, MOST_OF_ANY))))
    return st.sampled_from([meta["low"], field.default, meta["high"]])


def params_of(name: str) -> st.SearchStrategy[Params]:
    kind = TECHNIQUE_PARAMS[name]
    return st.builds(kind, **{f.name: values_of(f) for f in dataclasses.fields(kind)})


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What a frame is made of, so that a failure tells it in a few words."""

    seed: int
    size: tuple[int, int]
    lamps: list[LightKind]
    lamps_size_m: float
    has_ceiling: bool
    projection: Projection
    place: tuple[float, float, float]
    shining: float              # share of the triangles
    cut_out: float              # share of the triangles
    sky: tuple[int, int]        # rows and columns of its map, (0, 0) for none
    holes: float                # share of the pixels
    scale: float
    turn_rad: float
    lacks: str


RECIPES = st.builds(
    Recipe, seed=st.integers(0, 2**16), size=st.sampled_from([(1, 1), (7, 5), (1, 6), (12, 9)]),
    lamps=st.lists(st.sampled_from(list(LightKind)), max_size=2), lamps_size_m=st.sampled_from([0.0, 0.3]),
    has_ceiling=st.booleans(), projection=st.sampled_from([Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC]),
    place=st.sampled_from([(0.0, -1.9, 1.5), (1.3, 1.2, 0.4), (-0.5, 0.6, 0.7), (-0.1, 1.1, 1.4), (0.0, 0.0, 9.0)]),
    shining=st.sampled_from([0.0, 0.2]), cut_out=st.sampled_from([0.0, 0.4]),
    sky=st.sampled_from([(0, 0), (1, 1), (4, 8)]), holes=st.sampled_from([0.0, 0.3]),
    scale=st.sampled_from([1.0, 1e-3, 1e4]), turn_rad=st.sampled_from([0.0, 1.1]),
    lacks=st.sampled_from(["nothing", "triangles", "views"]))


def cutouts_of(rng: np.random.Generator, triangles: int, share: float) -> Cutouts | None:
    """Leaves, whose map of 4x4 texels is there or not, and panes of an even opacity, on some of the triangles."""
    which = rng.random(triangles) < share
    number = int(which.sum())
    if not number:
        return None
    row = np.full(triangles, -1, np.int32)
    row[which] = np.arange(number)
    is_pane = rng.random(number) < 0.5
    texels = np.concatenate([rng.choice([0, 255], 16), [int(rng.integers(0, 256))]]).astype(np.uint8)
    place = np.where(is_pane[:, None], [16, 1, 1], [0, 4, 4]).astype(np.int32)
    coverage = np.where(is_pane, texels[16] / 255, texels[:16].mean() / 255).astype(np.float32)
    return Cutouts(row, rng.uniform(-8, 8, (number, 3, 2)).astype(np.float32), coverage, is_pane, place, texels)


def frame_of(recipe: Recipe) -> Frame:
    """A small frame that capture could deliver, or nearly."""
    rng, (width, height) = np.random.default_rng(recipe.seed), recipe.size
    room = make_room_frame(width, height, recipe.lamps, recipe.lamps_size_m, 0.0, recipe.has_ceiling)
    matrix = looking(np.array(recipe.place), rng.uniform([-2, -2, 0], [2, 2, 3]), (0.1, 0.2, 1.0))
    camera = Camera(recipe.projection, matrix, width, height, -1.0, 0.7, -0.4, 0.9)
    materials = tuple(dataclasses.replace(m, albedo=tuple(rng.choice([0.0, 0.5, 1.0], 3).tolist()),
                                          specular=tuple(rng.choice([0.0, 0.04, 1.0], 3).tolist()),
                                          roughness=float(rng.choice([0.0, 0.3, 1.0]))) for m in room.materials)
    albedo = np.array([m.albedo for m in materials], np.float32)[room.geometry.material]
    emission = np.zeros_like(room.geometry.emission)
    emission[rng.random(len(emission)) < recipe.shining] = (3.0, 1.0, 0.0)
    geometry = dataclasses.replace(room.geometry, albedo=np.repeat(albedo[:, None], 3, 1), emission=emission)
    geometry = dataclasses.replace(geometry, cutouts=cutouts_of(rng, len(geometry), recipe.cut_out))
    world = World(rng.uniform(0, 2, (*recipe.sky, 3)).astype(np.float32)) if all(recipe.sky) else World()
    views = tuple(dataclasses.replace(v, gbuffer=cast_view(v.camera, geometry, materials)) for v in room.views)
    frame = dataclasses.replace(room, camera=camera, gbuffer=cast_view(camera, geometry, materials), geometry=geometry,
                                materials=materials, world=world, views=views)
    is_hole = rng.random((height, width)) < recipe.holes
    frame = seen(frame, depth=np.where(is_hole, np.float32(np.inf), frame.gbuffer.depth),
                 position_ws=np.where(is_hole[..., None], np.float32(0), frame.gbuffer.position_ws))
    frame = moved(frame, turn((1, 2, 3), recipe.turn_rad), recipe.scale * np.array([0.1, 0, 3]), recipe.scale)
    if recipe.lacks == "triangles":
        return dataclasses.replace(frame, geometry=Geometry.empty())
    return dataclasses.replace(frame, views=()) if recipe.lacks == "views" else frame


def arrays_in(thing: Any) -> list[np.ndarray]:
    """All arrays of a frame, in order."""
    if isinstance(thing, np.ndarray):
        return [thing]
    if isinstance(thing, tuple):
        return [array for part in thing for array in arrays_in(part)]
    if dataclasses.is_dataclass(thing):
        return [array for f in dataclasses.fields(thing) for array in arrays_in(getattr(thing, f.name))]
    return []


@pytest.mark.parametrize("name", TECHNIQUES)
@given(data=st.data(), recipe=RECIPES, seed=st.integers(0, 2**31 - 1))
def test_any_frame_and_parameters_give_light_as_documented(name, data, recipe, seed):
    params, frame = data.draw(params_of(name), label="params"), frame_of(recipe)
    params.validate(name)
    before = [array.tobytes() for array in arrays_in(frame)]
    result = run(name, frame, params, seed)
    assert [array.tobytes() for array in arrays_in(frame)] == before, "the frame was written to"
    assert result.light and result.takes_over <= set(result.light)
    hidden = ~frame.gbuffer.mask
    for transport, image in result.light.items():
        assert image.shape == frame.gbuffer.albedo.shape and image.dtype == np.float32, transport
        assert np.isfinite(image).all() and (image >= 0).all(), transport
        assert not image[hidden].any(), transport
    for image in result.pictures.values():
        assert image.shape == frame.gbuffer.albedo.shape and image.dtype == np.float32 and np.isfinite(image).all()
    if result.visibility is not None:
        assert result.visibility.shape == frame.gbuffer.shape and result.visibility.dtype == np.float32
        # sums of float32 weights leave a last digit over 1
        assert np.isfinite(result.visibility).all() and 0 <= result.visibility.min() <= result.visibility.max() <= 1 + 1e-6
    again = run(name, frame, params, seed)
    assert set(again.light) == set(result.light)
    assert all(again.light[t].tobytes() == image.tobytes() for t, image in result.light.items())


@given(recipe=RECIPES, use_auto=st.booleans())
def test_any_frame_gives_a_finite_picture(recipe, use_auto):
    frame = frame_of(recipe)
    wanted = default_settings("DRAFT", None if use_auto else ["rsm", "ssdo", "ssr"])
    wanted = dataclasses.replace(wanted, threads=1)
    result = pipeline.run(frame, plan_frame(frame, wanted, CapturePlan()), wanted, Context())
    assert result.combined.shape == (*frame.gbuffer.shape, 4) and np.isfinite(result.combined).all()
    assert (result.combined >= 0).all()
