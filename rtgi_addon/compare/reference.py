"""What comparisons need of Blender: one-bounce renders by Cycles, renders by RTGI, pictures through the view transform.

A reference has every default of Cycles that biases switched off. Whatever is set on the scene for a render is put back
after it, also after an error.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .. import engine
from ..blendfile import refuse_newer
from ..capture.versions import pass_name
from ..core.settings import Settings
from ..errors import CaptureError, InputError
from ..imageio import read_exr, read_png, write_png
from ..ui.props import settings_from_scene, settings_to_scene
from .halves import PASSES, Reference

SEEDS = (11, 77)
PEER_SEED = 5003            # of no half and no round of a reference: shared noise would make a peer look better than it is
_CHANNEL_ORDER = "RGBAXYZV"
_PASS_FLAGS = {"Depth": "z", "Emission": "emit"}
_Change = tuple[Any, str, Any]


@dataclass(frozen=True)
class Peer:
    """A render by Cycles that RTGI is held against: (H, W, 4) float32, row 0 at the top, and seconds of each timed frame."""

    combined: np.ndarray
    seconds: tuple[float, ...]


@contextlib.contextmanager
def changed(changes: Iterable[_Change]) -> Iterator[None]:
    """Set (owner, attribute, value) in order and put the old values back in reverse order; equal values are not touched."""
    before: list[_Change] = []
    try:
        for owner, name, value in changes:
            old = getattr(owner, name)
            if old != value:
                before.append((owner, name, old))
                setattr(owner, name, value)
        yield
    finally:
        for owner, name, old in reversed(before):
            setattr(owner, name, old)


def blender_version() -> str:
    """Of the running Blender, such as "5.2.0 LTS"."""
    return bpy.app.version_string


def open_scene(path: Path) -> bpy.types.Scene:
    """Open a .blend and return its scene; InputError if this Blender cannot."""
    refuse_newer(path, bpy.app.version[:2])
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise InputError(f"Blender cannot open {path}: {_first_line(error)}") from error
    return bpy.context.scene


def current_scene() -> bpy.types.Scene:
    """The scene that Blender has open."""
    return bpy.context.scene


def _first_line(error: RuntimeError) -> str:
    return str(error).strip().partition("\n")[0].removeprefix("Error: ")


@contextlib.contextmanager
def on_threads(scene: bpy.types.Scene, threads: int) -> Iterator[None]:
    """Both engines on `threads` threads for the time of the context; 0 leaves what the scene says."""
    render = scene.render
    with changed([(render, "threads_mode", "FIXED"), (render, "threads", threads)] if threads > 0 else []):
        yield


@contextlib.contextmanager
def keeping_data(scene: bpy.types.Scene) -> Iterator[None]:
    """Sessions, BVHs and textures stay between the renders in the context ("Persistent Data"), as in an animation."""
    with changed([(scene.render, "use_persistent_data", True)]):
        yield


def blender_binary() -> str:
    """Path of the Blender that runs, "" where bpy is a module of Python."""
    return bpy.app.binary_path or ""


def _rtgi_can_match(scene: bpy.types.Scene) -> list[_Change]:
    """Switch off what one engine draws and the other leaves out: lens and motion blur, borders, compositing."""
    render = scene.render
    changes = [(render, name, False) for name in ("use_border", "use_compositing", "use_sequencer", "use_motion_blur",
                                                  "use_freestyle", "use_multiview", "film_transparent")]
    changes.append((scene.cycles, "film_exposure", 1.0))
    if scene.camera is not None and scene.camera.type == "CAMERA":
        changes.append((scene.camera.data.dof, "use_dof", False))
    return changes


def _size(scene: bpy.types.Scene, size: tuple[int, int] | None) -> list[_Change]:
    if size is None:
        return []
    render = scene.render
    return [(render, "resolution_x", size[0]), (render, "resolution_y", size[1]), (render, "resolution_percentage", 100),
            (render, "pixel_aspect_x", 1.0), (render, "pixel_aspect_y", 1.0)]


@contextlib.contextmanager
def comparable(scene: bpy.types.Scene, size: tuple[int, int] | None = None) -> Iterator[None]:
    """For the time of the context the scene shows what both engines model, at `size` px."""
    if scene.camera is None:
        raise InputError(f"scene {scene.name!r} has no camera; add one and make it the scene's camera")
    with changed([*_rtgi_can_match(scene), *_size(scene, size)]):
        yield


def picture_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """Width and height in px that the scene renders at, its border aside."""
    render = scene.render
    share = render.resolution_percentage
    return max(1, render.resolution_x * share // 100), max(1, render.resolution_y * share // 100)


def _one_bounce(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, samples: int, seed: int, denoise: bool) -> list[_Change]:
    """Cycles with exactly one indirect bounce, nothing clamped or approximated, samples at the pixels' centres.

    The filter is a Gaussian, since Cycles takes a box filter as one pixel wide whatever width is set.
    """
    cycles = scene.cycles
    wanted: dict[str, Any] = {
        "samples": samples, "seed": seed, "use_animated_seed": False, "use_layer_samples": "IGNORE", "time_limit": 0.0,
        "use_adaptive_sampling": False, "use_denoising": denoise,
        "max_bounces": 1, "diffuse_bounces": 1, "glossy_bounces": 1,
        "sample_clamp_direct": 0.0, "sample_clamp_indirect": 0.0, "light_sampling_threshold": 0.0, "blur_glossy": 0.0,
        "use_fast_gi": False, "use_guiding": False, "pixel_filter_type": "GAUSSIAN", "filter_width": 0.01,
    }
    if denoise:                                  # the defaults, whatever the file says
        wanted |= {"denoiser": "OPENIMAGEDENOISE", "denoising_input_passes": "RGB_ALBEDO_NORMAL",
                   "denoising_prefilter": "ACCURATE", "denoising_quality": "HIGH"}
    changes: list[_Change] = [(scene.render, "engine", "CYCLES")]
    changes += [(cycles, name, value) for name, value in wanted.items() if hasattr(cycles, name)]
    return [*changes, (layer.cycles, "use_denoising", denoise)]


def _passes(layer: bpy.types.ViewLayer, names: Sequence[str]) -> list[_Change]:
    """Exactly these passes of the layer, so that none that nobody reads costs time."""
    wanted = {"use_pass_" + _PASS_FLAGS.get(name, name.lower().replace(" ", "_")) for name in names}
    flags = [p.identifier for p in layer.bl_rna.properties if p.identifier.startswith("use_pass_")]
    changes = [(layer, flag, flag in wanted) for flag in flags if not layer.is_property_readonly(flag)]
    changes += [(layer.cycles, p.identifier, False) for p in layer.cycles.bl_rna.properties
                if p.identifier.startswith(("use_pass_", "denoising_store"))]
    return changes


def _render(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, write: bool = False) -> float:
    """Render the layer; seconds. CaptureError in one line if Blender refuses."""
    start = time.perf_counter()
    try:
        bpy.ops.render.render(scene=scene.name, layer=layer.name, write_still=write)
    except RuntimeError as error:
        raise CaptureError(f"{scene.render.engine} could not render scene {scene.name!r}: {_first_line(error)}") from error
    return time.perf_counter() - start


@contextlib.contextmanager
def _writing_exr(scene: bpy.types.Scene, path: Path, multilayer: bool) -> Iterator[None]:
    """The scene's output is a float32 EXR at `path` for the time of the context."""
    settings, render = scene.render.image_settings, scene.render
    # in the order in which one decides what the next may be; put back in that order too
    wanted = {"file_format": "OPEN_EXR_MULTILAYER" if multilayer else "OPEN_EXR", "color_mode": "RGBA", "color_depth": "32",
              "exr_codec": "ZIP", "color_management": "FOLLOW_SCENE"}
    if hasattr(settings, "media_type"):          # Blender 5 asks for the kind of file first
        wanted = {"media_type": "MULTI_LAYER_IMAGE" if multilayer else "IMAGE", **wanted}
    before = {name: getattr(settings, name) for name in wanted}
    with changed([(render, "filepath", str(path)), (render, "use_file_extension", False), (render, "use_overwrite", True),
                  (render, "use_placeholder", False)]):
        try:
            for name, value in wanted.items():
                setattr(settings, name, value)
            yield
        finally:
            for name, value in before.items():
                setattr(settings, name, value)


def _gathered(path: Path, layer_name: str) -> dict[str, np.ndarray]:
    """The passes of one layer of a multilayer EXR: (H, W, C) float32, channels in the order RGBA or XYZ."""
    channels: dict[str, dict[str, np.ndarray]] = {}
    for full, values in read_exr(path).items():
        if full.startswith(layer_name + "."):
            name, _, channel = full.removeprefix(layer_name + ".").rpartition(".")
            channels.setdefault(name, {})[channel] = values
    return {name: np.stack([parts[c] for c in sorted(parts, key=_CHANNEL_ORDER.index)], -1).astype(np.float32)
            for name, parts in channels.items() if set(parts) <= set(_CHANNEL_ORDER)}


def _half(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, samples: int, seed: int,
          folder: Path) -> dict[str, np.ndarray]:
    path = folder / f"half_{seed}.exr"
    with (changed([*_one_bounce(scene, layer, samples, seed, False), *_passes(layer, PASSES)]),
          _writing_exr(scene, path, True)):
        _render(scene, layer, write=True)
    found = _gathered(path, layer.name)
    missing = [name for name in PASSES if pass_name(name) not in found]
    if missing:
        raise CaptureError(f"Cycles gave no {missing[0]} pass; it gave {', '.join(sorted(found))}")
    # Cycles divides light by colour and leaves NaN where the colour is zero
    return {name: np.nan_to_num(found[pass_name(name)], posinf=0.0, neginf=0.0) for name in PASSES}


def render_reference(scene: bpy.types.Scene, samples: int = 256, size: tuple[int, int] | None = None,
                     layer: bpy.types.ViewLayer | None = None, seeds: tuple[int, int] = SEEDS) -> Reference:
    """Two independent one-bounce renders by Cycles of `samples` samples a pixel each.

    Unbiased: no clamping, denoising, adaptive sampling, light threshold or blurred caustics. All samples of a pixel pass
    its centre (a filter of width 0.01), as RTGI's do. Depth of field, motion blur and border are off.

    Raises
    ------
    InputError
        No camera, or equal seeds.
    CaptureError
        Cycles could not render.
    """
    if seeds[0] == seeds[1]:
        raise InputError("the two halves of a reference need different seeds, or their noise is the same")
    layer = layer or scene.view_layers[0]
    with comparable(scene, size), tempfile.TemporaryDirectory(prefix="rtgi_reference_") as folder:
        halves = [_half(scene, layer, samples, seed, Path(folder)) for seed in seeds]
    return Reference(*halves, samples)


def linked_files() -> list[tuple[str, int, int]]:
    """(path, bytes, time of change in ns) of the images, libraries and caches that the open file reads from elsewhere."""
    found = []
    for name in sorted(set(bpy.utils.blend_paths(absolute=True, packed=False))):
        path = Path(name)
        if path.is_file():
            status = path.stat()
            found.append((name, status.st_size, status.st_mtime_ns))
    return found


def has_denoiser() -> bool:
    """Whether this Blender was built with OpenImageDenoise; some distributions' builds are not."""
    import _cycles

    return bool(_cycles.with_openimagedenoise)


def _read_render_result(scene: bpy.types.Scene, folder: Path) -> np.ndarray:
    """The picture that was rendered last, (H, W, 4) float32, linear."""
    path = folder / "peer.exr"
    with _writing_exr(scene, path, False):
        bpy.data.images["Render Result"].save_render(str(path), scene=scene)
    channels = read_exr(path)
    return np.stack([channels.get(c, np.ones_like(channels["R"])) for c in "RGBA"], -1).astype(np.float32)


def render_peer(scene: bpy.types.Scene, samples: int, denoise: bool = True, repeats: int = 1,
                size: tuple[int, int] | None = None, layer: bpy.types.ViewLayer | None = None,
                seed: int = PEER_SEED) -> Peer:
    """One-bounce Cycles of few samples, denoised by OpenImageDenoise, with the seconds of a second and further frames.

    Persistent data keeps session and BVH, and the first frame, which builds them, is not counted. No pass but Combined is
    made: a peer pays for nothing that it does not show.
    """
    layer = layer or scene.view_layers[0]
    with (comparable(scene, size), keeping_data(scene), tempfile.TemporaryDirectory(prefix="rtgi_peer_") as folder,
          changed([*_one_bounce(scene, layer, samples, seed, denoise), *_passes(layer, ("Combined",))])):
        _render(scene, layer)
        seconds = tuple(_render(scene, layer) for _ in range(repeats))
        return Peer(_read_render_result(scene, Path(folder)), seconds)


def render_eevee(scene: bpy.types.Scene, size: tuple[int, int] | None = None) -> tuple[Peer, str]:
    """EEVEE with ray tracing on, the scene's own settings otherwise: (second frame, name of the GPU or software that drew).

    Without a graphics context Blender may end the process: call it in a process of its own.
    """
    import gpu

    layer = scene.view_layers[0]
    engines = [item.identifier for item in type(scene.render).bl_rna.properties["engine"].enum_items]
    # 4.5 calls the present EEVEE by this name
    name = "BLENDER_EEVEE_NEXT" if "BLENDER_EEVEE_NEXT" in engines else "BLENDER_EEVEE"
    with (comparable(scene, size), keeping_data(scene), tempfile.TemporaryDirectory(prefix="rtgi_peer_") as folder,
          changed([(scene.render, "engine", name), (scene.eevee, "use_raytracing", True),
                   *_passes(layer, ("Combined",))])):
        _render(scene, layer)
        seconds = _render(scene, layer)
        combined = _read_render_result(scene, Path(folder))
    try:
        device = gpu.platform.renderer_get()
    except SystemError:                          # a module of Python does not tell
        device = ""
    return Peer(combined, (seconds,)), device


def scene_settings(scene: bpy.types.Scene) -> Settings:
    """The RTGI settings that the scene holds."""
    return settings_from_scene(scene)


def render_rtgi(scene: bpy.types.Scene, settings: Settings, size: tuple[int, int] | None = None,
                layer: bpy.types.ViewLayer | None = None) -> tuple[Any, float]:
    """Render once with RTGI; (`pipeline.Result`, seconds of the whole F12). The scene's own RTGI settings come back."""
    return render_rtgi_frames(scene, settings, 1, size, layer)[0]


def render_rtgi_frames(scene: bpy.types.Scene, settings: Settings, number: int, size: tuple[int, int] | None = None,
                       layer: bpy.types.ViewLayer | None = None) -> list[tuple[Any, float]]:
    """`render_rtgi` for `number` frames in a row, with no setting changed between them.

    As in an animation, and as `render_peer` times Cycles: after a change Blender hands the whole scene over anew, which
    takes 300 ms of 2.5 s on a scene of 260 000 triangles. Lamps' views, which an animation keeps where nothing moves in
    them, are rendered anew.
    """
    layer = layer or scene.view_layers[0]
    own = settings_from_scene(scene)
    threads = [(scene.render, "threads_mode", scene.render.threads_mode), (scene.render, "threads", scene.render.threads)]
    frames: list[tuple[Any, float]] = []
    try:
        with comparable(scene, size), changed([(scene.render, "engine", "RTGI")]), engine.every_view_anew():
            settings_to_scene(settings, scene)
            for _ in range(number):
                before = engine.last_result()
                seconds = _render(scene, layer)
                result = engine.last_result()
                if result is None or result is before:
                    raise CaptureError("RTGI gave no picture; Blender's messages above say why")
                frames.append((result, seconds))
    finally:
        settings_to_scene(own, scene)
        for owner, name, value in threads:
            setattr(owner, name, value)
    return frames


def displayed(image: np.ndarray, scene: bpy.types.Scene) -> np.ndarray:
    """(H, W, 3) uint8 of a linear picture (H, W, 3 or 4) through the scene's view transform."""
    rgba = np.ones((*image.shape[:2], 4), np.float32)
    rgba[..., :3] = image[..., :3]
    with tempfile.TemporaryDirectory(prefix="rtgi_display_") as folder, changed([(scene.render, "film_transparent", False)]):
        path = Path(folder) / "picture.png"
        write_png(path, rgba, scene)
        return np.ascontiguousarray(read_png(path)[..., :3])


def drawn_text(text: str, height_px: int) -> np.ndarray:
    """(H, W) float32 coverage in [0, 1] of one line of text in Blender's own font; `height_px` is the line's height."""
    import blf
    import imbuf

    font, size = 0, height_px * 0.72
    blf.size(font, size)
    width = int(blf.dimensions(font, text)[0]) + 2
    canvas = imbuf.new((max(width, 1), height_px))
    with tempfile.TemporaryDirectory(prefix="rtgi_text_") as folder:
        path = Path(folder) / "text.png"
        with blf.bind_imbuf(font, canvas, display_name=None):
            blf.color(font, 1.0, 1.0, 1.0, 1.0)
            blf.position(font, 1, height_px * 0.26, 0)
            blf.draw_buffer(font, text)
        imbuf.write(canvas, filepath=str(path))
        canvas.free()
        return read_png(path)[..., 0].astype(np.float32) / 255
