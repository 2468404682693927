"""What ambient occlusion of the screen gets wrong, against rays through the triangles: python -m tools.ambient_defects

    python -m tools.ambient_defects FRAME.npz ... [--rays N] [--figure OUT.png]

Frames are what `rtgi_addon.frameio` saves. Each is put under an even white world, which makes the visibility of `world`
the ray-traced one. Prints tables in Markdown: decibels and time of each method (processor time of two threads, halved);
decibels of HBAO's cosine form against rays that are no longer than its radius; error over the number of taps. The figure
shows the first frame by the ball, the hemisphere, HBAO and rays.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

from rtgi_addon.compare.report import write_picture
from rtgi_addon.core.frame import Frame, World
from rtgi_addon.core.techniques import HbaoParams, SsaoParams, WorldParams
from rtgi_addon.frameio import load_frame
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.kernels.pilot import cast_rays
from rtgi_addon.kernels.vec3 import f32
from rtgi_addon.passes.base import Context
from rtgi_addon.passes.hbao import compute_hbao
from rtgi_addon.passes.ssao import compute_ssao
from rtgi_addon.passes.world import compute_world

METHODS = {
    "SSAO, ball": (compute_ssao, SsaoParams(method="SPHERE")),
    "SSAO, hemisphere": (compute_ssao, SsaoParams()),
    "HBAO as published": (compute_hbao, HbaoParams(method="PUBLISHED")),
    "HBAO, cosine": (compute_hbao, HbaoParams()),
    "HBAO, cosine, lattice 2": (compute_hbao, HbaoParams(lattice_px=2)),
    "HBAO, cosine, overscan 0.15": (compute_hbao, HbaoParams(overscan=0.15)),
}
RADII = (0.025, 0.05, 0.2, 1.0)     # of the scene's size; 0.2 is the default
EVERY = 7                   # pixels between two that get rays of a radius' length
SAMPLES = (4, 8, 16, 32, 64)
WHITE = World(np.ones((1, 1, 3), np.float32))


def decibels(got: np.ndarray, wanted: np.ndarray, mask: np.ndarray) -> float:
    """Peak signal to noise of two visibilities over the pixels of `mask`."""
    return float(-10 * np.log10(np.mean((got - wanted)[mask].astype(float)**2)))


def radius_decibels(frame: Frame, share: float, overscan: float, rays: int) -> float:
    """Decibels of HBAO's cosine form against rays as long as its radius, `share` of the scene's size.

    The error is the product of the errors against two halves of the rays, which leaves their noise out.
    """
    at, rng, radius = (slice(EVERY // 2, None, EVERY),) * 2, np.random.default_rng(0), share * frame.scale_m
    g, bvh = frame.gbuffer, Context().bvh(frame.geometry)
    seen = g.mask[at]
    place, normal = g.position_ws[at][seen], g.normal_ws[at][seen]
    way = rng.normal(size=(len(place), rays, 3))
    way = normal[:, None] + way / np.linalg.norm(way, axis=-1, keepdims=True)        # by the cosine
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    start = np.repeat(place + frame.ray_offset_m * normal, rays, 0)
    _, slot, _, _ = cast_rays(start.astype(np.float32), way.reshape(-1, 3).astype(np.float32), bvh, f32(0), f32(radius))
    halves = (slot < 0).reshape(len(place), 2, -1).mean(-1)
    got = compute_hbao(frame, HbaoParams(radius_m=radius, slices=8, steps=32, overscan=overscan), Context(), 0).visibility
    error = got[at][seen][:, None] - halves
    return float(-10 * np.log10(error.prod(1).mean()))


def timed(compute, frame: Frame, params) -> tuple[np.ndarray, float]:
    """(visibility, processor seconds / 2); the kernels are compiled before."""
    compute(frame, params, Context(), 0)
    start = time.process_time()
    visibility = compute(frame, params, Context(), 0).visibility
    return visibility, (time.process_time() - start) / 2


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Ambient occlusion of the screen against rays.")
    parser.add_argument("frames", nargs="+", type=Path)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args(argv)
    with kernel_session(2):
        print("| scene | " + " | ".join(METHODS) + " |\n" + "| --- " * (len(METHODS) + 1) + "|")
        for number, path in enumerate(options.frames):
            frame = dataclasses.replace(load_frame(path), world=WHITE)
            mask = frame.gbuffer.mask
            wanted = compute_world(frame, WorldParams(rays=options.rays, lattice_px=2), Context(), 0).visibility
            got = {name: timed(compute, frame, params) for name, (compute, params) in METHODS.items()}
            cells = [f"{decibels(v, wanted, mask):.1f} dB, {1000 * seconds:.0f} ms" for v, seconds in got.values()]
            print(f"| {path.stem} | " + " | ".join(cells) + " |", flush=True)
            if number == 0:
                curve, shown = by_taps(frame, mask), got | {"rays": (wanted, 0.0)}
        columns = [f"{100 * share:g} %{words}" for share in RADII for words in ("", ", overscan 0.3")]
        print("\n| radius | " + " | ".join(columns) + " |\n" + "| --- " * (len(columns) + 1) + "|")
        for path in options.frames:
            frame = dataclasses.replace(load_frame(path), world=WHITE)
            found = [radius_decibels(frame, share, overscan, options.rays) for share in RADII for overscan in (0.0, 0.3)]
            print(f"| {path.stem} | " + " | ".join(f"{value:.1f} dB" for value in found) + " |", flush=True)
        print("\n| taps a pixel | SSAO, hemisphere: rms to its limit | HBAO, cosine: rms to its limit |")
        print("| --- | --- | --- |")
        for row in curve:
            print(f"| {row[0]} | {row[1]:.4f} | {row[2]:.4f} |")
    if options.figure:
        names = ("SSAO, ball", "SSAO, hemisphere", "HBAO, cosine", "rays")
        panels = np.concatenate([shown[name][0][1::3, 1::3] for name in names], 1)
        grey = np.uint8(255 * np.clip(panels, 0, 1)**(1 / 2.2) + 0.5) & np.uint8(0xF8)      # fewer levels, a smaller file
        write_picture(options.figure, np.repeat(grey[..., None], 3, 2))
    return 0


def by_taps(frame: Frame, mask: np.ndarray) -> list[tuple[int, float, float]]:
    """(taps, error of SSAO, error of HBAO): root mean square to the same method with very many taps, without blur."""
    fine_ssao = compute_ssao(frame, SsaoParams(samples=512, blur=0), Context(), 9).visibility
    fine_hbao = compute_hbao(frame, HbaoParams(slices=16, steps=32, blur=0), Context(), 9).visibility
    out = []
    for taps in SAMPLES:
        ssao = compute_ssao(frame, SsaoParams(samples=taps, blur=0), Context(), 0).visibility
        hbao = compute_hbao(frame, HbaoParams(slices=1 if taps < 32 else 2, steps=taps // (2 if taps < 32 else 4), blur=0),
                            Context(), 0).visibility
        out.append((taps, *(float(np.sqrt(np.mean((a - b)[mask]**2))) for a, b in ((ssao, fine_ssao), (hbao, fine_hbao)))))
    return out


if __name__ == "__main__":
    raise SystemExit(main())
