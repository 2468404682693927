"""The list of hard cases in docs/hard_cases.md names tests that are there, and forgets no case."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.hard_cases import CASES

ROOT = Path(__file__).resolve().parents[2]
TESTS = sorted({test for case in CASES for test in case.tests})


@pytest.mark.parametrize("test", TESTS)
def test_a_named_test_is_there(test):
    file, name = test.split("::")
    assert f"def {name}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


def test_every_case_has_a_test_and_its_heading_in_the_page():
    page = (ROOT / "docs" / "hard_cases.md").read_text(encoding="utf-8").splitlines()
    for case in CASES:
        assert f"### {case.name}" in page
        assert any(other.tests for other in CASES if other.name == case.name)


def test_every_test_of_this_folder_is_in_the_list_or_tells_why_the_list_holds():
    named = {test.split("::")[1] for test in TESTS}
    for path in Path(__file__).parent.glob("test_*.py"):
        if path.name not in ("test_list.py", "test_odd_frames.py"):
            found = {line[4:line.index("(")] for line in path.read_text(encoding="utf-8").splitlines()
                     if line.startswith("def test_")}
            assert found <= named, path.name
