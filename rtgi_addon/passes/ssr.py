"""Screen-space reflections: what a glossy surface reflects, found in the picture itself and, where that ends, in the scene.

The glossy bounce that leaves a pixel towards the viewer is

    L = F * integral of f(w) L_hit(w) dw,  integral of f(w) dw = 1

with f the GGX lobe around the mirror direction, F the reflectance `core.frame.GBuffer.specular` (Fresnel, colour and
multiple scattering are in it, so nothing else is multiplied), and L_hit the light of the lamps, of the world and of emissive
surfaces that the hit surface sends back. Rays are drawn from the lobe (`kernels.brdf.sample_lobe`), followed through the
picture (`kernels.screen_rays`) and, where it cannot answer, through the triangles (`kernels.scene_light`).

One bounce: L_hit is taken from what earlier techniques found of direct light, never from a bounce. Light that the ray finds
at its end without any bounce, the world's and that of emissive surfaces, is Cycles' Glossy Direct and goes into
WORLD_GLOSSY.

Rough surfaces are traced on a lattice and the noise is averaged over what blurs anyway (`kernels.gloss_filter`).
"""

from __future__ import annotations

import numpy as np

from ..core.frame import Frame, Geometry
from ..core.radiometry import mean_of
from ..core.techniques import SsrParams
from ..kernels.brdf import albedo_table
from ..kernels.bvh import build_bvh
from ..kernels.depth_pyramid import build_pyramid
from ..kernels.gloss_filter import blur_of_pixels, smooth_reflections, spread_reflections
from ..kernels.gloss_pixels import LEAST_SUM, colour_pixels, on_lattice, sort_pixels
from ..kernels.lit_hits import Gloss
from ..kernels.reflect import ASK, KNOWN, NEARNESS, SHARE, WEIGHT, Rules, collect_rays, draw_rays, follow_rays, make_rays
from ..kernels.scene_light import aim_lobes, ask_scene
from ..kernels.shines import has_aim
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .screen import MIRROR_ROUGHNESS, screen_of
from .surroundings import leave_surfaces, pack_lights, reach_out_m, shining_pixels, surroundings_of

NEGLIGIBLE = 1e-3           # Glossy Color below it is left out: a thousandth of what is reflected
SLACK_PX = 0.5              # thickness of surfaces where the triangles know better; thicker ones stand in the way of rays
                            # that pass behind them, thinner ones leave more rays to the triangles (1 % for half of it)
STEPS = ((0.12, 4), (0.03, 2))      # GGX alpha from which a surface is traced at every fourth, every second pixel
BRIGHT = 0.25               # Glossy Color from which a surface, a metal, takes BRIGHT_SHARE times the rays: it shows so much
BRIGHT_SHARE = 4            # more of their noise
BLOCK_PIXELS = 16           # `samples` counts rays for this many pixels, 4x4
FILTER_RADIUS = 4           # steps: a window of 9x9
FILTER_REACH = 0.7          # standard deviation of the filter over the blur of the lobe: 1 has 2 % less error on five scenes
                            # and makes blurred edges half as wide again, 0.5 has 2 % more and a third
WEAK_STEP = 2               # rays of a pixel that the lattice cannot serve are those of this step: a quarter of `samples`
TILE_RAYS = 1 << 17         # rays between two looks at Esc

_DIRECT = (Transport.DIRECT_DIFFUSE, Transport.WORLD_DIFFUSE, Transport.EMISSION_DIFFUSE)
_GLOSSY = (Transport.BOUNCE_GLOSSY, Transport.WORLD_GLOSSY)
_TOP = {"TRIANGLES": 99, "HIERARCHY": 99, "DDA": 0, "LINEAR": -1}    # the first where there are no triangles to ask


def compute_ssr(frame: Frame, params: SsrParams, context: Context, seed: int = 0) -> PassResult:
    """The glossy bounce, and the world and emissive surfaces as glossy surfaces show them.

    Parameters
    ----------
    frame : Frame
        With `geometry` for the fallback RAYS; without it the world alone answers where the picture cannot.
    params : SsrParams
    context : Context
        `light` holds what earlier techniques found of direct light at the camera's pixels, and for the fallback CONES the
        glossy bounce that is to be taken over.
    seed : int

    Returns
    -------
    PassResult
        BOUNCE_GLOSSY: (H, W, 3) float32 W/(m2 sr), light that met one surface before; WORLD_GLOSSY: light of the world and
        of emissive surfaces that met none. Diagnostics: rays, steps in the picture, traced pixels, shares of the rays that
        hit in the picture and that the triangles answered, share of the glossy pixels that no neighbour could serve.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Holds exactly: even light all around comes back as `specular` times its radiance; linear in light; zero for no light;
    HIERARCHY and DDA give the same picture; the same bits on any number of threads.
    Ignores bounces after the first, refraction, and what is invisible to the camera but not to reflections.
    """
    g = frame.gbuffer
    step, is_bright = step_of_pixels(frame, params.lattice_px)
    if not step.any():
        return PassResult({transport: np.zeros_like(g.specular) for transport in _GLOSSY}, diagnostics={"rays": 0})
    fallback = _fallback_of(frame, params, context)
    tracer = _Tracer(frame, params, context, fallback, is_bright, seed)
    traced = on_lattice(step)
    tracer.trace(step, traced)
    context.checkpoint("Filter reflections", 0.0)
    surface = (tracer.screen, g.roughness)
    blur = blur_of_pixels(tracer.results, *surface, step, traced, f32(FILTER_REACH))
    smooth = smooth_reflections(tracer.results, blur, traced, *surface, step, traced, FILTER_RADIUS)
    weak = np.zeros(step.shape, np.bool_)
    spread_reflections(len(traced), smooth, blur, *surface, step, traced, weak)
    if weak.any():
        tracer.trace(np.where(weak, WEAK_STEP, 0), weak)
        step, traced = np.where(weak, 1, step), traced | weak
        blur = blur_of_pixels(tracer.results, *surface, step, traced, f32(FILTER_REACH))
        smooth[weak] = smooth_reflections(tracer.results, blur, weak, *surface, step, traced, FILTER_RADIUS)[weak]
    weak_share = float(np.count_nonzero(weak) / np.count_nonzero(step))
    diagnostics = tracer.diagnostics | {"weak_share": weak_share}
    return _coloured(frame, smooth, step, fallback == "CONES", context, diagnostics)


def _coloured(frame: Frame, smooth: np.ndarray, step: np.ndarray, adds_earlier: bool, context: Context,
              diagnostics: dict[str, float]) -> PassResult:
    """The result from means over the lobe (H, W, FILTERED); what is not known of it is filled with earlier glossy light."""
    g = frame.gbuffer
    shines = not frame.world.is_black or g.emission.any() or (
        frame.geometry is not None and frame.geometry.emission.any())
    bounce, around = colour_pixels(smooth, step, g.specular, shines)
    light = dict(zip(_GLOSSY, (bounce, around), strict=True))
    earlier = [t for t in light if adds_earlier and t in context.light]
    for transport in earlier:
        known = smooth[..., SHARE] / np.maximum(smooth[..., WEIGHT], LEAST_SUM)
        light[transport] += np.clip(1 - known, 0, 1)[..., None] * context.light[transport]
    return PassResult(light, diagnostics=diagnostics, takes_over=frozenset(earlier))


def step_of_pixels(frame: Frame, lattice_px: int) -> tuple[np.ndarray, np.ndarray]:
    """(step (H, W) int64, is_bright (H, W) bool) of a frame's pixels.

    The step is of the lattice that a pixel belongs to, 1 for every pixel, 0 where nothing is reflected; bright ones take
    BRIGHT_SHARE times the rays.
    """
    g = frame.gbuffer
    alphas, sizes = zip(*reversed(STEPS), strict=True)
    return sort_pixels(g.mask, g.roughness, g.specular, np.array(alphas, np.float32), np.minimum(sizes, lattice_px),
                       NEGLIGIBLE, BRIGHT, MIRROR_ROUGHNESS)


def _fallback_of(frame: Frame, params: SsrParams, context: Context) -> str:
    """The fallback that this frame allows: cones need their light, rays need triangles."""
    fallback = params.fallback
    if fallback == "CONES" and Transport.BOUNCE_GLOSSY not in context.light:
        fallback = "RAYS"
    return "WORLD" if fallback == "RAYS" and frame.geometry is None else fallback


class _Tracer:
    """Traces pixels of a frame, tile by tile; keeps their results (H, W, NEARNESS + 1) and counts of what it took."""

    def __init__(self, frame: Frame, params: SsrParams, context: Context, fallback: str, is_bright: np.ndarray, seed: int):
        g = frame.gbuffer
        geometry = frame.geometry if frame.geometry is not None else Geometry.empty()
        has_rays = fallback == "RAYS"
        screen = screen_of(frame)
        self._looks_at_picture = not (params.method == "TRIANGLES" and has_rays)
        pyramid = build_pyramid(screen, SLACK_PX, 0.0 if has_rays else params.thickness * frame.scale_m,
                                self._looks_at_picture)
        lit = context.light.get(Transport.DIRECT_DIFFUSE)
        irradiance = np.zeros(g.shape, np.float32) if lit is None else mean_of(lit)
        gloss = Gloss(leave_surfaces(frame, context, _DIRECT), shining_pixels(frame), irradiance, g.specular, g.roughness,
                      g.f0, albedo_table())
        bvh = context.bvh(frame.geometry) if has_rays else build_bvh(np.zeros((0, 3, 3), np.float32))
        reach_m = reach_out_m(frame, bvh)
        fade_px = params.edge_fade * min(g.shape)
        self.results = np.zeros((*g.shape, NEARNESS + 1), np.float32)
        self.counts = {"rays": 0, "steps": 0, "hits": 0, "asked": 0, "traced_pixels": 0}
        self._around = surroundings_of(frame, geometry)
        self._params, self._context, self._seed, self._is_left_open = params, context, seed, fallback == "CONES"
        self._is_bright = is_bright
        aims = has_aim(self._around.shines) and not self._looks_at_picture
        self._rules = Rules(min(_TOP[params.method], len(pyramid.first) - 1), float(params.step_px), has_rays, has_rays,
                            aims, f32(fade_px), f32(frame.ray_offset_m), f32(reach_m))
        self.screen, self._pyramid, self._gloss, self._bvh = screen, pyramid, gloss, bvh
        self._lights = pack_lights(frame.lights, reach_m)

    def trace(self, step: np.ndarray, wanted: np.ndarray) -> None:
        """Reflect the `wanted` pixels (H, W) bool with the rays that a pixel of their step and brightness takes."""
        kind = (2 * step.astype(np.uint8) + self._is_bright) * wanted
        for size in range(1, 1 + int(step.max())):
            for is_bright in (False, True):
                index = np.flatnonzero(kind == 2 * size + is_bright)
                share = size**2 / BLOCK_PIXELS * (BRIGHT_SHARE if is_bright else 1)
                samples = max(1, round(self._params.samples * share))
                tile = max(TILE_RAYS // samples, 1)
                for first in range(0, len(index), tile):
                    self._context.checkpoint("Reflections", first / len(index))
                    self._trace_tile(index[first:first + tile], samples)

    def _trace_tile(self, index: np.ndarray, samples: int) -> None:
        rays = make_rays(len(index) * samples)
        draw_rays(len(index), index, samples, self.screen, self._pyramid.planes, self._gloss, self._rules, self._seed, rays)
        if self._looks_at_picture:
            follow_rays(len(index), index, samples, self.screen, self._pyramid, self._gloss, self._lights, self._rules,
                        self._seed, rays)
        if not self._is_left_open:
            asked = np.flatnonzero(rays.answer != KNOWN)
            ask_scene(len(asked), asked, index, samples, self.screen, self._pyramid.planes, self._gloss, self._lights,
                      self._bvh, self._around, self._rules, self._seed, rays)
        if self._rules.aims:
            aim_lobes(len(index), index, samples, self.screen, self._pyramid.planes, self._gloss, self._bvh, self._around,
                      self._rules, self._seed, rays)
        collect_rays(len(index), index, samples, rays, self._is_left_open, self._rules.offset_m, self.results)
        for name, number in (("rays", len(rays.answer)), ("steps", int(rays.steps.sum())),
                             ("hits", np.count_nonzero(rays.share)), ("asked", np.count_nonzero(rays.answer == ASK)),
                             ("traced_pixels", len(index))):
            self.counts[name] += number

    @property
    def diagnostics(self) -> dict[str, float]:
        """Rays, steps in the picture, and the shares of rays that hit there and that the triangles were asked for."""
        rays = max(self.counts["rays"], 1)
        return {"rays": self.counts["rays"], "steps": self.counts["steps"], "traced_pixels": self.counts["traced_pixels"],
                "hit_share": float(self.counts["hits"] / rays), "asked_share": float(self.counts["asked"] / rays)}


TECHNIQUE = Technique("ssr", "Screen-Space Reflections", SsrParams, compute_ssr,
                      frozenset(_GLOSSY), needs_geometry=True)
