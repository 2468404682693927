"""The command `rtgi`: the same words under `python -m rtgi_addon` and under `blender --command rtgi`.

Exit codes: 0 done, 1 the render failed, 2 the words or the file were wrong. What went wrong is one line on stderr.
"""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import json
import math
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from . import __version__
from .blendfile import refuse_newer
from .compare.progress import clock
from .core.settings import PRESETS, Settings
from .core.techniques import ALWAYS_ON, LABELS, TECHNIQUE_PARAMS, optional_techniques, preset_params
from .errors import Cancelled, InputError, RtgiError

DONE, FAILED, WRONG_INPUT = 0, 1, 2
SMALLEST_PX, LARGEST_PX = 4, 65536            # what Blender's own resolution fields take

_EXAMPLES = """\
examples:
  rtgi render room.blend -o room.exr
      the picture as linear float32 EXR, techniques chosen for the scene
  rtgi render room.blend -o room.png --size 960x540 --preset quality --report room.json
      through the scene's view transform, with times, plan and warnings as JSON
  rtgi render door.blend -o frames/door_####.exr --frames 1-20 --skip-existing
      an animation; run it again to go on where it was stopped
  rtgi render room.blend -o room.png --target-time 1s
      the best settings for a time, or with --target-error 2% the fastest for an error, by docs/calibration.md
  rtgi compare room.blend -o room_compared
      error against Cycles one-bounce, one row a technique
  rtgi doctor
      what is installed, and the mend for what is missing

The same words work inside Blender:  blender -b room.blend --command rtgi render -o room.exr
and with the bpy module:             python -m rtgi_addon render room.blend -o room.exr
"""


class _Parser(argparse.ArgumentParser):
    """argparse, but a wrong word is one line."""

    def error(self, message: str) -> Any:
        raise InputError(f"{message}; see {self.prog} --help")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# ---- words ----

def parse_size(text: str) -> tuple[int, int]:
    """"960x540" to (960, 540); InputError for anything that is no picture."""
    match = re.fullmatch(r"(\d+)[xX](\d+)", text)
    if match is None:
        raise InputError(f"--size {text} is not WIDTHxHEIGHT; write for example 960x540")
    width, height = int(match[1]), int(match[2])
    if width == 0 or height == 0:
        raise InputError(f"--size {text} is a picture of zero size; write for example 960x540")
    if min(width, height) < SMALLEST_PX or max(width, height) > LARGEST_PX:
        raise InputError(f"--size {text}: both edges must be from {SMALLEST_PX} to {LARGEST_PX} px")
    return width, height


def parse_frames(text: str) -> range:
    """"1-20" to frames 1 to 20, the last included; InputError if reversed."""
    match = re.fullmatch(r"(-?\d+)-(-?\d+)", text)
    if match is None:
        raise InputError(f"--frames {text} is not FIRST-LAST; write for example 1-20")
    first, last = int(match[1]), int(match[2])
    if first > last:
        raise InputError(f"--frames {text} is reversed; write {last}-{first}")
    return range(first, last + 1)


def parse_techniques(text: str) -> list[str] | None:
    """"rsm,ssr" to names, "auto" to None; InputError for an unknown name, with the nearest known one."""
    if text.strip().lower() == "auto":
        return None
    names = [name.strip().lower() for name in text.split(",")]
    for name in names:
        if name not in TECHNIQUE_PARAMS:
            near = difflib.get_close_matches(name, TECHNIQUE_PARAMS, 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(f"no technique is called {name!r}; {hint}known are {', '.join(TECHNIQUE_PARAMS)} and auto")
    return names


def parse_preset(text: str) -> str:
    """"balanced" to "BALANCED"; InputError for an unknown preset."""
    known = [identifier for identifier, _, _ in PRESETS]
    if text.upper() not in known:
        raise InputError(f"no preset is called {text!r}; known are {', '.join(known).lower()}")
    return text.upper()


def parse_peers(text: str) -> tuple[list[int], bool]:
    """"1,4,eevee" to ([1, 4], True), "none" to ([], False): sample counts of Cycles, and whether EEVEE is rendered too."""
    words = [word.strip().lower() for word in text.split(",")]
    if words == ["none"]:
        return [], False
    for word in words:
        if word != "eevee" and not (word.isdecimal() and int(word) > 0):
            raise InputError(f"--peers {text}: {word!r} is no count of samples; write for example 1,4,16,eevee or none")
    return sorted({int(word) for word in words if word != "eevee"}), "eevee" in words


def parse_share(text: str, option: str, what: str) -> float:
    """"1%" or "0.01" to 0.01; InputError that says `what` it is not, unless it lies between 0 and 100 %."""
    match = re.fullmatch(r"([0-9.eE+-]+)\s*(%?)", text.strip())
    try:
        value = float(match[1]) / (100 if match[2] else 1) if match else 0.0
    except ValueError:
        value = 0.0
    if not 0 < value < 1:
        raise InputError(f"{option} {text} is no {what}; write for example 1% or 0.01")
    return value


def parse_error(text: str) -> float:
    """"2%" or "0.02" to 0.02; InputError unless it lies between 0 and 100 %."""
    return parse_share(text, "--target-error", "error")


def parse_time(text: str) -> float:
    """"1.5s", "800ms" or "1.5" to seconds; InputError for anything that is no time above zero."""
    match = re.fullmatch(r"([0-9.eE+-]+)\s*(ms|s|)", text.strip())
    try:
        value = float(match[1]) / (1000 if match[2] == "ms" else 1) if match else 0.0
    except ValueError:
        value = 0.0
    if not 0 < value < math.inf:
        raise InputError(f"--target-time {text} is no time; write for example 1.5s or 800ms")
    return value


def parse_setting(text: str) -> tuple[str, str, Any]:
    """"rsm.rays=64" to ("rsm", "rays", 64); InputError for an unknown name or a value of the wrong kind."""
    match = re.fullmatch(r"(\w+)\.(\w+)=(.*)", text)
    if match is None:
        raise InputError(f"--set {text} is not TECHNIQUE.NAME=VALUE; write for example rsm.rays=64")
    technique, name, value = match.groups()
    if technique not in TECHNIQUE_PARAMS:
        raise InputError(f"--set {text}: no technique is called {technique!r}; known are {', '.join(TECHNIQUE_PARAMS)}")
    fields = {field.name: field for field in dataclasses.fields(TECHNIQUE_PARAMS[technique])}
    if name not in fields:
        raise InputError(f"--set {text}: {technique} has no setting {name!r}; it has {', '.join(fields)}")
    default = fields[name].default
    if isinstance(default, bool):
        words = {"on": True, "true": True, "1": True, "off": False, "false": False, "0": False}
        if value.lower() not in words:
            raise InputError(f"--set {text}: {name} is a switch; write on or off")
        return technique, name, words[value.lower()]
    if isinstance(default, str):
        return technique, name, value.upper()
    try:
        return technique, name, type(default)(value)
    except ValueError:
        kind = "a whole number" if isinstance(default, int) else "a number"
        raise InputError(f"--set {text}: {name} must be {kind}") from None


def numbered(path: Path, frame: int, in_sequence: bool) -> Path:
    """`path` of one frame: "####" becomes the padded number; in a sequence a name without "#" gets "_####" at its end."""
    name = path.name
    if in_sequence and "#" not in name:
        name = f"{path.stem}_####{path.suffix}"
    return path.with_name(re.sub(r"#+", lambda m: f"{frame:0{len(m[0])}d}", name, count=1))


def check_output(path: Path, endings: Sequence[str]) -> None:
    """InputError unless a file of that name and ending can be written."""
    if path.suffix.lower() not in endings:
        raise InputError(f"{path} must end in {' or '.join(endings)}")
    if path.is_dir():
        raise InputError(f"{path} is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"cannot write {path}: there is no folder {path.parent}; make it first")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
        if path.exists():
            with path.open("ab"):
                pass
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}; choose another place") from error


# ---- scene ----

def _blender() -> Any:
    """The module bpy with RTGI registered; RtgiError with the mend if it does not load."""
    try:
        import bpy
    except ImportError as error:
        from .doctor import bpy_problem

        problem, mend = bpy_problem(error)
        raise RtgiError(f"Blender's Python module bpy: {problem}; {mend}") from error
    from . import register

    register()
    return bpy


def open_scene(bpy: Any, name: str | None) -> Any:
    """Open a .blend, or take the one that Blender has open; returns its scene. InputError if it cannot be used."""
    if name is None:
        if not bpy.data.filepath:
            raise InputError("no scene was named; write rtgi render SCENE.blend -o OUT.exr")
        return bpy.context.scene
    path = Path(name)
    warning = refuse_newer(path, bpy.app.version[:2])
    if warning:
        _say(f"rtgi: warning: {warning}")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise InputError(f"Blender cannot open {path}: {_one_line(error)}") from error
    return bpy.context.scene


def _one_line(error: BaseException) -> str:
    """An error's text without line breaks, without Blender's "Error:" in front, each sentence once."""
    lines = (line.strip().removeprefix("Error: ") for line in str(error).splitlines())
    return " ".join(dict.fromkeys(line for line in lines if line)) or type(error).__name__


def _emits(tree: Any) -> bool:
    """Whether a node tree, or a group in it, holds a node that gives light."""
    for node in tree.nodes:
        if node.type in {"EMISSION", "BACKGROUND"}:
            strength, colour = node.inputs["Strength"], node.inputs["Color"]
        elif node.type == "BSDF_PRINCIPLED":
            strength, colour = node.inputs["Emission Strength"], node.inputs["Emission Color"]
        elif node.type == "GROUP" and node.node_tree is not None:
            if _emits(node.node_tree):
                return True
            continue
        else:
            continue
        if (strength.is_linked or strength.default_value > 0) and (colour.is_linked or any(colour.default_value[:3])):
            return True
    return False


def has_light(scene: Any) -> bool:
    """Whether anything in the scene shines: a lamp that renders, the world, or a material."""
    objects = list(scene.objects)
    for owner in scene.objects:
        if owner.instance_type == "COLLECTION" and owner.instance_collection is not None:
            objects += owner.instance_collection.all_objects
    if any(o.type == "LIGHT" and not o.hide_render for o in objects):
        return True
    world = scene.world
    if world is not None and (_emits(world.node_tree) if world.node_tree else any(world.color)):
        return True
    materials = {slot.material for o in objects if not o.hide_render for slot in o.material_slots if slot.material}
    return any(m.node_tree is not None and _emits(m.node_tree) for m in materials)


def check_scene(scene: Any) -> None:
    """InputError for a scene without a camera, without light, or of zero size."""
    render = scene.render
    if scene.camera is None:
        raise InputError(f"scene {scene.name!r} has no camera; add one and make it the scene's camera")
    if not has_light(scene):
        raise InputError(f"scene {scene.name!r} has no light; add a lamp, or give the world or a material emission")
    share = render.resolution_percentage
    if min(render.resolution_x * share // 100, render.resolution_y * share // 100) < 1:
        raise InputError(f"{render.resolution_x}x{render.resolution_y} at {share} % is a picture of zero size; use --size")


def settings_from_words(words: argparse.Namespace, before: Settings) -> Settings:
    """The scene's own settings `before`, changed by what the command line says."""
    settings = before
    if words.preset is not None:
        settings = dataclasses.replace(settings, preset=words.preset, params=preset_params(words.preset), target_time_s=0.0,
                                       target_error=0.0)
    if words.target_time or words.target_error:
        settings = dataclasses.replace(settings, target_time_s=parse_time(words.target_time) if words.target_time else 0.0,
                                       target_error=parse_error(words.target_error) if words.target_error else 0.0)
    if words.techniques is not None:
        names = parse_techniques(words.techniques)
        wanted = TECHNIQUE_PARAMS if names is None else (*ALWAYS_ON, *names)
        settings = dataclasses.replace(settings, use_auto=names is None,
                                       enabled={name: name in wanted for name in TECHNIQUE_PARAMS})
    for text in words.set:
        technique, name, value = parse_setting(text)
        settings = settings.with_params(technique, **{name: value})
    if words.threads:
        settings = dataclasses.replace(settings, threads=words.threads)
    if words.seed is not None:
        settings = dataclasses.replace(settings, seed=words.seed)
    settings.validate()
    return settings


# ---- render ----

def render_frame(bpy: Any, scene: Any) -> Any:
    """Render the scene's current frame with RTGI; returns the pipeline's Result. RtgiError in one line if it fails."""
    from . import engine

    before = engine.last_result()
    try:
        bpy.ops.render.render(scene=scene.name)
    except RuntimeError as error:
        raise RtgiError(f"the render of frame {scene.frame_current} failed: {_one_line(error)}") from error
    result = engine.last_result()
    if result is None or result is before:
        raise RtgiError(f"the render of frame {scene.frame_current} gave no picture; Blender's messages above say why")
    return result


def pass_channels(result: Any) -> dict[str, Any]:
    """The channels of --passes: composite, every transport, the visibility and what techniques drew of themselves."""
    channels = {f"composite.{c}": result.combined[..., i] for i, c in enumerate("RGBA")}
    for transport, light in result.transports.items():
        channels.update({f"{transport.value}.{c}": light[..., i] for i, c in enumerate("RGB")})
    channels["visibility.V"] = result.visibility
    for name, picture in result.pictures.items():
        channels.update({f"{name}.{c}": picture[..., i] for i, c in enumerate("RGB")})
    return channels


def write_outputs(words: argparse.Namespace, scene: Any, result: Any) -> None:
    """Write the passes, the report and last the picture, whose presence says that a frame is done."""
    from . import imageio

    frame, in_sequence = scene.frame_current, words.frames is not None
    out = numbered(words.output, frame, in_sequence)
    try:
        if words.passes:
            imageio.write_exr(numbered(words.passes, frame, in_sequence), pass_channels(result))
        if words.report:
            with imageio.replacing(numbered(words.report, frame, in_sequence)) as partial:
                partial.write_text(json.dumps(result.report, indent=2) + "\n", encoding="utf-8")
        if out.suffix.lower() == ".png":
            imageio.write_png(out, result.combined, scene)
        else:
            imageio.write_composite_exr(out, result.combined)
    except OSError as error:
        raise InputError(f"cannot write beside {out}: {error.strerror}; choose another place") from error


def frames_to_render(words: argparse.Namespace, current: int) -> Iterator[int]:
    """Frames that the words name, `current` if they name none, without those that are there and may be skipped."""
    for frame in words.frames or [current]:
        out = numbered(words.output, frame, words.frames is not None)
        if words.skip_existing and out.exists():
            _say(f"rtgi: frame {frame}: {out} is there, skipped")
        else:
            yield frame


def run_render(words: argparse.Namespace) -> int:
    """`rtgi render`."""
    size = parse_size(words.size) if words.size else None
    words.frames = parse_frames(words.frames) if words.frames else None
    words.preset = parse_preset(words.preset) if words.preset else None
    for text, parse in ((words.target_time, parse_time), (words.target_error, parse_error)):
        if text:
            parse(text)
    if words.techniques:
        parse_techniques(words.techniques)
    check_output(words.output, (".exr", ".png"))
    if words.passes:
        check_output(words.passes, (".exr",))
    if words.report:
        check_output(words.report, (".json",))
    if words.scene is not None:
        refuse_newer(Path(words.scene), (sys.maxsize, 0))        # says what is wrong before Blender is loaded

    bpy = _blender()
    scene = open_scene(bpy, words.scene)
    from .ui.props import settings_from_scene, settings_to_scene

    settings_to_scene(settings_from_words(words, settings_from_scene(scene)), scene)
    scene.render.engine = "RTGI"
    if size:
        scene.render.resolution_x, scene.render.resolution_y = size
        scene.render.resolution_percentage = 100
    if words.frame is not None:
        scene.frame_set(words.frame)
    elif words.frames:
        scene.frame_set(words.frames[0])
    check_scene(scene)

    frames = list(frames_to_render(words, scene.frame_current))
    if len(frames) > 1:
        scene.render.use_persistent_data = True      # what does not move stays between frames
    start = time.perf_counter()
    for done, frame in enumerate(frames):
        scene.frame_set(frame)
        began = time.perf_counter()
        result = render_frame(bpy, scene)
        write_outputs(words, scene, result)
        now = time.perf_counter()
        line = f"rtgi: frame {frame}: {now - began:.2f} s, {numbered(words.output, frame, words.frames is not None)}"
        left = len(frames) - done - 1
        if left:
            line += f", {left} frames and about {clock((now - start) / (done + 1) * left)} left"
        _say(line)
        if done == 0:
            for warning in result.report["warnings"]:
                _say(f"rtgi: warning: {warning}")
            for choice in result.report["plan"]["budget"]:
                _say(f"rtgi: {choice}")
    return DONE


# ---- settings, doctor, warmup ----

def setting_words(value: Any) -> str:
    """A setting's value as `--set` takes it."""
    return ("on" if value else "off") if isinstance(value, bool) else str(value).lower()


def setting_lines(technique: str) -> Iterator[str]:
    """What `--set` takes of one technique: each setting with default and range, when it is read, and what it does."""
    for field in dataclasses.fields(TECHNIQUE_PARAMS[technique]):
        meta = field.metadata
        if meta["choices"]:
            values = " | ".join(identifier.lower() for identifier, _, _ in meta["choices"])
        elif isinstance(field.default, bool):
            values = "on | off"
        else:
            values = f"{meta['low']} to {meta['high']} {meta['unit']}".rstrip()
        yield f"  {technique}.{field.name}={setting_words(field.default)}   ({values})"
        yield f"      {meta['doc']}."
        for identifier, _, doc in meta["choices"]:
            yield f"      {identifier.lower()}: {doc}."
        for name, read_with in meta["only"].items():
            wanted = read_with if isinstance(read_with, tuple) else (read_with,)
            yield f"      Read only with {name} {' or '.join(map(setting_words, wanted))}."


def run_settings(words: argparse.Namespace) -> int:
    """`rtgi settings`."""
    names = parse_techniques(words.techniques) if words.techniques else None
    for name in names or TECHNIQUE_PARAMS:
        print(f"{name}: {LABELS[name]}")
        for line in setting_lines(name):
            print(line)
    return DONE



def run_doctor(_words: argparse.Namespace) -> int:
    """`rtgi doctor`."""
    from .doctor import examine

    problems = 0
    for finding in examine():
        print(finding, flush=True)
        problems += bool(finding.mend)
    print(f"{problems} {'problem' if problems == 1 else 'problems'}" if problems else "all is well")
    return FAILED if problems else DONE


def run_warmup(words: argparse.Namespace) -> int:
    """`rtgi warmup`."""
    from .core.cache_root import cache_root
    from .warmup import warm_up

    total = 0.0
    for step in warm_up(words.threads or 0):
        total += step.seconds
        print(f"{step.seconds:6.2f} s  {step.name}", flush=True)
    print(f"{total:6.2f} s  in all; kernels are kept in {cache_root()}")
    return DONE


# ---- compare, bench ----

def run_compare(words: argparse.Namespace) -> int:
    """`rtgi compare`."""
    size = parse_size(words.size) if words.size else None
    preset = parse_preset(words.preset) if words.preset else None
    techniques = parse_techniques(words.techniques) if words.techniques else None
    peers, eevee = parse_peers(words.peers)
    noise = parse_share(words.noise, "--noise", "noise level") if words.noise else None
    if words.scene is not None:
        refuse_newer(Path(words.scene), (sys.maxsize, 0))
    bpy = _blender()
    check_scene(open_scene(bpy, words.scene))
    from .compare.run import compare_scene

    compare_scene(words.scene, words.output, techniques, words.samples, size, preset, words.threads or 0, peers,
                  words.reference, noise, eevee, words.flip, words.cache)
    return DONE


def parse_axes(text: str) -> list[str]:
    """"lights,threads" to names, "all" to every axis; InputError for an unknown one."""
    from .compare.sweeps import AXES, check_axes

    names = [name.strip().lower() for name in text.split(",")]
    if names == ["all"]:
        return list(AXES)
    check_axes(names)
    return list(dict.fromkeys(names))


def run_bench(words: argparse.Namespace) -> int:
    """`rtgi bench`."""
    axes = parse_axes(words.sweep) if words.sweep else None
    size = parse_size(words.size)
    presets = [parse_preset(name) for name in words.presets.split(",")] if words.presets else None
    peers, eevee = parse_peers(words.peers)
    if eevee:
        raise InputError("rtgi bench does not measure EEVEE; rtgi compare does")
    for scene in words.scenes:
        refuse_newer(Path(scene), (sys.maxsize, 0))
    _blender()
    if axes is not None:
        from .compare import sweep_page
        from .compare.sweeps import sweep

        lines = sweep(words.scenes, words.output, axes, size, words.repeats, words.samples, presets, words.threads or 0,
                      words.reference)
        sweep_page.write_page(lines, words.output / "sweeps.md", words.output / "plots",
                              sweep_page.HEAD.format(command="rtgi bench --sweep", repeats=words.repeats))
        print(sweep_page.summary(lines))
        print(words.output / "sweeps.md", flush=True)
        return DONE if any("seconds" in line for line in lines) else FAILED
    from .compare.bench import bench

    bench(words.scenes, words.output, size, words.repeats, words.samples, presets, peers, threads=words.threads or 0,
          reference=words.reference)
    return DONE


# ---- parser ----

def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return value


_count.__name__ = "whole number"


def _add_render(commands: Any) -> None:
    techniques = "\n".join(f"  {name:<8} {LABELS[name]}" for name in optional_techniques())
    presets = "\n".join(f"  {identifier.lower():<9} {doc}" for identifier, _, doc in PRESETS)
    parser = commands.add_parser(
        "render", help="render a scene to .exr or .png", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Render a .blend with RTGI: direct light and one bounce. The file itself is never changed.\n"
                    "What no option names is taken from the file.",
        epilog=f"techniques (light of lamps and of the world always runs):\n{techniques}\n\n"
               f"presets:\n{presets}\n\n{_EXAMPLES}")
    parser.add_argument("scene", nargs="?", metavar="SCENE.blend", help="the scene; left out, the file open in Blender")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="OUT",
                        help=".exr: the composite, linear float32; .png: by the scene's view transform; #### is the frame")
    parser.add_argument("--techniques", metavar="LIST", help="rsm, several with commas, or auto: what the scene needs")
    parser.add_argument("--preset", metavar="NAME", help="draft, balanced or quality")
    budget = parser.add_mutually_exclusive_group()
    budget.add_argument("--target-time", metavar="TIME",
                        help="of a whole frame, such as 1.5s: the settings with the least measured error that fit into it")
    budget.add_argument("--target-error", metavar="ERROR",
                        help="of the picture, such as 2%%: the fastest settings that were measured to reach it; both stand "
                             "above a preset")
    parser.add_argument("--set", action="append", default=[], metavar="TECHNIQUE.NAME=VALUE",
                        help="one setting, such as rsm.rays=64; may be repeated; rtgi settings lists them")
    parser.add_argument("--size", metavar="WxH", help="picture size in px, such as 960x540")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", type=int, metavar="N", help="this frame instead of the file's current one")
    which.add_argument("--frames", metavar="A-B", help="all frames from A to B; OUT needs no #### but gets the number")
    parser.add_argument("--skip-existing", action="store_true", help="leave out frames whose picture is there")
    parser.add_argument("--threads", type=_count, metavar="N", help="threads for Cycles and RTGI; all if left out")
    parser.add_argument("--seed", type=int, metavar="N", help="another number gives another pattern of noise")
    parser.add_argument("--passes", type=Path, metavar="PASSES.exr",
                        help="composite, every kind of light and visibility as layers (diffuse light as irradiance, W/m2), "
                             "and what techniques draw of themselves (--set vxgi.pictures=on)")
    parser.add_argument("--report", type=Path, metavar="R.json", help="plan, stage times, memory, versions and warnings")
    parser.set_defaults(run=run_render)


def _add_compare(commands: Any) -> None:
    parser = commands.add_parser(
        "compare", help="error against Cycles one-bounce", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Render a scene with RTGI, with each technique alone, with Cycles one-bounce and with EEVEE. Prints a\n"
                    "table of times and errors; writes DIR/compare.html, a report to read in a browser, the same as\n"
                    "compare.csv and compare.json, and the pictures.",
        epilog="The reference is kept in the cache and used again while the scene, its frame and its linked files stay the\n"
               "same. docs/comparison.md says how to read the numbers.")
    parser.add_argument("scene", nargs="?", metavar="SCENE.blend", help="the scene; left out, the file open in Blender")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--techniques", metavar="LIST", help="rsm, several with commas, or auto")
    parser.add_argument("--preset", metavar="NAME", help="draft, balanced or quality")
    parser.add_argument("--samples", type=_count, default=64, metavar="N",
                        help="samples a pixel of each of the reference's two halves; 64 if left out")
    parser.add_argument("--noise", metavar="LEVEL",
                        help="go on from --samples until the reference's noise is below this, such as 1%%")
    parser.add_argument("--peers", default="1,2,4,8,16,eevee", metavar="LIST",
                        help="samples of Cycles renders to stand beside, without and with its denoiser, eevee, or none; "
                             "1,2,4,8,16,eevee if left out")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="folder that keeps references; the user's own if left out")
    parser.add_argument("--flip", action="store_true", help="measure FLIP too, by its library (pip install flip-evaluator)")
    _add_measured(parser, None)
    parser.set_defaults(run=run_compare)


def _add_bench(commands: Any) -> None:
    from .compare.sweeps import AXES

    axes = "\n".join(f"  {name:<12} {what}" for name, what in AXES.items())
    parser = commands.add_parser(
        "bench", help="speed against error, for every preset and for Cycles; how cost grows with work",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Measure scenes, one after another, each in a process of its own: times of RTGI and of denoised Cycles\n"
                    "one-bounce, and their errors. Writes DIR/results.md and DIR/results.jsonl.\n\n"
                    "With --sweep: change one thing at a time instead, and fit how time grows with it. Writes\n"
                    "DIR/sweeps.md, plots, and DIR/sweeps.jsonl, a line a measurement. Repeat the command to go on where\n"
                    "it was stopped: what is there for the same scene, settings and sources is not measured again.",
        epilog=f"sweeps:\n{axes}\n  {'all':<12} all of these\n\n"
               "The first three have errors (--samples 0 leaves them out). Times mean something on a quiet machine only.\n\n"
               "examples:\n"
               "  rtgi bench room.blend hall.blend -o out/bench\n"
               "  rtgi bench room.blend -o out/bench --sweep techniques,presets,cycles --size 480x270 --samples 64\n"
               "  rtgi bench -o out/bench --sweep lights,triangles")
    parser.add_argument("scenes", nargs="*", metavar="SCENE.blend")
    parser.add_argument("--sweep", metavar="LIST", help="what to change, with commas, or all; the list is below")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--presets", metavar="LIST", help="presets of RTGI, with commas; all if left out")
    parser.add_argument("--peers", default="1,4", metavar="LIST",
                        help="samples of denoised Cycles to stand beside, or none; 1,4 if left out; 16 is Quality's")
    parser.add_argument("--repeats", type=_count, default=3, metavar="N", help="timed frames, after one that is not; 3")
    parser.add_argument("--samples", type=int, default=256, metavar="N",
                        help="samples a pixel of each half of the reference, 0 for times alone; 256")
    _add_measured(parser, "960x540")
    parser.set_defaults(run=run_bench)


def _add_measured(parser: argparse.ArgumentParser, size: str | None) -> None:
    parser.add_argument("--size", default=size, metavar="WxH", help=f"picture size in px; {size or 'that of the file'}")
    parser.add_argument("--threads", type=_count, metavar="N", help="threads for Cycles and RTGI; all if left out")
    parser.add_argument("--reference", type=Path, metavar="NPZ", help="a reference rendered before, or a folder of them")


def parser(prog: str = "rtgi") -> argparse.ArgumentParser:
    """The whole command line."""
    top = _Parser(prog=prog, formatter_class=argparse.RawDescriptionHelpFormatter, epilog=_EXAMPLES,
                  description="Real-time global illumination techniques as a Blender render engine, measured against "
                              "Cycles.")
    top.add_argument("--version", action="version", version=f"rtgi {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    _add_render(commands)
    doctor = commands.add_parser("doctor", help="look for what is missing, and say the mend",
                                 description="Look at Blender, Python, numba, threads and the kernel cache. Exit code 1 if "
                                             "something is wrong, with the mend under its line.")
    doctor.set_defaults(run=run_doctor)
    settings = commands.add_parser("settings", help="every setting that --set takes",
                                   description="Every setting of the techniques, with its default, its range and what "
                                               "it costs and gets.")
    settings.add_argument("techniques", nargs="?", metavar="LIST", help="rsm, several with commas; all if left out")
    settings.set_defaults(run=run_settings)
    warmup = commands.add_parser("warmup", help="compile all kernels now",
                                 description="Compile every kernel and keep it, so that no render waits for it later.")
    warmup.add_argument("--threads", type=_count, metavar="N", help="threads; all if left out")
    warmup.set_defaults(run=run_warmup)
    _add_compare(commands)
    _add_bench(commands)
    return top


def main(argv: Sequence[str] | None = None, prog: str = "rtgi") -> int:
    """Run the command line `argv` (without the program's name) and return its exit code."""
    try:
        words = parser(prog).parse_args(argv)
        return words.run(words)
    except InputError as error:
        _say(f"rtgi: {_one_line(error)}")
        return WRONG_INPUT
    except (RtgiError, Cancelled) as error:
        _say(f"rtgi: {_one_line(error)}")
        return FAILED
    except KeyboardInterrupt:
        _say("rtgi: stopped")
        return FAILED
    except SystemExit as end:                  # --help and --version
        return int(end.code or 0)
