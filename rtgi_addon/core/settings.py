"""What the user asked for: which techniques may run, with which parameters, on how many threads."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError
from .params import Params

PRESETS = (
    ("DRAFT", "Draft", "A first look: few gather points and rays, soft errors in corners"),
    ("BALANCED", "Balanced", "The default: error of a few denoised path-traced samples, in a fraction of their time"),
    ("QUALITY", "Quality", "Twice the gather points and more rays, for the last picture"),
)


@dataclass(frozen=True)
class Settings:
    """One render's settings.

    `enabled` and `params` are by technique name. With `use_auto` the planner chooses among the enabled techniques and
    leaves out what the frame does not need; without it every enabled technique runs. `threads` 0 means all.
    `target_time_s` of a whole frame, or `target_error` of the picture as a share of its light, lets `budget` choose the
    parameters that a preset decides; 0 is none.
    """

    preset: str = "BALANCED"
    use_auto: bool = True
    enabled: dict[str, bool] = field(default_factory=dict)
    params: dict[str, Params] = field(default_factory=dict)
    threads: int = 0
    seed: int = 0
    target_time_s: float = 0.0
    target_error: float = 0.0

    def with_params(self, technique: str, **changes: Any) -> Settings:
        """A copy in which some parameters of one technique differ."""
        if technique not in self.params:
            raise InputError(f"no technique is called {technique!r}; known are {', '.join(self.params)}")
        changed = dataclasses.replace(self.params[technique], **changes)
        return dataclasses.replace(self, params={**self.params, technique: changed})

    def validate(self) -> None:
        """Raise InputError for the first setting out of range."""
        if self.preset not in [p[0] for p in PRESETS]:
            raise InputError(f"preset must be one of {', '.join(p[0].lower() for p in PRESETS)}, got {self.preset!r}")
        if self.target_time_s and self.target_error:
            raise InputError("a budget is a target time or a target error, not both; set one of them to 0")
        if not (0 <= self.target_time_s < math.inf and 0 <= self.target_error < 1):
            raise InputError("a target time must be 0 s or more, a target error from 0 to less than 100 %, got "
                             f"{self.target_time_s:g} s and {100 * self.target_error:g} %")
        for name, params in self.params.items():
            params.validate(name)
