"""Build the extension's zips for a release: one a platform, each with numba and llvmlite for both Pythons.

    python tools/release.py --download                   wheels from PyPI into wheels/, then the zips into dist/
    python tools/release.py --wheels DIR -o dist         the same with wheels that are there already, without network
    python tools/release.py --bare                       one zip without wheels, for a Blender whose Python has numba

The checkout's own manifest lists no wheels, so that a bare checkout builds too; the zips' manifests are written here.
Blender's extension command line builds and validates: `blender` on the path or in $BLENDER, else the one in the bpy module.
numpy is never among the wheels: Blender brings its own, which another one would replace for every add-on.
"""

from __future__ import annotations

import argparse
import io
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("numba==0.68.1", "llvmlite==0.50.0")
PYTHONS = ("3.11", "3.13")                       # of Blender 4.5 LTS and 5.2 LTS
# Blender's name of a platform and the tags of wheels that run there: glibc 2.28 and macOS 11 are what Blender itself needs
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64", "macosx_12_0_arm64"),
}
# the endings of libraries in wheels, and their first bytes: ELF and PE name the processor further in, Mach-O right there
_LIBRARIES = {"linux-x64": ((".so",), b"\x7fELF"), "windows-x64": ((".pyd", ".dll"), b"MZ"),
              "macos-arm64": ((".so", ".dylib"), b"\xcf\xfa\xed\xfe\x0c\x00\x00\x01")}
_ENDINGS = {"linux-x64": ("x86_64",), "windows-x64": ("win_amd64",), "macos-arm64": ("arm64",)}


class ReleaseError(Exception):
    """A release that cannot be built; the text says why."""


def extension_command() -> list[str]:
    """How to call Blender's extension command line."""
    named = os.environ.get("BLENDER") or shutil.which("blender")
    if named:
        return [*shlex.split(named), "--command", "extension"]
    spec = find_spec("bpy")
    tools = list(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")) if spec else []
    if not tools:
        raise ReleaseError("neither Blender nor its Python module bpy is here; set $BLENDER")
    return [sys.executable, str(tools[0])]


def run(words: list[str]) -> None:
    """Run a program; ReleaseError with what it said if it fails."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ReleaseError(f"{shlex.join(words[:6])} ...\n{done.stdout}{done.stderr}")


def download(folder: Path) -> None:
    """Fetch the wheels of every platform and Python into `folder`; what is there already stays."""
    folder.mkdir(parents=True, exist_ok=True)
    for tags in PLATFORMS.values():
        for python in PYTHONS:
            platform = [word for tag in tags for word in ("--platform", tag)]
            run([sys.executable, "-m", "pip", "download", "--only-binary=:all:", "--no-deps", "--quiet",
                 "--implementation", "cp", "--python-version", python, *platform, "--dest", str(folder), *PACKAGES])


def platform_of(wheel: Path) -> str:
    """Blender's platform of a wheel by the end of its name; ReleaseError if none of ours."""
    tag = wheel.stem.rpartition("-")[2]
    for platform, endings in _ENDINGS.items():
        if tag.endswith(endings) and tag.startswith(platform[:3].replace("lin", "manylinux")):
            return platform
    raise ReleaseError(f"{wheel.name} is for none of {', '.join(PLATFORMS)}")


def chosen_wheels(folder: Path) -> list[Path]:
    """The wheels of `PACKAGES` in `folder`; ReleaseError if one is missing, double or not ours."""
    found = sorted(folder.glob("*.whl"))
    if any(wheel.name.lower().startswith("numpy-") for wheel in found):
        raise ReleaseError("numpy must not be bundled: it would replace Blender's own for every add-on")
    for name in (package.partition("==")[0] for package in PACKAGES):
        for python in PYTHONS:
            tag = f"cp{python.replace('.', '')}"
            for platform in PLATFORMS:
                fitting = [w.name for w in found
                           if w.name.startswith(f"{name}-") and f"-{tag}-" in w.name and platform_of(w) == platform]
                if len(fitting) != 1:
                    raise ReleaseError(f"{folder} holds {len(fitting)} wheels of {name} for Python {python} on {platform}")
    return [wheel for wheel in found if wheel.name.partition("-")[0] in {p.partition("==")[0] for p in PACKAGES}]


def check_zip(path: Path) -> None:
    """ReleaseError unless a platform's zip can be right where it was not tried.

    It lists and holds each of `PACKAGES` for each of `PYTHONS` once, for its platform and for none else, with libraries of
    that system in them and without numpy.
    """
    with zipfile.ZipFile(path) as archive:
        wheels = sorted(name for name in archive.namelist() if name.endswith(".whl"))
        build = tomllib.loads(archive.read("blender_manifest.toml").decode())["build"]["generated"]
        (platform,) = build["platforms"]
        if sorted(build["wheels"]) != [f"./{name}" for name in wheels]:
            raise ReleaseError(f"{path.name} lists other wheels than it holds")
        found = sorted((name.split("/")[-1].split("-")[0], name.split("-")[2], platform_of(Path(name))) for name in wheels)
        wanted = sorted((package.partition("==")[0], f"cp{python.replace('.', '')}", platform)
                        for package in PACKAGES for python in PYTHONS)
        if found != wanted:
            raise ReleaseError(f"{path.name} holds the wheels {found}, not {wanted}")
        endings, magic = _LIBRARIES[platform]
        for name in wheels:
            with zipfile.ZipFile(io.BytesIO(archive.read(name))) as wheel:
                libraries = [inner for inner in wheel.namelist() if inner.endswith((".so", ".pyd", ".dll", ".dylib"))]
                strangers = [inner for inner in libraries
                             if not inner.endswith(endings) or not wheel.open(inner).read(len(magic)).startswith(magic)]
                if strangers or not libraries:
                    raise ReleaseError(f"{name} has no libraries for {platform}, or others: {', '.join(strangers)}")
                if any(inner.startswith("numpy/") for inner in wheel.namelist()):
                    raise ReleaseError(f"{name} brings numpy along")


def released_manifest(text: str, wheels: list[Path]) -> str:
    """The manifest with platforms and wheels, which must stand before its first table; a bare build leaves wheels out."""
    head, mark, tables = text.replace('  "/wheels/",\n', "").partition("\n[")
    lines = [f"platforms = [{', '.join(repr(p) for p in PLATFORMS)}]".replace("'", '"'), "wheels = ["]
    lines += [f'  "./wheels/{wheel.name}",' for wheel in wheels]
    return "\n".join([head.rstrip("\n"), *lines, "]", ""]) + mark + tables


def stage(folder: Path, wheels: list[Path]) -> None:
    """Copy what belongs into the extension to `folder`, with the manifest of the release."""
    for name in ("__init__.py", "CHANGELOG.md", "LICENSE", "README.md"):
        shutil.copy2(ROOT / name, folder)
    shutil.copytree(ROOT / "rtgi_addon", folder / "rtgi_addon", ignore=shutil.ignore_patterns("__pycache__", ".*"))
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    if wheels:
        text = released_manifest(text, wheels)
        (folder / "wheels").mkdir()
        for wheel in wheels:
            shutil.copy2(wheel, folder / "wheels")
    (folder / "blender_manifest.toml").write_text(text, encoding="utf-8")


def build(output: Path, wheels_folder: Path | None) -> list[Path]:
    """Build the zips into `output` and validate each; with wheels one a platform, without one for all."""
    tool, version = extension_command(), tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    wheels = chosen_wheels(wheels_folder) if wheels_folder else []
    output.mkdir(parents=True, exist_ok=True)
    before = {path: path.stat().st_mtime_ns for path in output.glob("*.zip")}
    with tempfile.TemporaryDirectory(prefix="rtgi_release_") as name:
        source = Path(name) / "rtgi"
        source.mkdir()
        stage(source, wheels)
        words = ["build", "--source-dir", str(source)]
        if wheels:
            run([*tool, *words, "--output-dir", str(output), "--split-platforms"])
        else:
            run([*tool, *words, "--output-filepath", str(output / f"rtgi-{version}.zip")])
    zips = sorted(path for path in output.glob("*.zip") if before.get(path) != path.stat().st_mtime_ns)
    for path in zips:
        run([*tool, "validate", str(path)])
        if wheels:
            check_zip(path)
    return zips


def main(argv: list[str] | None = None) -> int:
    """Run the command line; 1 if the release cannot be built."""
    parser = argparse.ArgumentParser(description="Build the extension's zips for a release.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", metavar="DIR", help="folder for the zips; dist/")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--download", action="store_true", help="fetch the wheels from PyPI into wheels/ first")
    source.add_argument("--wheels", type=Path, metavar="DIR", help="folder that holds the wheels")
    source.add_argument("--bare", action="store_true", help="one zip without wheels")
    words = parser.parse_args(argv)
    try:
        folder = ROOT / "wheels" if words.download else words.wheels
        if words.download:
            download(folder)
        for path in build(words.output.resolve(), folder):
            print(f"{path}  {path.stat().st_size / 1e6:.1f} MB")
    except ReleaseError as error:
        print(f"release: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
