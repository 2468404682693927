"""The techniques, one a file, and their registry. Nothing in here imports Blender."""

from __future__ import annotations

from ..errors import InputError
from .base import Technique
from .direct import TECHNIQUE as _DIRECT
from .emission import TECHNIQUE as _EMISSION
from .final_gather import TECHNIQUE as _FINAL_GATHER
from .hbao import TECHNIQUE as _HBAO
from .lpv import TECHNIQUE as _LPV
from .rsm import TECHNIQUE as _RSM
from .ssao import TECHNIQUE as _SSAO
from .ssdo import TECHNIQUE as _SSDO
from .ssr import TECHNIQUE as _SSR
from .vxgi import TECHNIQUE as _VXGI
from .world import TECHNIQUE as _WORLD

# in the order in which they run; where several could supply the same light, the planner prefers the first
TECHNIQUES: dict[str, Technique] = {
    t.name: t for t in (_DIRECT, _WORLD, _EMISSION, _RSM, _VXGI, _LPV, _FINAL_GATHER, _HBAO, _SSAO, _SSDO, _SSR)}


def technique(name: str) -> Technique:
    """The registered technique called `name`; InputError with the known names otherwise."""
    if name not in TECHNIQUES:
        raise InputError(f"no technique is called {name!r}; known are {', '.join(TECHNIQUES)}")
    return TECHNIQUES[name]
