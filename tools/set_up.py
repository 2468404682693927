"""Make the environment in which RTGI runs: `python tools/set_up.py run|test [--install-system-packages]`.

Run by the Python that the environment is for. It creates `.venv-X.Y` in the checkout, installs what `pyproject.toml` lists
(bpy 5.2 for Python 3.13, bpy 4.5 for 3.11), sees to it that bpy loads, and prints the path of the environment's Python as
its only line on stdout. A second call finds the stamp and does nothing. Whatever is missing is one line on stderr that
names the mend, and exit code 1. Standard library only.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
VENV = ROOT / f".venv-{VERSION}"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "rtgi-installed"
BPY_LOADS = "bpy-loads"

# groups of optional dependencies in pyproject.toml that each job needs
JOBS = {"run": ("blender", "plots"), "test": ("blender", "plots", "test")}

# Shared libraries that the bpy wheels of 4.5 and 5.2 link to and do not carry -> Debian and Ubuntu package. The names hold
# on Debian 12 and 13 and Ubuntu 22.04 and 24.04: none of these was renamed for 64-bit time.
PACKAGE_OF_LIBRARY = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libGLX.so.0": "libglx0",
    "libICE.so.6": "libice6",
    "libOpenGL.so.0": "libopengl0",
    "libSM.so.6": "libsm6",
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libXt.so.6": "libxt6",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libgcc_s.so.1": "libgcc-s1",
    "libgomp.so.1": "libgomp1",
    "libstdc++.so.6": "libstdc++6",
    "libuuid.so.1": "libuuid1",
    "libxcb.so.1": "libxcb1",
    "libxkbcommon.so.0": "libxkbcommon0",
}


class SetUpError(Exception):
    """What is missing and the mend, in one line."""


def requirements(job: str, pyproject: str) -> list[str]:
    """The pip requirements of `job`, from the text of pyproject.toml."""
    project = tomllib.loads(pyproject)["project"]
    wanted = list(project["dependencies"])
    for group in JOBS[job]:
        wanted += project["optional-dependencies"][group]
    return wanted


def missing_libraries(text: str) -> list[str]:
    """Names of the shared libraries that `text`, the output of ldd or an ImportError, reports as not found."""
    names = re.findall(r"^\s*(\S+) => not found", text, re.MULTILINE)
    names += re.findall(r"(\S+?\.so[.\d]*): cannot open shared object file", text)
    return sorted(set(names))


def library_message(libraries: list[str]) -> str:
    """One line that names the missing `libraries` and the command that brings them."""
    packages = [PACKAGE_OF_LIBRARY[name] for name in libraries if name in PACKAGE_OF_LIBRARY]
    unknown = [name for name in libraries if name not in PACKAGE_OF_LIBRARY]
    line = f"bpy needs the system librar{'y' if len(libraries) == 1 else 'ies'} {', '.join(libraries)}"
    if packages:
        line += f"; install with: apt-get install {' '.join(packages)}"
    if unknown:
        line += f"; apt-file search {unknown[0]} finds the package of {', '.join(unknown)}"
    return line


def say(text: str) -> None:
    """Progress for the person who waits; stdout is kept for the result."""
    print(text, file=sys.stderr, flush=True)


def apt_install(packages: list[str]) -> None:
    """Install Debian packages without questions; SetUpError where that cannot be done."""
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        raise SetUpError(f"--install-system-packages needs root and apt-get; install by hand: {' '.join(packages)}")
    say(f"Installing system packages: {' '.join(packages)}")
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for words in (["update", "-q"], ["install", "-y", "-q", "--no-install-recommends", *packages]):
        if subprocess.run(["apt-get", *words], env=environment, stdin=subprocess.DEVNULL, stdout=sys.stderr).returncode:
            raise SetUpError(f"apt-get {' '.join(words)} failed; its own message is above")


def create_venv(may_install: bool) -> None:
    """Create the environment's folder with pip in it."""
    probe = [sys.executable, "-c", "import venv, ensurepip"]
    if subprocess.run(probe, stderr=subprocess.DEVNULL).returncode:
        package = f"python{VERSION}-venv"
        if not may_install:
            raise SetUpError(f"Python {VERSION} here lacks the venv module; install with: apt-get install {package}")
        apt_install([package])
    say(f"Creating {VENV.name}")
    if subprocess.run([sys.executable, "-m", "venv", "--clear", str(VENV)], stdout=sys.stderr).returncode:
        raise SetUpError(f"cannot create {VENV}; is there room on the disk, and may this folder be written?")


def install(wanted: list[str]) -> None:
    """Let pip bring `wanted`; ready-built wheels only, so that no compiler is asked for."""
    say(f"Installing Blender as a module (bpy), numba and the rest of pyproject.toml into {VENV.name}: some minutes")
    options = ["--quiet", "--no-input", "--disable-pip-version-check", "--only-binary=:all:"]
    words = [str(PYTHON), "-m", "pip", "install", *options, *wanted]
    if subprocess.run(words, stdin=subprocess.DEVNULL, stdout=sys.stderr).returncode:
        raise SetUpError(f"pip could not install the packages; its own message is above. Mend the network or pip's "
                         f"settings and run this again (64-bit Linux is needed, and the disk needs 3 GB in {ROOT})")


def find_missing_libraries() -> list[str]:
    """What bpy's module links to and this machine lacks, all at once; empty if bpy can be loaded."""
    (module,) = VENV.glob("lib/python*/site-packages/bpy/__init__*.so")
    found = []
    if shutil.which("ldd"):
        found = missing_libraries(subprocess.run(["ldd", str(module)], capture_output=True, text=True).stdout)
    if found:
        return found
    words = [str(PYTHON), "-c", "import bpy, os, sys; sys.stdout.flush(); os._exit(0)"]
    trial = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if trial.returncode == 0:
        return []
    found = missing_libraries(trial.stderr)
    if not found:
        raise SetUpError(f"bpy does not load: {(trial.stderr.strip().splitlines() or ['it gave no reason'])[-1]}")
    return found


def check_bpy(may_install: bool) -> None:
    """See to it that `import bpy` works."""
    libraries = find_missing_libraries()
    if libraries and may_install and all(name in PACKAGE_OF_LIBRARY for name in libraries):
        apt_install([PACKAGE_OF_LIBRARY[name] for name in libraries])
        libraries = find_missing_libraries()
    if libraries:
        raise SetUpError(library_message(libraries) + " (or, as root, add --install-system-packages)")


def set_up(job: str, may_install: bool) -> None:
    """Bring the environment to what `job` needs; the stamp remembers each requirement and that bpy was seen to load."""
    wanted = requirements(job, (ROOT / "pyproject.toml").read_text())
    # the environment's place is part of a stamp line: a checkout that was moved needs its environment anew
    needed = {hashlib.sha256(f"{VENV} {line}".encode()).hexdigest()[:16] for line in wanted}
    done = set(STAMP.read_text().split()) if STAMP.exists() and PYTHON.exists() else set()
    if not needed <= done:
        if not done:
            create_venv(may_install)
        install(wanted)
        done = (done | needed) - {BPY_LOADS}
        STAMP.write_text("\n".join(sorted(done)) + "\n")
    if BPY_LOADS not in done:
        check_bpy(may_install)
        STAMP.write_text("\n".join(sorted(done | {BPY_LOADS})) + "\n")


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("job", choices=JOBS)
    parser.add_argument("--install-system-packages", action="store_true",
                        help="as root on Debian or Ubuntu: let apt-get install what is missing")
    arguments = parser.parse_args()
    if VERSION not in ("3.11", "3.13"):
        say(f"RTGI needs Python 3.13 or 3.11, because the bpy module exists for no other; this is {VERSION}")
        return 1
    try:
        set_up(arguments.job, arguments.install_system_packages)
    except SetUpError as error:
        say(str(error))
        return 1
    print(PYTHON)
    return 0


if __name__ == "__main__":
    sys.exit(main())
