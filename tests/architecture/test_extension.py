"""The extension: its manifest passes Blender's own validator, and its zip holds the add-on and nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

import rtgi_addon

ROOT = Path(__file__).resolve().parent.parent.parent
# installs the zip into an empty user folder, renders, switches it off and on again, renders, removes it; prints what it saw.
# Only direct light, whose kernels compile fastest: the cache is the extension's own and empty
LIFE = """
import sys, bpy
from pathlib import Path

def look():
    settings = hasattr(bpy.types.Scene, "rtgi")
    names = [getattr(c, "bl_idname", "") for c in bpy.types.RenderEngine.__subclasses__() if c.is_registered]
    panels = [n for n in dir(bpy.types) if n.startswith("RTGI_PT")]
    return f"SEEN {settings} {names.count('RTGI')} {bool(panels)}"

def render():
    import numpy as np

    path = Path(sys.argv[2]) / "picture.exr"
    scene = bpy.context.scene
    scene.render.engine, scene.render.filepath = "RTGI", str(path)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 16, 9, 100
    if bpy.app.version >= (5, 0, 0):
        scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR"
    for name in [p.identifier for p in scene.rtgi.bl_rna.properties if p.identifier.startswith("use_")]:
        setattr(scene.rtgi, name, name == "use_auto")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    mean = float(np.mean(image.pixels[:]))
    bpy.data.images.remove(image)
    path.unlink()
    return f"PICTURE {mean > 0.01}"

bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
bpy.ops.extensions.package_install_files(repo="user_default", filepath=sys.argv[1], enable_on_install=True)
print(look())
print("NUMBA", "numba" in sys.modules)
print(render())
name = "bl_ext.user_default.rtgi"
bpy.ops.preferences.addon_disable(module=name)
print(look())
bpy.ops.preferences.addon_enable(module=name)
print(look())
print(render())
print("KERNELS", *{str(p.relative_to(sys.argv[2]).parent.parent) for p in Path(sys.argv[2]).rglob("*.nbi")})
bpy.ops.extensions.package_uninstall(repo_index=[r.module for r in bpy.context.preferences.extensions.repos].index(
    "user_default"), pkg_id="rtgi")
print(look())
sys.stdout.flush()
import os
os._exit(0)
"""

ALLOWED_AT_ROOT = {"__init__.py", "blender_manifest.toml", "CHANGELOG.md", "LICENSE", "README.md"}


def extension_tool(*words: str) -> subprocess.CompletedProcess:
    """Blender's extension command line, which lies in the bpy wheel as plain Python."""
    (tool,) = Path(find_spec("bpy").origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    return subprocess.run([sys.executable, str(tool), *words], capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The zip as `blender --command extension build` makes it from the checkout."""
    path = tmp_path_factory.mktemp("extension") / "rtgi.zip"
    run = extension_tool("build", "--source-dir", str(ROOT), "--output-filepath", str(path))
    assert run.returncode == 0, run.stdout + run.stderr
    return zipfile.ZipFile(path)


def manifest() -> dict:
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text())


def test_validator_accepts_the_checkout():
    run = extension_tool("validate", str(ROOT))
    assert run.returncode == 0, run.stdout + run.stderr


def test_validator_accepts_the_zip(archive):
    run = extension_tool("validate", archive.filename)
    assert run.returncode == 0, run.stdout + run.stderr


def test_validator_is_not_silent_about_a_broken_manifest(tmp_path):
    text = (ROOT / "blender_manifest.toml").read_text().replace('tagline = "', 'tagline = "Ends with a full stop. ', 1)
    (tmp_path / "blender_manifest.toml").write_text(text.replace("against Cycles", "against Cycles."))
    (tmp_path / "__init__.py").write_text("")
    assert extension_tool("validate", str(tmp_path)).returncode != 0


def test_zip_holds_every_module_of_the_add_on(archive):
    wanted = {str(p.relative_to(ROOT)) for p in (ROOT / "rtgi_addon").rglob("*.py")}
    assert wanted - set(archive.namelist()) == set()


def test_zip_holds_nothing_but_the_add_on(archive):
    strangers = {n for n in archive.namelist()
                 if not n.endswith("/") and n not in ALLOWED_AT_ROOT and not n.startswith("rtgi_addon/")}
    assert strangers == set()


def test_zip_holds_no_leftovers_of_python(archive):
    assert [n for n in archive.namelist() if "__pycache__" in n or n.endswith((".pyc", ".nbi", ".nbc"))] == []


def test_zip_lives_through_install_disable_enable_and_removal(archive, tmp_path):
    # without the tests' own kernel cache: the extension must write into its own folder
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"BLENDER_USER_RESOURCES": str(tmp_path), "HOME": str(tmp_path / "home")}
    run = subprocess.run([sys.executable, "-c", LIFE, archive.filename, str(tmp_path)], env=environment,
                         capture_output=True, text=True, cwd=tmp_path, timeout=600)
    lines = run.stdout.splitlines()
    on, off = "SEEN True 1 True", "SEEN False 0 False"
    assert [line for line in lines if line.startswith("SEEN")] == [on, off, on, off], run.stdout + run.stderr
    assert "NUMBA False" in lines            # switching the add-on on costs nobody's start half a second
    assert [line for line in lines if line.startswith("PICTURE")] == ["PICTURE True"] * 2, run.stdout + run.stderr
    (kernels,) = [line.split()[1:] for line in lines if line.startswith("KERNELS")]
    assert kernels and all(folder.startswith("extensions/.user/user_default/rtgi/") for folder in kernels), kernels
    assert list(tmp_path.rglob("*rtgi*")) == [] and list(tmp_path.rglob("*.nb?")) == []
    # Blender itself keeps a list of extensions, and empty folders for thumbnails in the home folder
    strangers = [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "compat.dat"]
    assert strangers == []


def test_manifest_and_package_name_one_version():
    assert manifest()["version"] == rtgi_addon.__version__


def test_changelog_begins_with_this_version():
    lines = (ROOT / "CHANGELOG.md").read_text().splitlines()
    assert next(line for line in lines if line.startswith("## ")).split()[1] == rtgi_addon.__version__


def test_source_manifest_lists_no_wheels():
    # a manifest that lists them cannot be built from a bare checkout; the release script adds them
    assert "wheels" not in manifest()
