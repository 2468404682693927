"""What directional occlusion loses off screen and behind things, and what brings it back: python -m tools.ssdo_defects

    python -m tools.ssdo_defects [--figure docs/images/ssdo.png] [--width 200]

A room with a box and one lamp, of which the picture shows the middle. Panels, diffuse bounce alone: directional occlusion
with the whole room in view, with the middle in view, shared with reflective shadow maps, and these alone. Numbers are of
the middle. Blender is not needed.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from rtgi_addon import pipeline
from rtgi_addon.compare.report import write_picture
from rtgi_addon.core.frame import Frame, LightKind
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import RsmParams, SsdoParams, default_settings
from rtgi_addon.passes.base import Transport
from rtgi_addon.planner import Plan

MIDDLE = 0.5                # of the picture's width and height
RADIUS_M = 10.0             # more than the room: nothing is lost to the radius
GAP_PX = 4


def middle_of(frame: Frame) -> Frame:
    """The frame as a camera sees it that shows its middle only, pixel by pixel the same."""
    camera, (height, width) = frame.camera, frame.gbuffer.shape
    camera = dataclasses.replace(
        camera, width_px=int(width * MIDDLE), height_px=int(height * MIDDLE), left=camera.left * MIDDLE,
        right=camera.right * MIDDLE, bottom=camera.bottom * MIDDLE, top=camera.top * MIDDLE)
    return dataclasses.replace(frame, camera=camera, gbuffer=cast_view(camera, frame.geometry))


def cut(image: np.ndarray) -> np.ndarray:
    """The middle of a picture of the whole."""
    height, width = image.shape[:2]
    h, w = int(height * MIDDLE), int(width * MIDDLE)
    return image[(height - h) // 2:(height + h) // 2, (width - w) // 2:(width + w) // 2]


def light_of(frame: Frame, *techniques: str) -> dict[Transport, np.ndarray]:
    """All transports of some techniques, with little noise."""
    settings = default_settings()
    settings.params["ssdo"] = SsdoParams(radius_m=RADIUS_M, lattice_px=1, slices=8, steps=16, hand_over=True)
    settings.params["rsm"] = RsmParams(lattice_px=1, rays=256)
    return pipeline.run(frame, Plan(techniques), settings).transports


def bounce_of(frame: Frame, *techniques: str) -> np.ndarray:
    """(H, W, 3) W/m2: near and far bounce together."""
    light = light_of(frame, *techniques)
    return sum(light[t] for t in (Transport.NEAR_DIFFUSE, Transport.BOUNCE_DIFFUSE) if t in light)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--width", type=int, default=200, help="of one panel in pixels")
    args = parser.parse_args()
    size = 2 * args.width, 2 * (args.width * 3 // 4)
    whole = make_room_frame(*size, (LightKind.POINT,))
    part = middle_of(whole)
    truth = bounce_of(part, "direct", "rsm")
    panels = {"whole room in view": cut(bounce_of(whole, "direct", "ssdo")),
              "middle in view": bounce_of(part, "direct", "ssdo"),
              "shared with shadow maps": bounce_of(part, "direct", "rsm", "ssdo"), "shadow maps": truth}
    sky = make_room_frame(*size, (), world_radiance=1.0)
    open_part = middle_of(sky)
    world = light_of(open_part, "world")[Transport.WORLD_DIFFUSE].mean()
    print("| seen | bounce, of what shadow maps find | mean error | world's light, of what rays find |")
    print("| --- | --- | --- | --- |")
    skies = {"whole room in view": cut(light_of(sky, "ssdo")[Transport.WORLD_DIFFUSE]).mean() / world,
             "middle in view": light_of(open_part, "ssdo")[Transport.WORLD_DIFFUSE].mean() / world}
    for name, image in panels.items():
        print(f"| {name} | {image.mean() / truth.mean():.3f} | {100 * np.abs(image - truth).mean() / truth.mean():.1f} % | "
              + (f"{skies[name]:.2f} |" if name in skies else "- |"))
    if args.figure:
        bright = 0.8 / np.quantile(truth * part.gbuffer.albedo, 0.95)
        shown = [np.clip(image * part.gbuffer.albedo * bright, 0, 1)**(1 / 2.2) for image in panels.values()]
        gap = np.ones((len(shown[0]), GAP_PX, 3))
        row = np.concatenate([x for image in shown for x in (image, gap)][:-1], 1)
        args.figure.parent.mkdir(parents=True, exist_ok=True)
        write_picture(args.figure, np.round(255 * row).astype(np.uint8))


if __name__ == "__main__":
    main()
