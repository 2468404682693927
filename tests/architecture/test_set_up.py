"""The set-up script: what it installs, what it says about missing libraries, which Pythons the commands take."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent

_spec = importlib.util.spec_from_file_location("set_up", ROOT / "tools" / "set_up.py")
set_up = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(set_up)

LDD = """\
\tlinux-vdso.so.1 (0x00007ffd8a5f2000)
\tlibX11.so.6 => /lib/x86_64-linux-gnu/libX11.so.6 (0x00007f5b9c000000)
\tlibXi.so.6 => not found
\tlibSM.so.6 => not found
\tlibembree4.so.4 => /venv/bpy/lib/libembree4.so.4 (0x00007f5b9b000000)
"""
IMPORT_ERROR = "ImportError: libxkbcommon.so.0: cannot open shared object file: No such file or directory"


def script(tmp_path: Path, name: str, text: str) -> None:
    """An executable shell script `name` in a folder that serves as the whole PATH."""
    path = tmp_path / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def command(tmp_path: Path, words: list[str], **environment: str) -> subprocess.CompletedProcess:
    """Run one of the two commands with nothing on the PATH but `tmp_path` and the shell's own tools."""
    for tool in ("sh", "dirname"):
        if not (tmp_path / tool).exists():
            (tmp_path / tool).symlink_to(f"/bin/{tool}" if os.path.exists(f"/bin/{tool}") else f"/usr/bin/{tool}")
    environment = {"PATH": str(tmp_path), "HOME": str(tmp_path), **environment}
    return subprocess.run([str(ROOT / words[0]), *words[1:]], env=environment, capture_output=True, text=True,
                          stdin=subprocess.DEVNULL, timeout=30)


def test_ldd_output_gives_every_missing_library_at_once():
    assert set_up.missing_libraries(LDD) == ["libSM.so.6", "libXi.so.6"]


def test_import_error_gives_the_missing_library():
    assert set_up.missing_libraries(IMPORT_ERROR) == ["libxkbcommon.so.0"]


def test_complete_machine_lacks_no_library():
    assert set_up.missing_libraries("\tlibXi.so.6 => /lib/libXi.so.6 (0x0)\n") == []


def test_message_names_libraries_and_packages_in_one_line():
    text = set_up.library_message(["libSM.so.6", "libXi.so.6"])
    assert "\n" not in text
    assert "libSM.so.6, libXi.so.6" in text and "apt-get install libsm6 libxi6" in text


def test_message_names_an_unknown_library_without_inventing_a_package():
    text = set_up.library_message(["libfoo.so.9"])
    assert "libfoo.so.9" in text and "apt-get install" not in text


@pytest.mark.parametrize("job", ["run", "test"])
def test_requirements_hold_one_bpy_for_each_python(job):
    wanted = set_up.requirements(job, (ROOT / "pyproject.toml").read_text())
    assert sum(line.startswith("bpy==5.2.") and "3.13" in line for line in wanted) == 1
    assert sum(line.startswith("bpy==4.5.") and "3.11" in line for line in wanted) == 1


@pytest.mark.parametrize("job", ["run", "test"])
def test_both_commands_bring_what_draws_the_plots(job):
    wanted = set_up.requirements(job, (ROOT / "pyproject.toml").read_text())
    assert sum(line.startswith("matplotlib") for line in wanted) == 1


def test_only_the_tests_need_pytest():
    pyproject = (ROOT / "pyproject.toml").read_text()
    assert not any(line.startswith("pytest") for line in set_up.requirements("run", pyproject))
    assert any(line.startswith("pytest") for line in set_up.requirements("test", pyproject))


@pytest.mark.parametrize("name", ["demo", "check"])
def test_machine_with_another_python_is_refused_in_one_line_with_the_mend(tmp_path, name):
    script(tmp_path, "python3", 'case "$1" in --version) echo "Python 3.12.1" ;; *) exit 1 ;; esac')
    run = command(tmp_path, [name])
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1
    assert "Python 3.12.1" in run.stderr and "apt-get install python3.11" in run.stderr


def test_machine_without_python_is_refused(tmp_path):
    run = command(tmp_path, ["check"])
    assert run.returncode == 1 and "no Python 3" in run.stderr


def test_pyenv_shim_of_an_unselected_version_is_not_taken(tmp_path):
    script(tmp_path, "python3.13", 'echo "pyenv: python3.13: command not found" >&2; exit 127')
    assert command(tmp_path, ["check", "3.13"]).returncode == 1


def test_wrong_interpreter_in_the_environment_is_named(tmp_path):
    script(tmp_path, "other", "exit 1")
    run = command(tmp_path, ["demo"], PYTHON=str(tmp_path / "other"))
    assert run.returncode == 1 and "other is not Python 3.13 or 3.11" in run.stderr


def test_check_refuses_a_version_that_it_does_not_know(tmp_path):
    assert command(tmp_path, ["check", "3.12"]).returncode == 2


def test_set_up_refuses_an_unknown_job():
    run = subprocess.run([sys.executable, str(ROOT / "tools" / "set_up.py"), "dance"], capture_output=True, text=True)
    assert run.returncode == 2
