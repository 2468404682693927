"""What Blender gets of a frame: the composite, RTGI's own passes, and Cycles' light passes as Cycles would fill them."""

from __future__ import annotations

import math

import numpy as np

from .capture.versions import pass_name
from .core.frame import Frame
from .kernels.film import add_light, take_out_colour
from .kernels.vec3 import f32
from .passes.base import Transport as T
from .pipeline import Result

_DIRECT, _BOUNCE = (T.DIRECT_DIFFUSE, T.EMISSION_DIFFUSE), (T.BOUNCE_DIFFUSE, T.NEAR_DIFFUSE, T.WORLD_BOUNCE_DIFFUSE)
_OWN = {
    "RTGI Direct": (*_DIRECT, T.DIRECT_GLOSSY),
    "RTGI World": (T.WORLD_DIFFUSE, T.WORLD_GLOSSY),
    "RTGI Diffuse Bounce": _BOUNCE,
    "RTGI Glossy Bounce": (T.BOUNCE_GLOSSY,),
}
# without their colour, as Cycles gives them: a compositor multiplies it back
_BARE = {pass_name(name): transports for name, transports in {
    "Diffuse Direct": (*_DIRECT, T.WORLD_DIFFUSE), "Diffuse Indirect": _BOUNCE,
    "Glossy Direct": (T.DIRECT_GLOSSY, T.WORLD_GLOSSY), "Glossy Indirect": (T.BOUNCE_GLOSSY,)}.items()}


class Output:
    """The passes of one frame. `raw` holds what Cycles captured, by name, row 0 at the top.

    All are put together in one piece of memory, since the system takes longer to hand out new pages than the sums do.
    """

    def __init__(self, frame: Frame, result: Result, raw: dict[str, np.ndarray]):
        self._frame, self._result, self._raw = frame, result, raw
        self._room = np.empty(4 * math.prod(frame.gbuffer.shape), np.float32)

    def flat(self, name: str) -> np.ndarray | None:
        """Pass `name` as Blender takes it: all its numbers in one row, from the bottom; None for one that nobody fills.

        It is good until the next call.
        """
        if name == "Combined":
            return self.upside_down(self._result.combined)
        if name == "RTGI Visibility":
            return self.upside_down(self._result.visibility)
        if name in _OWN or name in _BARE:
            return self._sum(name)
        return np.ascontiguousarray(self._raw[name][::-1], np.float32).ravel() if name in self._raw else None

    def upside_down(self, picture: np.ndarray) -> np.ndarray:
        """`picture` (H, W) or (H, W, C) from the bottom, in one row; good until the next call."""
        flat = self._room[:picture.size]
        flat.reshape(picture.shape)[:] = picture[::-1]
        return flat

    def _sum(self, name: str) -> np.ndarray:
        g, light = self._frame.gbuffer, self._result.transports
        flat = self._room[:g.albedo.size]
        out, is_bare = flat.reshape(g.albedo.shape), name in _BARE
        out[:] = 0
        present = [transport for transport in (_BARE if is_bare else _OWN)[name] if transport in light]
        for transport in present:
            scale = f32(1 / math.pi) if transport.is_diffuse else f32(1)
            add_light(len(out), light[transport], g.albedo, scale, transport.is_diffuse and not is_bare, out)
        if is_bare and present and not present[0].is_diffuse:
            # Glossy Color as Cycles gives it to the compositor, not the lobes' reflectance in the G-buffer
            take_out_colour(len(out), self._raw[pass_name("Glossy Color")], out)
        return flat
