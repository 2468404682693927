"""What a frame needs, decided from cheap facts, as data: printed, saved in the report, shown in the panel.

Two decisions: before capture, from lamps, materials and world (`plan_capture`); after it, from the frame itself
(`plan_frame`). Whatever is left out is said in words, with its reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .core.frame import Frame, Light, LightKind
from .core.radiometry import brightest
from .core.settings import Settings
from .core.techniques import ALWAYS_ON
from .passes import TECHNIQUES
from .passes.base import Technique, Transport
from .passes.ssr import NEGLIGIBLE

CYCLES_VIEWS = 4            # lamps whose view Cycles renders; further ones are cast through the triangles
CAST_VIEW_TEXELS = 20736    # of a view through the triangles, at most
SHADOW_TEXELS = 32768       # of a view that serves as a shadow map alone


@dataclass(frozen=True)
class SceneFacts:
    """What is known before any view is rendered."""

    lights: tuple[Light, ...]
    world_kind: str             # "black", "constant" or "map"
    has_glossy: bool
    has_emission: bool
    has_shadowless: bool = False    # whether objects cast no shadow, which Cycles' views show all the same


@dataclass(frozen=True)
class CapturePlan:
    """What to capture: light indices viewed by Cycles and cast through triangles, whether triangles are needed.

    `view_texels`: of each view by Cycles; cast ones have no more.
    """

    cycles_views: tuple[int, ...] = ()
    cast_views: tuple[int, ...] = ()
    view_texels: int = SHADOW_TEXELS
    geometry: bool = False
    left_out: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Plan:
    """The techniques that run, in order, (what, why) of everything left out, and what a `budget` chose, in words."""

    techniques: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...] = ()
    facts: dict[str, float] = field(default_factory=dict)
    budget: tuple[str, ...] = ()

    def to_json(self) -> dict:
        """As the report's `plan`."""
        return {"runs": [{"technique": name, "label": TECHNIQUES[name].label} for name in self.techniques],
                "left_out": [{"what": what, "why": why} for what, why in self.left_out], "facts": self.facts,
                "budget": list(self.budget)}


def reach_of(light: Light, centre_ws: np.ndarray, radius_m: float) -> float:
    """Irradiance W/m2 (mean over colours) that a lamp can give at most at the middle of a scene of this radius."""
    power = float(np.mean(light.power))
    if light.kind is LightKind.SUN:
        return power
    if light.kind.is_area:
        power *= light.size_x_m * light.size_y_m
    distance = max(float(np.linalg.norm(light.position_ws - centre_ws)), radius_m)
    return power / max(distance, 1e-9) ** 2


def plan_capture(facts: SceneFacts, settings: Settings, centre_ws: np.ndarray, radius_m: float) -> CapturePlan:
    """Which lights get a view, and of which sort; whether triangles are read."""
    wants_views = [t for t in TECHNIQUES.values() if settings.enabled.get(t.name, False) and t.needs_views]
    left_out: list[tuple[str, str]] = []
    order = sorted(range(len(facts.lights)), key=lambda i: (-reach_of(facts.lights[i], centre_ws, radius_m), i))
    wanted = order if any(t.name != "direct" for t in wants_views) else order[:CYCLES_VIEWS]
    most = 0 if facts.has_shadowless else CYCLES_VIEWS
    cycles, cast = wanted[:most], wanted[most:]
    if facts.has_shadowless and cast:
        left_out.append(("Cycles views of lamps", "some objects cast no shadow; light is followed through the triangles of "
                         "the others instead, without textures"))
    elif cast:
        left_out.append(("Cycles views of some lamps", f"{len(cast)} lamps are weaker than the first {len(cycles)}; their "
                         "light is followed through the triangles instead"))
    if not facts.has_glossy:
        left_out.append(("Glossy passes", "no material has a glossy lobe"))
    return CapturePlan(tuple(sorted(cycles)), tuple(sorted(cast)), _view_texels(wants_views, settings), True,
                       tuple(left_out))


def _view_texels(wants_views: list[Technique], settings: Settings) -> int:
    """Texels of a lamp's view: what the techniques ask for that look into it."""
    wanted = [getattr(settings.params[t.name], "map_texels", SHADOW_TEXELS) for t in wants_views if t.name != "direct"]
    if settings.use_auto:        # of those that could supply the bounce the first one will, see `_by_preference`
        wanted = wanted[:1]
    return max(wanted, default=SHADOW_TEXELS)


def plan_frame(frame: Frame, settings: Settings, capture: CapturePlan) -> Plan:
    """Which enabled techniques this frame needs."""
    left_out = list(capture.left_out)
    mask = frame.gbuffer.mask
    facts = {"surface_pixels": int(mask.sum()), "surface_share": float(mask.mean()), "lights": len(frame.lights),
             "light_views": len(frame.views),
             "triangles": len(frame.geometry) if frame.geometry is not None else 0,
             "glossy_share": float((brightest(frame.gbuffer.specular) > 0).mean())}
    chosen, owner = set(), {}
    for name in _by_preference(settings):
        technique, reason = TECHNIQUES[name], None
        if not settings.enabled.get(name, False):
            reason = "switched off"
        elif settings.use_auto or name in ALWAYS_ON:
            reason = _not_needed(name, frame, mask) or _already_owned(technique, owner)
        if reason:
            left_out.append((technique.label, reason))
            continue
        chosen.add(name)
        owner |= {transport: technique.label for transport in technique.transports if transport not in owner}
    return Plan(tuple(name for name in TECHNIQUES if name in chosen), tuple(left_out), facts)


def _by_preference(settings: Settings) -> list[str]:
    """All techniques, those first that get a transport which several could supply.

    The planner prefers by the order of the registry; without it, what the user switched on stands before what always runs.
    """
    return sorted(TECHNIQUES, key=lambda name: not settings.use_auto and name in ALWAYS_ON)


def _already_owned(technique: Technique, owner: dict[Transport, str]) -> str | None:
    """Why a technique would count light twice, or None."""
    for transport in sorted(technique.transports, key=lambda transport: transport.value):
        if transport in owner:
            return f"{owner[transport]} supplies the {transport.value} light"
    return None


def _not_needed(name: str, frame: Frame, mask: np.ndarray) -> str | None:
    """Why this frame can do without a technique, or None."""
    if not mask.any():
        return "the camera sees no surface"
    if name == "direct" and not frame.lights:
        return "there is no lamp"
    if name in ("world", "hbao", "ssao") and frame.world.is_black:
        return "the world is black"
    has_emitters = frame.geometry is not None and bool(frame.geometry.emission.any())
    nothing_shines = "what shines is lit with as lamps" if any(x.is_surface for x in frame.lights) else "no surface shines"
    if name == "emission" and not has_emitters:
        return nothing_shines
    if name == "final_gather" and frame.world.is_black and not has_emitters:
        return f"the world is black, and {nothing_shines}"
    if name == "ssr" and not ((brightest(frame.gbuffer.specular) > NEGLIGIBLE) & mask).any():
        return "no surface in view is glossy"
    if name == "ssr" and not (frame.lights or not frame.world.is_black or frame.gbuffer.emission[mask].any()
                              or has_emitters):
        return "there is no light to reflect"
    if name == "ssdo":
        return "rays through the triangles find its light also off screen"
    is_lit = any(view.incident_flux.any() and view.gbuffer.mask.any() for view in frame.views)
    if name in ("rsm", "lpv") and not is_lit:
        return "no lamp lights a surface" if frame.lights else "there is no lamp"
    if name == "vxgi" and not is_lit and not has_emitters:
        return "no lamp lights a surface, and none shines by itself"
    return None
