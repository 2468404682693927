"""EEVEE as a peer: rendered in a process of its own, as Blender may end where there is no GPU or OpenGL in software."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .child import child_command, child_environment, end

_SECONDS = 540              # OpenGL in software takes a minute or more a frame; beyond this it is not worth waiting
_PACKAGE = __name__.rpartition(".")[0]


def child_main(request: str) -> None:
    """Entry of the process: render what the JSON `request` says, write picture, seconds and device, end at once."""
    words = json.loads(request)
    status = 1
    try:
        importlib.import_module(_PACKAGE.rpartition(".")[0]).register()
        blender = importlib.import_module(_PACKAGE + ".reference")
        scene = blender.open_scene(Path(words["path"]))
        scene.frame_set(words["frame"])
        with blender.on_threads(scene, words["threads"]):
            peer, device = blender.render_eevee(scene, tuple(words["size"]))
        np.savez(words["out"], combined=peer.combined, seconds=peer.seconds[0], device=device)
        status = 0
    except Exception as error:  # noqa: BLE001  whatever it is, the parent leaves EEVEE out and says this line
        print(f"{type(error).__name__}: {error}".splitlines()[0], file=sys.stderr)
    end(status)


def render_eevee(blend_path: Path, frame: int, size: tuple[int, int], threads: int, binary: str) -> dict[str, Any] | str:
    """{"combined": (H, W, 4) float32, "seconds", "device"} of a saved scene's frame, or in one line why there is none.

    `binary` is Blender's path, "" where bpy is a module of this Python.
    """
    with tempfile.TemporaryDirectory(prefix="rtgi_eevee_") as folder:
        out = Path(folder) / "eevee.npz"
        request = json.dumps({"path": str(blend_path.resolve()), "frame": frame, "size": list(size), "threads": threads,
                              "out": str(out)})
        try:
            done = subprocess.run(child_command(__name__, request, binary), env=child_environment(), capture_output=True,
                                  text=True, errors="replace", timeout=_SECONDS, check=False)
        except subprocess.TimeoutExpired:
            return f"EEVEE is left out: it was not done after {_SECONDS} s (OpenGL in software?)"
        if done.returncode or not out.is_file():
            why = done.stderr.strip().splitlines()
            return (f"EEVEE is left out: it did not render here (code {done.returncode}), for want of a GPU or of OpenGL in "
                    "software" + (f"; its last words: {why[-1]}" if why else ""))
        with np.load(out) as data:
            return {"combined": data["combined"], "seconds": float(data["seconds"]), "device": str(data["device"])}
