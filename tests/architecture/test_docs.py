"""The documents say what the code says: parameter tables, module names, links, commands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from rtgi_addon.core.techniques import TECHNIQUE_PARAMS
from tools import parameter_tables, results

ROOT = Path(__file__).resolve().parent.parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def page_of(name: str) -> str:
    return (ROOT / "docs" / "passes" / f"{name}.md").read_text(encoding="utf-8")


def anchor(heading: str) -> str:
    """The anchor that a heading gets: lower case, blanks to hyphens, other signs dropped."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


@pytest.mark.parametrize("name", TECHNIQUE_PARAMS)
def test_parameter_table_of_the_page_equals_the_code(name):
    # mended by: python tools/parameter_tables.py
    assert parameter_tables.BLOCK.search(page_of(name)) is not None
    assert parameter_tables.updated(page_of(name), name) == page_of(name)


@pytest.mark.parametrize("name", TECHNIQUE_PARAMS)
def test_page_shows_a_picture_and_what_was_measured(name):
    # made by: python -m tools.technique_pictures, python -m tools.technique_tables
    page = page_of(name)
    assert re.search(r"!\[[^\]]+\]\(\.\./images/", page) is not None
    assert parameter_tables.block_of("measured").search(page)[0].count("\n| ") > 3


def test_a_changed_description_would_be_noticed():
    page = page_of("rsm").replace("Visibility rays from each gather point", "Rays")
    assert parameter_tables.updated(page, "rsm") != page


@pytest.mark.parametrize("name", TECHNIQUE_PARAMS)
def test_page_says_what_the_technique_ignores(name):
    assert "## What it ignores" in page_of(name)


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_local_links_lead_to_a_file_and_a_heading(path):
    dead = []
    for link, place in re.findall(r"\]\(([^)#:\s]*)(?:#([^)]*))?\)", path.read_text(encoding="utf-8")):
        target = path.parent / link if link else path
        if not target.exists():
            dead.append(link)
        elif place and place not in [anchor(h) for h in re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.M)]:
            dead.append(f"{link}#{place}")
    assert dead == []


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_source_files_that_a_page_names_exist(path):
    # `kernels/jit.py` may be written without the package's name
    names = re.findall(r"`((?:[\w.]+/)+[\w.]+\.py|tools/\w+\.py|[a-z_]+\.py)(?::[^`]*)?`", path.read_text(encoding="utf-8"))
    bases = (ROOT, ROOT / "rtgi_addon", ROOT / "rtgi_addon" / "compare", ROOT / "rtgi_addon" / "kernels")
    assert [n for n in names if "NAME" not in n and not any((base / n).exists() for base in bases)] == []


def test_readme_names_the_two_commands_and_they_can_be_run():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in ("demo", "check"):
        assert f"\n./{name}\n" in text
        assert (ROOT / name).stat().st_mode & 0o111


def test_readme_shows_the_times_and_errors_of_the_results():
    # mended by: python tools/results.py
    table = results.readme_table((ROOT / "docs" / "results.md").read_text(encoding="utf-8"))
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert table.count("\n") > 5 and f"<!-- results -->\n{table}<!-- /results -->" in text


def test_readme_names_every_command_of_the_program():
    from rtgi_addon.cli import parser

    (commands,) = [a.choices for a in parser()._actions if a.choices and not a.option_strings]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [c for c in commands if f"`rtgi {c}" not in text] == []


def test_readme_names_no_command_that_the_program_lacks():
    from rtgi_addon.cli import parser

    (commands,) = [a.choices for a in parser()._actions if a.choices and not a.option_strings]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"`rtgi (\w+)", text)) - set(commands) == set()


def test_contributing_stays_short():
    # a page that is read is worth more than a page that is complete
    assert len((ROOT / "CONTRIBUTING.md").read_text().splitlines()) <= 150
