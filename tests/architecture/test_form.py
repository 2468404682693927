"""Rules of form: numba's policy in one file, no prints, docstrings, no swallowed errors, no paths of a machine."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tools import architecture
from tools.architecture import PACKAGE, ROOT, Module, package_modules

MODULES = package_modules()
TEXT_ENDINGS = {".py", ".md", ".toml", ".sh", ".txt", ".json", ""}

RULES = [architecture.numba_outside_policy, architecture.prints, architecture.missing_docstrings,
         architecture.swallowed_errors]

VIOLATIONS = [
    (architecture.numba_outside_policy, "kernels.vec3", '"""V."""\nfrom numba import njit\n'),
    (architecture.numba_outside_policy, "kernels.vec3", '"""V."""\nimport numba\nf = numba.njit(lambda x: x)\n'),
    (architecture.numba_outside_policy, "passes.rsm", '"""R."""\nf = decorate(fastmath=True)\n'),
    (architecture.prints, "core.frame", '"""F."""\ndef f():\n    """F."""\n    print(1)\n'),
    (architecture.prints, "engine", '"""E."""\nimport sys\nsys.stdout.write("x")\n'),
    (architecture.missing_docstrings, "ui.panels", "import bpy\n"),
    (architecture.missing_docstrings, "kernels.vec3", '"""V."""\ndef dot(a, b):\n    return a * b\n'),
    (architecture.missing_docstrings, "core.frame", '"""F."""\nclass Frame:\n    x: int\n'),
    (architecture.swallowed_errors, "engine", '"""E."""\ntry:\n    f()\nexcept Exception:\n    pass\n'),
    (architecture.swallowed_errors, "engine", '"""E."""\ntry:\n    f()\nexcept:\n    pass\n'),
]


def tracked_texts() -> list[Path]:
    """Text files that git tracks, or all of the checkout but hidden folders where there is no git to ask."""
    if shutil.which("git") and (ROOT / ".git").exists():
        names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True).stdout.split("\0")[:-1]
    else:
        below = [p.relative_to(ROOT) for p in ROOT.rglob("*")]
        names = [str(p) for p in below if not any(part.startswith(".") for part in p.parts)]
    return [ROOT / n for n in names if Path(n).suffix in TEXT_ENDINGS and (ROOT / n).is_file()]


@pytest.mark.parametrize("rule", RULES, ids=lambda r: r.__name__)
@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.name or PACKAGE)
def test_module_keeps_the_rule(rule, module):
    assert rule(module) == []


@pytest.mark.parametrize(("rule", "name", "text"), VIOLATIONS)
def test_rule_catches_a_violation(rule, name, text):
    assert len(rule(Module(name, text))) == 1


def test_no_file_names_a_path_of_somebodys_machine():
    complaints = []
    for path in tracked_texts():
        if path != Path(__file__).resolve():
            complaints += architecture.machine_paths(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    assert complaints == []


@pytest.mark.parametrize("text", ["x = '/home/ann/scene.blend'", "cd /root/venvs", r"p = 'C:\Users\ann'", "see /tmp/x.png"])
def test_path_checker_catches_a_machines_path(text):
    assert len(architecture.machine_paths("x.py", text)) == 1


@pytest.mark.parametrize("text", ["out/tmp/x", "#!/bin/sh", "the paths/root of it", "/usr/share/common-licenses"])
def test_path_checker_lets_other_slashes_pass(text):
    assert architecture.machine_paths("x.py", text) == []


def test_every_registered_technique_has_a_page_in_docs():
    from rtgi_addon.core.techniques import TECHNIQUE_PARAMS

    assert [name for name in TECHNIQUE_PARAMS if not (ROOT / "docs" / "passes" / f"{name}.md").is_file()] == []


def test_every_registered_technique_has_an_oracle_test():
    # the slow float64 form of the formula that the kernel is held against
    from rtgi_addon.core.techniques import TECHNIQUE_PARAMS

    tests = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "tests" / "oracle").glob("test_*.py"))
    assert [name for name in TECHNIQUE_PARAMS if not re.search(rf"passes\.{name}\b|passes import .*\b{name}\b", tests)] == []
