"""What every test stands on: private Blender folders, a kernel cache that survives, an empty scene, seeded numbers."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# both are read when bpy and the first kernel are imported, so they come before anything else
_RESOURCES = tempfile.mkdtemp(prefix="rtgi_tests_")
os.environ["BLENDER_USER_RESOURCES"] = _RESOURCES
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".cache" / "numba"))
sys.path.insert(0, str(ROOT))

import hypothesis  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402

hypothesis.settings.register_profile("rtgi", deadline=None, derandomize=True, max_examples=50, database=None)
hypothesis.settings.load_profile("rtgi")

_EXIT_STATUS = pytest.StashKey[int]()


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20240607)


@pytest.fixture
def one_thread(monkeypatch) -> None:
    """Kernels on one thread: for thousands of them on a few pixels each, where waking a second one costs more."""
    from rtgi_addon.kernels import jit

    monkeypatch.setattr(jit, "most_threads", lambda: 1)


@pytest.fixture(scope="session")
def bpy_session():
    """Blender as a module, with RTGI registered once for all tests."""
    import bpy

    import rtgi_addon

    rtgi_addon.register()
    return bpy


@pytest.fixture
def empty_scene(bpy_session):
    """An empty factory scene; add-ons stay registered."""
    bpy_session.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return bpy_session.context.scene


@pytest.fixture
def small_scene(bpy_session, empty_scene):
    """A corner of two planes, a cube, a spot and a camera, to be rendered with RTGI at 64x36."""
    bpy = bpy_session

    def add(name, data, location=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)):
        thing = bpy.data.objects.new(name, data)
        thing.location, thing.rotation_euler = location, rotation
        empty_scene.collection.objects.link(thing)
        return thing

    def mesh(name, corners, faces, colour):
        data = bpy.data.meshes.new(name)
        data.from_pydata(corners, [], faces)
        material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value = (*colour, 1.0)
        data.materials.append(material)
        return data

    quad = [(0, 1, 2, 3)]
    add("Floor", mesh("Floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], quad, (0.8, 0.8, 0.8)))
    add("Wall", mesh("Wall", [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)], quad, (0.8, 0.1, 0.1)))
    cube = [(x, y, z) for x in (-0.4, 0.4) for y in (-0.4, 0.4) for z in (0.0, 0.8)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    add("Cube", mesh("Cube", cube, sides, (0.2, 0.5, 0.8)))
    lamp = bpy.data.lights.new("Spot", "SPOT")
    lamp.energy, lamp.spot_size, lamp.shadow_soft_size = 300.0, 1.6, 0.0
    add("Spot", lamp, (0.0, -1.0, 4.0), (0.3, 0.0, 0.0))
    empty_scene.camera = add("Camera", bpy.data.cameras.new("Camera"), (0.0, -6.0, 2.0), (1.35, 0.0, 0.0))
    render = empty_scene.render
    render.engine, render.resolution_x, render.resolution_y, render.resolution_percentage = "RTGI", 64, 36, 100
    bpy.context.view_layer.update()
    return empty_scene


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[_EXIT_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """End without Python's clean-up: the bpy module of 4.5 hangs there after renders by an engine of its own."""
    shutil.rmtree(_RESOURCES, ignore_errors=True)
    if "bpy" not in sys.modules or _EXIT_STATUS not in config.stash:
        return
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(config.stash[_EXIT_STATUS])
