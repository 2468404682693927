"""Rules of form that ruff does not know, as functions from a module's text to a list of complaints.

`tests/architecture/` runs them over the whole package and shows that each of them catches a violation.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "rtgi_addon"

# modules that exist only inside Blender
BLENDER = frozenset({
    "_cycles", "bl_ext", "bl_operators", "bl_ui", "blf", "bmesh", "bpy", "bpy_extras", "cycles", "gpu", "imbuf", "mathutils",
    "OpenImageIO", "PyOpenColorIO"})

# Who may import what beside the standard library. The longest matching prefix of the importing module decides; a module
# that no line matches may import nothing, so a new file at the top must be entered here on purpose. An entry "x" allows x
# and x.anything.
MAY_IMPORT: dict[str, frozenset[str]] = {
    "": frozenset({"rtgi_addon.ui"}),                                       # rtgi_addon/__init__.py, inside its functions
    "__main__": frozenset({"rtgi_addon.cli"}),
    "errors": frozenset(),
    "blendfile": frozenset({"rtgi_addon.errors", "zstandard"}),
    "core": frozenset({"numpy", "rtgi_addon.core", "rtgi_addon.errors"}),
    "kernels": frozenset({"llvmlite", "numpy", "numba", "rtgi_addon.kernels", "rtgi_addon.core.cache_root"}),
    "passes": frozenset({"numpy", "rtgi_addon.core", "rtgi_addon.kernels", "rtgi_addon.passes", "rtgi_addon.errors"}),
    "planner": frozenset({"numpy", "rtgi_addon.core", "rtgi_addon.passes", "rtgi_addon.errors"}),
    "budget": frozenset({"rtgi_addon.core", "rtgi_addon.kernels.jit", "rtgi_addon.kernels.probe", "rtgi_addon.planner"}),
    "composite": frozenset({"numpy", "rtgi_addon.core", "rtgi_addon.passes", "rtgi_addon.errors"}),
    "frameio": frozenset({"numpy", "rtgi_addon.core", "rtgi_addon.errors"}),
    "light_views": frozenset({
        "numpy", "rtgi_addon.core", "rtgi_addon.kernels", "rtgi_addon.passes.surroundings", "rtgi_addon.errors"}),
    "emitter_lamps": frozenset({"numpy", "rtgi_addon.core", "rtgi_addon.kernels"}),
    "pipeline": frozenset({
        "numpy", "numba", "rtgi_addon", "rtgi_addon.composite", "rtgi_addon.core", "rtgi_addon.errors",
        "rtgi_addon.kernels.embree", "rtgi_addon.kernels.jit", "rtgi_addon.passes", "rtgi_addon.planner"}),
    "warmup": frozenset({
        "numpy", "rtgi_addon.core", "rtgi_addon.emitter_lamps", "rtgi_addon.kernels.jit", "rtgi_addon.passes",
        "rtgi_addon.light_views"}),
    "compare": frozenset({
        "numpy", "rtgi_addon", "rtgi_addon.compare", "rtgi_addon.composite", "rtgi_addon.core", "rtgi_addon.errors",
        "rtgi_addon.frameio", "rtgi_addon.imageio", "rtgi_addon.passes", "rtgi_addon.pipeline", "rtgi_addon.planner"}),
    "compare.plot": frozenset({"matplotlib", "rtgi_addon.compare"}),
    "compare.reference": BLENDER | {
        "numpy", "rtgi_addon.blendfile", "rtgi_addon.capture", "rtgi_addon.compare", "rtgi_addon.core", "rtgi_addon.engine",
        "rtgi_addon.errors", "rtgi_addon.imageio", "rtgi_addon.ui.props"},
    "compare.rooms": BLENDER,
    "capture": BLENDER | {
        "numpy", "rtgi_addon.capture", "rtgi_addon.core", "rtgi_addon.errors", "rtgi_addon.kernels",
        "rtgi_addon.light_views"},
    "imageio": BLENDER | {"numpy", "rtgi_addon.core", "rtgi_addon.errors"},
    "output": frozenset({
        "numpy", "rtgi_addon.capture.versions", "rtgi_addon.core", "rtgi_addon.kernels", "rtgi_addon.passes",
        "rtgi_addon.pipeline"}),
    "engine": BLENDER | {
        "numpy", "rtgi_addon.budget", "rtgi_addon.capture", "rtgi_addon.core", "rtgi_addon.emitter_lamps",
        "rtgi_addon.errors", "rtgi_addon.kernels.jit", "rtgi_addon.light_views", "rtgi_addon.output", "rtgi_addon.passes",
        "rtgi_addon.pipeline", "rtgi_addon.planner", "rtgi_addon.ui.props"},
    "ui": BLENDER | {"numpy", "rtgi_addon"},
    "cli": BLENDER | {"numpy", "rtgi_addon"},
    "doctor": BLENDER | {"numpy", "numba", "rtgi_addon"},
}
# "rtgi_addon" alone in a set is the package's own file (version, register) for the modules below, all of it for these
MAY_IMPORT_ALL = frozenset({"ui", "cli", "doctor"})

# the only files that may write to the terminal
MAY_PRINT = ("cli", "doctor", "compare")

NUMBA_OPTIONS = frozenset({
    "jit", "njit", "vectorize", "guvectorize", "stencil", "cfunc", "generated_jit", "overload", "fastmath", "error_model"})
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:home|root|work|tmp|Users|mnt)/\w|\b[A-Z]:\\\\?Users\b")


@dataclass(frozen=True)
class Module:
    """A module of the package: its dotted name below `rtgi_addon` ("" for the package itself), file and text."""

    name: str
    text: str
    is_package: bool = False

    @property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)

    def says(self, node: ast.AST | None, complaint: str) -> str:
        return f"{PACKAGE}.{self.name}:{getattr(node, 'lineno', 1)}: {complaint}"


def package_modules() -> list[Module]:
    """Every module of the package."""
    found = []
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        parts = path.relative_to(ROOT / PACKAGE).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        found.append(Module(".".join(parts[:-1] if is_package else parts), path.read_text(encoding="utf-8"), is_package))
    return found


def _absolute(module: Module, node: ast.ImportFrom) -> str:
    """The absolute name that a `from ... import` names."""
    if not node.level:
        return node.module or ""
    here = [PACKAGE, *(module.name.split(".") if module.name else [])]
    base = here if module.is_package else here[:-1]
    base = base[:len(base) - (node.level - 1)]
    return ".".join([*base, node.module] if node.module else base)


def imports(module: Module, modules: frozenset[str]) -> Iterator[tuple[ast.AST, str]]:
    """(node, absolute module name) of every import, also inside functions; `modules` are the package's own absolute names.

    `from . import x` is an import of module x where x is a module, of the package otherwise.
    """
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(module, node)
            for alias in node.names:
                yield node, f"{base}.{alias.name}" if f"{base}.{alias.name}" in modules else base
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__") and isinstance(node.args[0].value, str):
                yield node, node.args[0].value


def _rule(name: str) -> str | None:
    """The longest prefix of `name` in MAY_IMPORT."""
    parts = name.split(".") if name else []
    for end in range(len(parts), 0, -1):
        if ".".join(parts[:end]) in MAY_IMPORT:
            return ".".join(parts[:end])
    return "" if not parts else None


def _allowed(target: str, rule: str) -> bool:
    for entry in MAY_IMPORT[rule]:
        if entry == PACKAGE and rule not in MAY_IMPORT_ALL:
            if target == PACKAGE:
                return True
        elif target == entry or target.startswith(entry + "."):
            return True
    return False


def wrong_imports(module: Module, modules: frozenset[str] = frozenset()) -> list[str]:
    """Imports that the table does not allow this module."""
    rule = _rule(module.name)
    complaints = []
    for node, target in imports(module, modules):
        top = target.partition(".")[0]
        if top in sys.stdlib_module_names:
            continue
        if rule is None:
            complaints.append(module.says(node, f"imports {target}, but MAY_IMPORT has no line for this module"))
        elif not _allowed(target, rule):
            complaints.append(module.says(node, f"imports {target}, which the line {rule!r} does not allow"))
    return complaints


def absolute_self_imports(module: Module) -> list[str]:
    """Imports of the package by its absolute name, which does not exist in an installed extension."""
    complaints = []
    for node in ast.walk(module.tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        complaints += [module.says(node, f"imports {name} absolutely; write it relative") for name in names
                       if name.partition(".")[0] == PACKAGE]
    return complaints


def numba_outside_policy(module: Module) -> list[str]:
    """Numba's decorators or options anywhere but in kernels/jit.py, where the policy is.

    kernels/embree.py speaks to the compiler itself, since it calls functions of another library.
    """
    if module.name in ("kernels.jit", "kernels.embree"):
        return []
    complaints = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "numba":
            complaints.append(module.says(node, "takes names from numba; decorators come from kernels/jit.py"))
        elif isinstance(node, ast.Attribute) and node.attr in NUMBA_OPTIONS and ast.unparse(node.value) in ("numba", "nb"):
            complaints.append(module.says(node, f"uses numba.{node.attr}; decorators come from kernels/jit.py"))
        elif isinstance(node, ast.keyword) and node.arg in ("fastmath", "error_model", "nopython"):
            complaints.append(module.says(node.value, f"sets {node.arg}; the policy is in kernels/jit.py"))
    return complaints


def prints(module: Module) -> list[str]:
    """Calls of print and writes to stdout outside the modules that talk on a terminal."""
    if module.name.partition(".")[0] in MAY_PRINT:
        return []
    complaints = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Call):
            text = ast.unparse(node.func)
            if text == "print" or text in ("sys.stdout.write", "sys.stderr.write"):
                complaints.append(module.says(node, f"calls {text}; use Context.report, a warning or the report"))
    return complaints


def missing_docstrings(module: Module) -> list[str]:
    """Modules without a docstring; in core, kernels and passes also public functions and classes without one."""
    complaints = []
    if not ast.get_docstring(module.tree):
        complaints.append(module.says(None, "has no module docstring"))
    if module.name.partition(".")[0] in ("core", "kernels", "passes"):
        for node in module.tree.body:
            is_public = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
            if is_public and not ast.get_docstring(node):
                complaints.append(module.says(node, f"{node.name} is public and has no docstring"))
    return complaints


def swallowed_errors(module: Module) -> list[str]:
    """Handlers that catch everything and do nothing."""
    complaints = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ExceptHandler):
            caught = ast.unparse(node.type) if node.type else ""
            does_nothing = all(isinstance(statement, ast.Pass | ast.Continue) for statement in node.body)
            if does_nothing and caught in ("", "Exception", "BaseException"):
                complaints.append(module.says(node, f"swallows {caught or 'every exception'}"))
    return complaints


def machine_paths(name: str, text: str) -> list[str]:
    """Lines of any text file that hold a path of somebody's machine."""
    return [f"{name}:{i}: {line.strip()}" for i, line in enumerate(text.splitlines(), 1) if MACHINE_PATH.search(line)]


def work_at_import(text: str) -> list[str]:
    """Statements of a shim that do anything when it is imported: all but docstring and function definitions."""
    complaints = []
    for node in ast.parse(text).body:
        is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if not is_docstring and not isinstance(node, ast.FunctionDef):
            complaints.append(f"line {node.lineno}: {ast.unparse(node)[:60]}")
        elif isinstance(node, ast.FunctionDef) and node.decorator_list:
            complaints.append(f"line {node.lineno}: a decorator runs at import")
    return complaints
