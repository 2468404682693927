"""`python -m rtgi_addon`, and the command `rtgi` where the package is installed."""

from __future__ import annotations

import os
import shutil
import sys

from .cli import main


def run() -> None:
    """Run the command line and end the process with its exit code.

    The bpy module of Blender 4.5 hangs in Python's clean-up after renders by an engine of its own, so there the process
    ends without it, and Blender's folder for temporary files is removed here.
    """
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    bpy = sys.modules.get("bpy")
    if bpy is not None and bpy.app.version < (5, 0, 0):
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    run()
