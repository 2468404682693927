"""Write the parameter tables of docs/passes/ from the dataclasses: `python tools/parameter_tables.py`.

A page holds a table between `<!-- parameters -->` and `<!-- /parameters -->`; everything between is replaced. Other tools
fill other marks in the same way, by `between_marks`.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.core.params import Params  # noqa: E402
from rtgi_addon.core.techniques import PRESET_PARAMS, TECHNIQUE_PARAMS  # noqa: E402


def block_of(mark: str) -> re.Pattern:
    """What is between `<!-- mark -->` and `<!-- /mark -->`, with both."""
    return re.compile(rf"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)", re.DOTALL)


def between_marks(page: str, mark: str, text: str) -> str:
    """`page` with `text` between its marks."""
    return block_of(mark).sub(lambda match: match[1] + text + match[2], page)


BLOCK = block_of("parameters")


def _range(field: dataclasses.Field) -> str:
    meta = field.metadata
    if meta["choices"]:
        return ", ".join(f"`{identifier}`" for identifier, _, _ in meta["choices"])
    if isinstance(field.default, bool):
        return "on, off"
    return f"{meta['low']} to {meta['high']} {meta['unit']}".rstrip()


def _default(field: dataclasses.Field) -> str:
    if isinstance(field.default, bool):
        return "on" if field.default else "off"
    return f"`{field.default}`" if isinstance(field.default, str) else str(field.default)


def table(name: str, params: type[Params]) -> str:
    """The Markdown table of one technique's parameters, with what each preset sets, and the choices explained below."""
    presets = list(PRESET_PARAMS)
    lines = [f"| parameter | default | range | {' | '.join(p.capitalize() for p in presets)} | meaning |",
             "| --- " * (4 + len(presets)) + "|"]
    notes = []
    for field in dataclasses.fields(params):
        of_presets = " | ".join(str(PRESET_PARAMS[p].get(name, {}).get(field.name, "")) for p in presets)
        lines.append(f"| `{field.name}` | {_default(field)} | {_range(field)} | {of_presets} | {field.metadata['doc']} |")
        notes += [f"- `{field.name}` {identifier}: {doc}." for identifier, _, doc in field.metadata["choices"]]
    return "\n".join([*lines, *([""] if notes else []), *notes]) + "\n"


def updated(page: str, name: str) -> str:
    """The text of a technique's page with its table as it should be."""
    return between_marks(page, "parameters", table(name, TECHNIQUE_PARAMS[name]))


def main() -> int:
    """Rewrite every page that has a table."""
    for name in TECHNIQUE_PARAMS:
        path = ROOT / "docs" / "passes" / f"{name}.md"
        text = path.read_text(encoding="utf-8")
        path.write_text(updated(text, name), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
