"""`scene.rtgi`: the settings as Blender properties, one group a technique, made from the parameter dataclasses.

Nothing is written twice: names, ranges, units, descriptions and defaults come from `core.techniques`. Loads no kernel.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import bpy

from ..core.params import Params
from ..core.settings import PRESETS, Settings
from ..core.techniques import ALWAYS_ON, LABELS, PRESET_PARAMS, TECHNIQUE_PARAMS, optional_techniques
from .preferences import preferred_threads

_UNIT_SUFFIXES = ("_px", "_m", "_rad")
_SUBTYPES = {"px": "PIXEL", "m": "DISTANCE", "rad": "ANGLE"}


def label_of(field_name: str) -> str:
    """The panel's words for a field: its name without the unit, capitalised."""
    for suffix in _UNIT_SUFFIXES:
        field_name = field_name.removesuffix(suffix)
    return field_name.replace("_", " ").title()


def _property(field: dataclasses.Field) -> Any:
    """The Blender property of a parameter; its type follows the default's."""
    meta, default = field.metadata, field.default
    common = {"name": label_of(field.name), "description": meta["doc"], "default": default}
    if meta["choices"]:
        items = [(identifier, label, doc, number) for number, (identifier, label, doc) in enumerate(meta["choices"])]
        return bpy.props.EnumProperty(items=items, **common)
    if isinstance(default, bool):
        return bpy.props.BoolProperty(**common)
    limits = {blender: meta[ours] for blender, ours in (("min", "low"), ("max", "high"), ("soft_max", "soft_high"))
              if meta[ours] is not None}
    if meta["unit"]:
        common["subtype"] = _SUBTYPES[meta["unit"]]
    make = bpy.props.IntProperty if isinstance(default, int) else bpy.props.FloatProperty
    return make(**common, **limits)


def _technique_group(name: str, params: type[Params]) -> type:
    annotations = {field.name: _property(field) for field in dataclasses.fields(params)}
    return type(f"RTGI_{name}_settings", (bpy.types.PropertyGroup,),
                {"__annotations__": annotations, "__doc__": params.__doc__, "__module__": __name__})


TECHNIQUE_GROUPS: dict[str, type] = {name: _technique_group(name, params) for name, params in TECHNIQUE_PARAMS.items()}


def apply_preset(group: bpy.types.PropertyGroup) -> None:
    """Write the values that the group's preset decides; every other parameter stays."""
    for name, changes in PRESET_PARAMS[group.preset].items():
        for field, value in changes.items():
            setattr(getattr(group, name), field, value)


def differs_from_preset(group: bpy.types.PropertyGroup) -> bool:
    """Whether a value that the preset decides was changed by hand since."""
    return any(getattr(getattr(group, name), field) != value
               for name, changes in PRESET_PARAMS[group.preset].items() for field, value in changes.items())


def _scene_group() -> type:
    annotations = {
        "preset": bpy.props.EnumProperty(
            name="Preset", description="Speed against error; sets gather points, rays and clusters",
            items=[(identifier, label, doc, number) for number, (identifier, label, doc) in enumerate(PRESETS)],
            default="BALANCED", update=lambda group, _context: apply_preset(group)),
        "use_auto": bpy.props.BoolProperty(
            name="Automatic", default=True,
            description="Look at the frame and leave out what it does not need; the check marks say what may be used"),
        "budget": bpy.props.EnumProperty(
            name="Budget", default="NONE",
            description="What decides gather points, rays and clusters",
            items=[("NONE", "Preset", "The preset, and what was changed by hand"),
                   ("TIME", "Target Time", "The least error that was measured for the time that is left after capture"),
                   ("ERROR", "Target Error", "The least time that was measured for an error")]),
        "target_time_s": bpy.props.FloatProperty(
            name="Time", default=1.0, min=0.01, max=3600.0, soft_max=30.0, unit="TIME_ABSOLUTE",
            description="Of a whole frame, capture with it. The forecast comes from the calibration, and what each frame "
                        "takes corrects it; compiling is not counted"),
        "target_error_percent": bpy.props.FloatProperty(
            name="Error", default=3.0, min=0.01, max=99.0, soft_min=0.5, soft_max=20.0, subtype="PERCENTAGE",
            description="Relative error of the picture in means of 8x8 pixels, as typical of the scenes that were measured; "
                        "Compare with Cycles tells that of this one"),
        "seed": bpy.props.IntProperty(
            name="Seed", default=0, min=0, description="Another seed gives another pattern of noise"),
    }
    for name in optional_techniques():
        annotations[f"use_{name}"] = bpy.props.BoolProperty(
            name=f"Use {LABELS[name]}", default=True, description=TECHNIQUE_PARAMS[name].__doc__.strip().rstrip("."))
    for name, group in TECHNIQUE_GROUPS.items():
        annotations[name] = bpy.props.PointerProperty(type=group, name=LABELS[name])
    return type("RTGI_scene_settings", (bpy.types.PropertyGroup,),
                {"__annotations__": annotations, "__doc__": "Settings of the RTGI engine.", "__module__": __name__})


SCENE_GROUP = _scene_group()
CLASSES = (*TECHNIQUE_GROUPS.values(), SCENE_GROUP)


def is_enabled(group: bpy.types.PropertyGroup, technique: str) -> bool:
    """Whether a technique may run."""
    return technique in ALWAYS_ON or getattr(group, f"use_{technique}")


def _value(group: bpy.types.PropertyGroup, field: dataclasses.Field) -> Any:
    """A parameter's value; Blender keeps floats in single precision, so 0.3 would come back as 0.30000001."""
    value = getattr(group, field.name)
    return _rounded(value) if isinstance(value, float) else value


def _rounded(value: float) -> float:
    return float(f"{value:.7g}")


def settings_from_scene(scene: bpy.types.Scene) -> Settings:
    """Settings of a scene or of its evaluated copy.

    A fixed number of threads in the scene's Performance panel stands above the one in the add-on's preferences.
    """
    group = scene.rtgi
    params = {name: kind(**{field.name: _value(getattr(group, name), field) for field in dataclasses.fields(kind)})
              for name, kind in TECHNIQUE_PARAMS.items()}
    threads = scene.render.threads if scene.render.threads_mode == "FIXED" else preferred_threads()
    return Settings(preset=group.preset, use_auto=group.use_auto,
                    enabled={name: is_enabled(group, name) for name in TECHNIQUE_PARAMS}, params=params, threads=threads,
                    seed=group.seed,
                    target_time_s=_rounded(group.target_time_s) if group.budget == "TIME" else 0.0,
                    target_error=_rounded(group.target_error_percent / 100) if group.budget == "ERROR" else 0.0)


def settings_to_scene(settings: Settings, scene: bpy.types.Scene) -> None:
    """Write settings to a scene; InputError first if one is out of range. Threads go to the scene's Performance settings."""
    settings.validate()
    group = scene.rtgi
    group.preset, group.use_auto, group.seed = settings.preset, settings.use_auto, settings.seed
    group.budget = "TIME" if settings.target_time_s else "ERROR" if settings.target_error else "NONE"
    if settings.target_time_s:
        group.target_time_s = settings.target_time_s
    if settings.target_error:
        group.target_error_percent = 100 * settings.target_error
    for name in optional_techniques():
        setattr(group, f"use_{name}", settings.enabled.get(name, False))
    for name, params in settings.params.items():
        for field in dataclasses.fields(params):
            setattr(getattr(group, name), field.name, getattr(params, field.name))
    if settings.threads > 0:
        scene.render.threads_mode, scene.render.threads = "FIXED", settings.threads
