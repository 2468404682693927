"""`rtgi doctor`: what RTGI found on this machine, and for everything that is wrong the mend, in lines."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from . import __version__
from .core.cache_root import cache_root

# libraries that the bpy module loads from the system, and the Debian and Ubuntu packages that bring them
SYSTEM_PACKAGES = {
    "libEGL.so.1": "libegl1", "libGL.so.1": "libgl1", "libICE.so.6": "libice6", "libSM.so.6": "libsm6",
    "libX11.so.6": "libx11-6", "libXext.so.6": "libxext6", "libXfixes.so.3": "libxfixes3", "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1", "libXt.so.6": "libxt6", "libXxf86vm.so.1": "libxxf86vm1", "libgomp.so.1": "libgomp1",
    "libxkbcommon.so.0": "libxkbcommon0", "libwayland-client.so.0": "libwayland-client0",
}
PYTHONS = {(3, 11): "4.5", (3, 13): "5.2"}
OLDEST_BLENDER = (4, 5, 0)


@dataclass(frozen=True)
class Finding:
    """A line of the doctor; `mend` is what to do about a problem, empty where all is well."""

    what: str
    value: str
    mend: str = ""

    def __str__(self) -> str:
        line = f"{self.what:<18} {self.value}"
        return f"{line}\n{'':<18} -> {self.mend}" if self.mend else line


def missing_libraries(text: str) -> list[str]:
    """Names of shared libraries that an error message or the output of `ldd` calls missing, each once."""
    names = re.findall(r"(\S+\.so[.\d]*)(?: => not found|: cannot open shared object)", text)
    return list(dict.fromkeys(names))


def mend_libraries(names: list[str]) -> str:
    """The command that installs the missing libraries on Debian and Ubuntu, and those it does not know by name."""
    packages = sorted({SYSTEM_PACKAGES[n] for n in names if n in SYSTEM_PACKAGES})
    unknown = [n for n in names if n not in SYSTEM_PACKAGES]
    words = [f"sudo apt-get install {' '.join(packages)}"] if packages else []
    if unknown:
        words.append(f"install the packages that hold {', '.join(unknown)}")
    return "; ".join(words)


def _linked_but_missing(module: str) -> list[str]:
    """Libraries that the compiled module `module` asks for and the system lacks; [] where `ldd` cannot tell."""
    spec = importlib.util.find_spec(module)
    if spec is None or not spec.origin or not sys.platform.startswith("linux"):
        return []
    try:
        listing = subprocess.run(["ldd", spec.origin], capture_output=True, text=True, timeout=60, check=False).stdout
    except (OSError, subprocess.TimeoutExpired):
        return []
    return missing_libraries(listing)


def bpy_problem(error: ImportError) -> tuple[str, str]:
    """What is wrong with the module bpy that failed to load with `error`, and the mend."""
    if isinstance(error, ModuleNotFoundError) and error.name == "bpy":
        version = PYTHONS.get(sys.version_info[:2])
        if version is None:
            return "not installed", "use Python 3.11 (Blender 4.5 LTS) or 3.13 (Blender 5.2 LTS)"
        return "not installed", f"run inside Blender, or pip install bpy=={version}.* into this Python"
    names = list(dict.fromkeys(missing_libraries(str(error)) + _linked_but_missing("bpy")))
    return f"does not load: {error}", mend_libraries(names) or "reinstall the bpy package"


def _python() -> Finding:
    version = platform.python_version()
    return Finding("Python", f"{version} ({sys.executable})",
                   "" if sys.version_info >= (3, 11) else "RTGI needs Python 3.11 or later")


def _blender() -> Iterator[Finding]:
    try:
        import bpy
    except ImportError as error:
        yield Finding("Blender", *bpy_problem(error))
        return
    yield Finding("Blender", f"{bpy.app.version_string}{' (background)' if bpy.app.background else ''}",
                  "" if bpy.app.version >= OLDEST_BLENDER else "RTGI needs Blender 4.5 LTS or later")
    try:
        importlib.import_module("cycles")
    except ImportError:
        yield Finding("Cycles", "not enabled", "enable the add-on Cycles Render Engine in Edit > Preferences > Add-ons")
    else:
        yield Finding("Cycles", "enabled")


def _package(name: str, mend: str) -> Finding:
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        return Finding(name, f"does not load: {error}", mend)
    return Finding(name, module.__version__)


def _plots() -> Finding:
    """matplotlib draws plots where it is there, and nothing else needs it: without it nothing is wrong."""
    from .compare import plot

    found = "drawn by matplotlib" if plot.available() else "none, since there is no matplotlib; reports have all else"
    return Finding("plots", found)


def _threads() -> Iterator[Finding]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding("processors", f"{os.cpu_count()}, {usable} for this process")
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        yield Finding("NUMBA_DISABLE_JIT", "set", "unset it: without compiled kernels a frame takes hours")
        return
    from .kernels.jit import most_threads

    yield Finding("kernels", f"up to {most_threads()} threads")
    from .kernels.embree import embree_version

    yield Finding("rays", f"Embree {embree_version()}, Blender's own" if embree_version() else "RTGI's own tree")


def _size_mb(folder: Path) -> float:
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 1e6


def _cache() -> Finding:
    root = cache_root()
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            pass
    except OSError as error:
        return Finding("kernel cache", f"{root} cannot be written: {error.strerror}",
                       "set NUMBA_CACHE_DIR to a folder of yours; until then every start compiles again (about 20 s)")
    return Finding("kernel cache", f"{root}, {_size_mb(root):.1f} MB")


def examine() -> Iterator[Finding]:
    """Everything the doctor looks at, in the order of its lines."""
    yield Finding("RTGI", __version__)
    yield Finding("system", platform.platform())
    yield _python()
    yield from _blender()
    yield _package("numpy", "pip install numpy")
    wheel = "pip install numba; in Blender reinstall the extension, another one may have replaced its wheels"
    llvmlite, numba = _package("llvmlite", wheel), _package("numba", wheel)
    yield llvmlite
    yield numba
    if not numba.mend:
        yield from _threads()
    yield _plots()
    yield _cache()
