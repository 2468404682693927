"""Build the sample scenes as .blend files.

With the bpy wheel, from the repository's root: `python -m sample_scenes.build cornell_box -o DIR`.
With Blender itself: `blender -b --python sample_scenes/build.py -- cornell_box -o DIR`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

import bpy

HERE = Path(__file__).resolve().parent
if str(HERE.parent) not in sys.path:  # Blender runs this file as a script, outside its package
    sys.path.insert(0, str(HERE.parent))


def build_scene(name: str) -> bpy.types.Scene:
    """Replace whatever Blender holds by one sample scene and return it. A name that is not in `SCENES` raises KeyError."""
    kit = importlib.import_module("sample_scenes.kit")
    module = _modules([name])[name]
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    scene.name = name
    kit.set_defaults(scene)
    module.build(scene)
    bpy.context.view_layer.update()
    return scene


def save_scene(name: str, directory: Path) -> Path:
    """Build one scene into `directory` (made if it is missing) and return the path of its .blend file."""
    build_scene(name)
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{name}.blend"
    bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside a file that a script can build again
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True)
    return path


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 2 when a name is unknown."""
    names = importlib.import_module("sample_scenes").SCENES
    parser = argparse.ArgumentParser(prog="sample_scenes.build", description="Build the sample scenes as .blend files.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenes to build (default: all)")
    parser.add_argument(
        "-o", "--output", type=Path, default=HERE, metavar="DIR", help="folder for the files (default: %(default)s)"
    )
    parser.add_argument("--list", action="store_true", help="name the scenes, each with what it shows")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in names]
    if unknown:
        parser.error(f"no scene is called {unknown[0]!r}; known are {', '.join(names)}")
    if options.list:
        for name, module in _modules(names).items():
            print(f"{name:18} {module.__doc__.splitlines()[0]}")
        return 0
    for name in options.names or names:
        print(save_scene(name, options.output), flush=True)
    return 0


def _modules(names) -> dict:
    known = importlib.import_module("sample_scenes").SCENES
    for name in names:
        if name not in known:
            raise KeyError(f"no scene is called {name!r}; known are {', '.join(known)}")
    return {name: importlib.import_module(f"sample_scenes.{name}") for name in names}


if __name__ == "__main__":
    inside_blender = "--" in sys.argv
    sys.exit(main(sys.argv[sys.argv.index("--") + 1 :] if inside_blender else None))
