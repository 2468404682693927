"""The release script: zips split by platform, each with the wheels of both Pythons, and what it refuses."""

from __future__ import annotations

import importlib.util
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
TAGS = {"linux-x64": "manylinux_2_27_x86_64.manylinux_2_28_x86_64", "windows-x64": "win_amd64",
        "macos-arm64": "macosx_12_0_arm64"}
LIBRARIES = {TAGS["linux-x64"]: ("a.so", b"\x7fELF"), TAGS["windows-x64"]: ("a.pyd", b"MZ"),
             TAGS["macos-arm64"]: ("a.so", b"\xcf\xfa\xed\xfe\x0c\x00\x00\x01")}


@pytest.fixture(scope="module")
def release() -> ModuleType:
    spec = importlib.util.spec_from_file_location("release", ROOT / "tools" / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def wheels(tmp_path: Path) -> Path:
    """A folder of files that are called as the wheels are; the build looks at names."""
    folder = tmp_path / "given"
    folder.mkdir()
    for package in ("numba-0.68.1", "llvmlite-0.50.0"):
        for python in ("cp311", "cp313"):
            for tag in TAGS.values():
                write_wheel(folder / f"{package}-{python}-{python}-{tag}.whl", *LIBRARIES[tag])
    return folder


def write_wheel(path: Path, library: str, first_bytes: bytes) -> None:
    """A wheel with one library."""
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr(f"{path.stem}.dist-info/METADATA", "")
        wheel.writestr(library, first_bytes + bytes(60))


def test_each_platform_gets_its_wheels_for_both_pythons_and_no_others(release, wheels, tmp_path, monkeypatch):
    monkeypatch.delenv("BLENDER", raising=False)
    monkeypatch.setenv("PATH", "")               # the extension command line of the bpy module
    zips = release.build(tmp_path / "dist", wheels)
    assert len(zips) == len(TAGS)
    for platform, tag in TAGS.items():
        (path,) = [path for path in zips if platform.replace("-", "_") in path.name]
        archive = zipfile.ZipFile(path)
        inside = {Path(name).name for name in archive.namelist() if name.endswith(".whl")}
        assert inside == {f"{package}-{python}-{python}-{tag}.whl"
                          for package in ("numba-0.68.1", "llvmlite-0.50.0") for python in ("cp311", "cp313")}
        generated = tomllib.loads(archive.read("blender_manifest.toml").decode())["build"]["generated"]
        assert generated["platforms"] == [platform] and len(generated["wheels"]) == len(inside)
        assert {str(path.relative_to(ROOT)) for path in (ROOT / "rtgi_addon").rglob("*.py")} <= set(archive.namelist())


@pytest.mark.parametrize(("library", "first_bytes", "said"), [
    ("a.so", b"\x7fELF", "has no libraries for windows-x64"),          # Linux' under Windows' name
    ("a.pyd", b"\x7fELF", "has no libraries for windows-x64"),
    ("numpy/a.pyd", b"MZ", "brings numpy along")])
def test_wheels_whose_inside_is_not_what_their_name_says_are_refused(release, wheels, tmp_path, monkeypatch, library,
                                                                     first_bytes, said):
    monkeypatch.delenv("BLENDER", raising=False)
    monkeypatch.setenv("PATH", "")
    write_wheel(next(wheels.glob("llvmlite-*-cp313-*win_amd64.whl")), library, first_bytes)
    with pytest.raises(release.ReleaseError, match=said):
        release.build(tmp_path / "dist", wheels)


def test_a_zip_with_a_wheel_of_another_system_is_refused(release, wheels, tmp_path, monkeypatch):
    monkeypatch.delenv("BLENDER", raising=False)
    monkeypatch.setenv("PATH", "")
    (path,) = [path for path in release.build(tmp_path / "dist", wheels) if "windows_x64" in path.name]
    stranger = next(wheels.glob("*manylinux*.whl"))
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(stranger, f"wheels/{stranger.name}")
    with pytest.raises(release.ReleaseError, match="lists other wheels than it holds"):
        release.check_zip(path)


def test_numpy_is_refused(release, wheels):
    (wheels / "numpy-2.3.0-cp313-cp313-win_amd64.whl").write_bytes(b"")
    with pytest.raises(release.ReleaseError, match="numpy must not be bundled"):
        release.chosen_wheels(wheels)


def test_a_missing_wheel_is_named(release, wheels):
    next(wheels.glob("llvmlite-*-cp311-*win_amd64.whl")).unlink()
    with pytest.raises(release.ReleaseError, match="0 wheels of llvmlite for Python 3.11 on windows-x64"):
        release.chosen_wheels(wheels)


def test_a_wheel_of_another_system_is_refused(release, wheels):
    (wheels / "numba-0.68.1-cp313-cp313-macosx_12_0_x86_64.whl").write_bytes(b"")
    with pytest.raises(release.ReleaseError, match="is for none of"):
        release.chosen_wheels(wheels)


def test_pinned_packages_are_those_that_the_project_allows(release):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    (numba,) = [line for line in project if line.startswith("numba")]
    low, high = numba.removeprefix("numba>=").split(",<")
    pinned = dict(package.split("==") for package in release.PACKAGES)["numba"]
    as_numbers = [tuple(map(int, text.split("."))) for text in (low, pinned, high)]
    assert as_numbers == sorted(as_numbers)
