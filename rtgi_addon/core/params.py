"""Parameters with one source: a frozen dataclass whose fields carry range, unit and description.

The panel's properties, the command line's help and the docs tables are all made from these fields.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ..errors import InputError


def param(default: Any, doc: str, *, low: float | None = None, high: float | None = None, soft_high: float | None = None,
          unit: str = "", choices: tuple[tuple[str, str, str], ...] = (), only: dict[str, Any] | None = None,
          is_for_capture: bool = False) -> Any:
    """A dataclass field with its range and meaning.

    `low` and `high` are hard limits, `soft_high` is where a slider ends; `unit` is one of "", "m", "px", "rad";
    `choices` are (identifier, label, description) for a text parameter. `only` says when the field is read at all: other
    fields of the same dataclass and the value, or tuple of values, that they must have; a panel hides it else.
    `is_for_capture`: it tells what to capture, and is not read afterwards.
    """
    return dataclasses.field(default=default, metadata={
        "doc": doc, "low": low, "high": high, "soft_high": soft_high, "unit": unit, "choices": choices, "only": only or {},
        "is_for_capture": is_for_capture})


def is_read(field: dataclasses.Field, holder: Any) -> bool:
    """Whether a technique reads `field` with the values that `holder` (a dataclass or a Blender group) has now."""
    return all(getattr(holder, name) in (values if isinstance(values, tuple) else (values,))
               for name, values in field.metadata["only"].items())


@dataclass(frozen=True)
class Params:
    """Base of every technique's parameters."""

    @classmethod
    def for_capture(cls) -> tuple[str, ...]:
        """Names of the fields that tell what to capture."""
        return tuple(f.name for f in dataclasses.fields(cls) if f.metadata["is_for_capture"])

    def validate(self, where: str) -> None:
        """Raise InputError naming the first field outside its range; `where` is the technique's name."""
        for f in dataclasses.fields(self):
            value, meta = getattr(self, f.name), f.metadata
            if meta["choices"]:
                allowed = [c[0] for c in meta["choices"]]
                if value not in allowed:
                    raise InputError(f"{where}.{f.name} must be one of {', '.join(allowed)}, got {value!r}")
            elif not isinstance(value, bool):
                low, high = meta["low"], meta["high"]
                if not (low is None or value >= low) or not (high is None or value <= high):
                    span = f"from {low} to {high} {meta['unit']}".rstrip()
                    raise InputError(f"{where}.{f.name} must be {span}, got {value}")
