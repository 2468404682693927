"""Blender once more, in the background, running the words of `rtgi`: what takes minutes does not stop the window."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import bpy

from ..core.cache_root import cache_root

_PACKAGE = __package__.rpartition(".")[0]
POLL_S = 0.25               # between two looks at a running child: often enough for its progress to look alive


def _code(words: Sequence[str]) -> str:
    """Python that runs `rtgi WORDS` with this process's package and libraries, and ends with its exit code."""
    return ("import os, sys\n"
            f"sys.path += [p for p in {[p for p in sys.path if p]!r} if p not in sys.path]\n"
            "from importlib import import_module\n"
            f"import_module({_PACKAGE!r}).register()\n"
            f"status = import_module({_PACKAGE + '.cli'!r}).main({list(words)!r})\n"
            "sys.stdout.flush(); sys.stderr.flush()\n"
            "os._exit(status)")


def command(words: Sequence[str]) -> list[str]:
    """How to start `rtgi WORDS` beside this process: Blender itself where this is Blender, else Python with its bpy.

    A file whose scripts this Blender runs may run them there too, and no other: drivers are part of the picture.
    """
    code, binary = _code(words), bpy.app.binary_path
    if not binary:
        return [sys.executable, "-c", code]
    trust = "--disable-autoexec" if bpy.app.autoexec_fail else "--enable-autoexec"
    return [binary, "--background", trust, "--python-exit-code", "1", "--python-expr", code]


class Child:
    """A running `rtgi WORDS`; what it says goes to the file `log`."""

    def __init__(self, words: Sequence[str], log: Path):
        self._log, self._start = log, time.monotonic()
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("wb") as out:
            self._process = subprocess.Popen(
                command(words), stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                env={**os.environ, "NUMBA_CACHE_DIR": str(cache_root())},
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0))

    @property
    def seconds(self) -> float:
        """Since its start."""
        return time.monotonic() - self._start

    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def lines(self) -> list[str]:
        """All that it has said so far."""
        return self._log.read_text(encoding="utf-8", errors="replace").splitlines()

    def wait(self) -> int:
        """Wait for its end; the exit code."""
        return self._process.wait()

    def stop(self) -> None:
        """End it, if it still runs."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
