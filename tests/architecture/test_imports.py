"""The import table of docs/architecture.md holds, and its checker catches what breaks it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tools import architecture
from tools.architecture import PACKAGE, ROOT, Module, absolute_self_imports, wrong_imports

MODULES = architecture.package_modules()
NAMES = frozenset(f"{PACKAGE}.{m.name}".rstrip(".") for m in MODULES)


@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.name or PACKAGE)
def test_module_imports_only_what_the_table_allows(module):
    assert wrong_imports(module, NAMES) == []


@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.name or PACKAGE)
def test_module_imports_its_own_package_relatively(module):
    assert absolute_self_imports(module) == []


@pytest.mark.parametrize(("name", "line", "culprit"), [
    ("passes.rsm", "import bpy", "bpy"),
    ("passes.rsm", "import numba", "numba"),
    ("passes.rsm", "def f():\n    from mathutils import Vector", "mathutils"),
    ("passes.rsm", "import importlib\nimportlib.import_module('bpy')", "bpy"),
    ("kernels.bvh", "from ..core.frame import Frame", "rtgi_addon.core.frame"),
    ("core.frame", "import numba", "numba"),
    ("core.frame", "from ..kernels import vec3", "rtgi_addon.kernels.vec3"),
    ("capture.views", "from ..passes import TECHNIQUES", "rtgi_addon.passes"),
    ("capture.views", "from .. import pipeline", "rtgi_addon.pipeline"),
    ("compare.metrics", "import bpy", "bpy"),
    ("compare.page", "def f():\n    import matplotlib.figure", "matplotlib.figure"),
    ("pipeline", "from .capture import lights", "rtgi_addon.capture.lights"),
    ("errors", "import numpy", "numpy"),
    ("novelty", "import numpy", "numpy"),
])
def test_checker_catches_a_forbidden_import(name, line, culprit):
    complaints = wrong_imports(Module(name, line), NAMES)
    assert len(complaints) == 1 and f"imports {culprit}," in complaints[0]


def test_checker_allows_the_standard_library_and_the_own_layer():
    text = "import math\nfrom .base import Context\nfrom ..core import frame"
    assert wrong_imports(Module("passes.rsm", text), NAMES) == []


def test_checker_catches_an_absolute_import_of_the_package():
    assert len(absolute_self_imports(Module("cli", "from rtgi_addon.core import frame\nimport rtgi_addon"))) == 2


def test_root_shim_does_nothing_at_import():
    assert architecture.work_at_import((ROOT / "__init__.py").read_text()) == []


def test_checker_catches_work_at_import():
    assert len(architecture.work_at_import('"""Door."""\nimport bpy\nX = f()\ndef register():\n    import os\n')) == 2


def test_importing_the_library_loads_neither_blender_nor_its_extras():
    places = ("core", "kernels", "passes", "pipeline", "planner", "composite", "frameio", "light_views")
    names = [m.name for m in MODULES if m.name.partition(".")[0] in places]
    code = (f"import importlib, sys\nfor n in {names!r}: importlib.import_module('{PACKAGE}.' + n)\n"
            f"print(sorted({set(architecture.BLENDER)!r} & set(sys.modules)))")
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stdout.strip()) == (0, "[]"), run.stderr


def test_importing_the_plots_loads_no_matplotlib():
    # Blender does not bring it, and where it is installed the first import looks through the system's fonts
    code = f"import sys, {PACKAGE}.compare.run, {PACKAGE}.compare.sweep_page\nprint('matplotlib' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stdout.strip()) == (0, "False"), run.stderr


def test_importing_the_package_itself_loads_no_numba():
    # Blender imports every enabled add-on at its start; numba costs half a second there
    code = f"import sys, {PACKAGE}, {PACKAGE}.core.techniques, {PACKAGE}.cli\nprint('numba' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout.strip()) == (0, "False"), run.stderr
