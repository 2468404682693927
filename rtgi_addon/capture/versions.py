"""What differs between Blender 4.5 LTS and 5.2 LTS for capture, in one place."""

from __future__ import annotations

import bpy

LONG_NAMES = bpy.app.version >= (5, 0, 0)
HAS_ROUGHNESS_PASS = bpy.app.version >= (5, 1, 0)

# pass names got long in 5.0; keys are the long names
_SHORT = {"Diffuse Color": "DiffCol", "Diffuse Direct": "DiffDir", "Diffuse Indirect": "DiffInd", "Glossy Color": "GlossCol",
          "Glossy Direct": "GlossDir", "Glossy Indirect": "GlossInd", "Emission": "Emit", "Environment": "Env",
          "Material Index": "IndexMA"}


def pass_name(name: str) -> str:
    """The running Blender's name of the pass that 5.x calls `name`."""
    return name if LONG_NAMES else _SHORT.get(name, name)
