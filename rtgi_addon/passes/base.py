"""What every technique is: a named function from a frame to light on some transports."""

from __future__ import annotations

import contextlib
import enum
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core.frame import Cutouts, Frame, Geometry
from ..core.params import Params
from ..errors import Cancelled


class Transport(enum.Enum):
    """A kind of light path; `composite` lets each have one owner only.

    Direct, world and emission light comes straight from lamps, from the background and from emissive surfaces; bounce light
    takes one surface between: that of lamps, and as "world bounce" that of the world and of emissive surfaces. Diffuse
    transports are irradiance (W/m2) on the pixel's surface; glossy ones are radiance (W/(m2 sr)) that leaves the pixel
    towards the camera, colour included.
    """

    DIRECT_DIFFUSE = "direct diffuse"
    DIRECT_GLOSSY = "direct glossy"
    WORLD_DIFFUSE = "world diffuse"
    WORLD_GLOSSY = "world glossy"
    EMISSION_DIFFUSE = "emission diffuse"
    BOUNCE_DIFFUSE = "bounce diffuse"
    NEAR_DIFFUSE = "near bounce diffuse"
    WORLD_BOUNCE_DIFFUSE = "world bounce diffuse"
    BOUNCE_GLOSSY = "bounce glossy"

    @property
    def is_diffuse(self) -> bool:
        return self.value.endswith("diffuse")


@dataclass(frozen=True)
class PassResult:
    """What a pass gives: (H, W, 3) float32 a transport, an optional visibility (H, W) float32 in [0, 1], diagnostics.

    `takes_over` names transports whose earlier light, from `Context.light`, went into this result and is replaced by it.
    `pictures` (H, W, 3) float32 by name show what the technique works on; they are for looking at and not added up.
    `near_left_m` > 0 says that the bounce leaves out what `Context.near_m` asked for.
    """

    light: dict[Transport, np.ndarray]
    visibility: np.ndarray | None = None
    diagnostics: dict[str, Any] = field(default_factory=dict)
    takes_over: frozenset[Transport] = frozenset()
    near_left_m: float = 0.0
    pictures: dict[str, np.ndarray] = field(default_factory=dict)


class Context:
    """What a running pass may ask of its surroundings: whether to stop, where to report, earlier light, the scene's BVH.

    The BVH is built at most once for the same triangles, also over frames. `light` holds what the techniques before this one
    have supplied to the frame, by transport; a pass that reads it takes a missing transport as black.

    `to_come`: the transports that later techniques supply. `near_m`: a later technique brings the bounce of lamps' light
    from surfaces in view that are nearer than this, by `kernels.sampling.near_weight`; 0 for none. `near_left_m`: the same
    as far as the owner of the bounce left it out.
    """

    def __init__(self, is_cancelled: Callable[[], bool] = lambda: False,
                 report: Callable[[str, float], None] = lambda text, share: None):
        self.is_cancelled, self._report = is_cancelled, report
        self._bvh_of: np.ndarray | None = None
        self._cutouts_of: Cutouts | None = None
        self._tree: Any = None                   # as it is without cutouts
        self._bvh: Any = None
        self._voxels: tuple[Any, Any, Any] = (None, None, None)
        self.light: dict[Transport, np.ndarray] = {}
        self.span = (0.0, 1.0)                   # of a frame's progress that the shares of checkpoints lie in
        self.to_come: frozenset[Transport] = frozenset()
        self.near_m = self.near_left_m = 0.0

    @contextlib.contextmanager
    def listening(self, is_cancelled: Callable[[], bool], report: Callable[[str, float], None]) -> Iterator[None]:
        """Follow a render's Esc and progress for the time of the block; what is cached stays.

        No longer than that: the functions hold the render's engine, and an engine that Blender frees before Python does can
        no longer free its Cycles session.
        """
        before = self.is_cancelled, self._report
        self.is_cancelled, self._report, self.span = is_cancelled, report, (0.0, 1.0)
        try:
            yield
        finally:
            self.is_cancelled, self._report = before

    def checkpoint(self, text: str = "", share: float = 0.0) -> None:
        """Between tiles and stages: raise Cancelled if the user asked for it, else show `text` and `share` in [0, 1]."""
        if self.is_cancelled():
            raise Cancelled("the render was cancelled")
        if text:
            self._report(text, self.span[0] + (self.span[1] - self.span[0]) * share)

    def bvh(self, geometry: Geometry) -> Any:
        """`kernels.bvh.Bvh` over the triangles of `geometry`."""
        from ..kernels.bvh import build_bvh, with_cutouts

        same = self._bvh_of is geometry.corners_ws or (
            self._bvh_of is not None and np.array_equal(self._bvh_of, geometry.corners_ws))
        if not same:
            self._tree = build_bvh(geometry.corners_ws)
        if not same or self._cutouts_of is not geometry.cutouts:
            self._bvh = with_cutouts(self._tree, geometry.cutouts)
        self._bvh_of, self._cutouts_of = geometry.corners_ws, geometry.cutouts
        return self._bvh

    def voxels(self, geometry: Geometry, grid: Any) -> Any:
        """`voxel_scene.VoxelScene` of the triangles in `grid` (`voxel_scene.Grid`), made once for the same of both."""
        from .voxel_scene import voxel_scene

        before, its_grid, scene = self._voxels
        same = before is geometry or (before is not None and before.cutouts is geometry.cutouts and all(
            np.array_equal(getattr(before, name), getattr(geometry, name)) for name in ("corners_ws", "albedo", "emission")))
        if not same or its_grid != grid:
            scene = voxel_scene(geometry, grid)
        self._voxels = geometry, grid, scene
        return scene


@dataclass(frozen=True)
class Technique:
    """A registry line.

    `compute(frame, params, context, seed)` returns a PassResult; `transports` is what it may supply; `needs_geometry`
    and `needs_views` tell the planner what to capture. `near_m(frame, params)` is `Context.near_m` of one that takes a share
    of the bounce, 0 where it takes none.
    """

    name: str
    label: str
    params: type[Params]
    compute: Callable[[Frame, Any, Context, int], PassResult]
    transports: frozenset[Transport]
    needs_geometry: bool = False
    needs_views: bool = False
    near_m: Callable[[Frame, Any], float] | None = None
