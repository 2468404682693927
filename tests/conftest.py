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
