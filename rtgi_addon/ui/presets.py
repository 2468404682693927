"""The user's own presets, by Blender's preset system: Python files in the user's presets/rtgi/render."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..core.techniques import TECHNIQUE_PARAMS, optional_techniques

FOLDER = "rtgi/render"


class RTGI_PT_presets(PresetPanel, bpy.types.Panel):
    """Presets that the user saved."""

    bl_label = "RTGI Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "rtgi.preset_add"
    COMPAT_ENGINES = {"RTGI"}


class RTGI_OT_preset_add(AddPresetBase, bpy.types.Operator):
    """Save these settings as a preset, or remove the chosen one"""

    bl_idname = "rtgi.preset_add"
    bl_label = "Add RTGI Preset"
    preset_menu = "RTGI_PT_presets"
    preset_subdir = FOLDER
    preset_defines = ["rtgi = bpy.context.scene.rtgi"]
    # the preset first: it sets values that those after it then overwrite. A new technique's group comes by itself
    preset_values = ["rtgi.preset", "rtgi.use_auto", "rtgi.budget", "rtgi.target_time_s",
                     "rtgi.target_error_percent", *(f"rtgi.use_{name}" for name in optional_techniques()),
                     *(f"rtgi.{name}" for name in TECHNIQUE_PARAMS)]


CLASSES = (RTGI_PT_presets, RTGI_OT_preset_add)
