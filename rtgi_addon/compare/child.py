"""A fresh Blender for one job: the command that calls a module's `child_main` with a request, and its environment."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def child_command(module: str, request: str, binary: str) -> list[str]:
    """Start `module`.child_main(request): by Blender itself at `binary`, else ("") by this Python with the bpy module."""
    code = f"import importlib; importlib.import_module({module!r}).child_main({request!r})"
    return [binary, "-b", "--python-exit-code", "1", "--python-expr", code] if binary else [sys.executable, "-c", code]


def child_environment() -> dict[str, str]:
    """This process's, with the folder of the package in front of Python's path."""
    root = str(Path(__file__).resolve().parents[len(__name__.split(".")) - 1])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}


def end(status: int) -> None:
    """End this process without Blender's clean-up: bpy 4.5 is known to hang there after renders by an engine of its own."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
