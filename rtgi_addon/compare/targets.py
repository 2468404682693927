"""What RTGI sets out to reach, against what `rtgi bench` measured, and what is to blame where it falls short."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.techniques import TECHNIQUE_PARAMS
from .report import percent, text_table

CAMERA_CAPTURE = ("triangles", "camera view", "bvh")
CAPTURE = (*CAMERA_CAPTURE, "fit light views", "light views")
PARTS = ("direct", "bounce", "glossy bounce")
BLAMED = 2                  # how many stages, or kinds of light, are named


@dataclass(frozen=True)
class Verdict:
    """A target of one scene: what it came to over what it may be at most, and if that is above 1, what is to blame."""

    ratio: float
    blame: str

    @property
    def is_met(self) -> bool:
        return self.ratio <= 1

    def __str__(self) -> str:
        return f"{self.ratio:.2f}" if self.is_met else f"**{self.ratio:.2f}** {self.blame}"


def slowest(stages_ms: Mapping[str, float], whole_ms: float) -> str:
    """The stages that take the most of a frame, with their shares."""
    named = sorted(stages_ms.items(), key=lambda item: -item[1])[:BLAMED]
    return ", ".join(f"{name} {100 * ms / whole_ms:.0f} %" for name, ms in named)


def farthest(errors: Mapping[str, Any]) -> str:
    """The kinds of light that are off most, as shares of the picture's light."""
    found = sorted(((errors[part]["of_picture"], part) for part in PARTS if part in errors), reverse=True)[:BLAMED]
    return ", ".join(f"{part} {percent(share)}" for share, part in found)


def _sum(stages_ms: Mapping[str, float], names: Sequence[str]) -> float:
    return sum(stages_ms.get(name, 0.0) for name in names)


def _faster(preset: str, peer: str, share: float, record: Mapping[str, Any]) -> Verdict | None:
    row, cycles = record["rtgi"].get(preset), record["cycles"].get(peer)
    if row is None or cycles is None:
        return None
    return Verdict(row["seconds"] / (share * cycles["seconds"]), slowest(row["stages_ms"], 1e3 * row["seconds"]))


def _nearer(preset: str, peer: str, record: Mapping[str, Any]) -> Verdict | None:
    row, cycles = record["rtgi"].get(preset), record["cycles"].get(peer)
    if row is None or cycles is None or "errors" not in row or "errors" not in cycles:
        return None
    return Verdict(row["errors"]["picture"]["block"] / cycles["errors"]["picture"]["block"], farthest(row["errors"]))


def _light_beside_capture(record: Mapping[str, Any]) -> Verdict | None:
    row = record["rtgi"].get("BALANCED")
    capture_ms = _sum(row["stages_ms"], CAPTURE) if row is not None else 0.0
    if not capture_ms:
        return None
    techniques = {name: row["stages_ms"].get(name, 0.0) for name in TECHNIQUE_PARAMS}
    return Verdict(sum(techniques.values()) / capture_ms, slowest(techniques, max(sum(techniques.values()), 1e-9)))


def _draft_beside_camera(record: Mapping[str, Any]) -> Verdict | None:
    row = record["rtgi"].get("DRAFT")
    bar_ms = 2.5 * _sum(row["stages_ms"], CAMERA_CAPTURE) if row is not None else 0.0
    if not bar_ms:
        return None
    return Verdict(1e3 * row["seconds"] / bar_ms, slowest(row["stages_ms"], 1e3 * row["seconds"]))


TARGETS = {
    "Balanced: time over a third of Cycles 1's": lambda record: _faster("BALANCED", "1", 1 / 3, record),
    "Balanced: error over Cycles 4's": lambda record: _nearer("BALANCED", "4", record),
    "Balanced: techniques over capture": _light_beside_capture,
    "Draft: time over 2.5 times the camera's capture": _draft_beside_camera,
    "Quality: error over Cycles 16's": lambda record: _nearer("QUALITY", "16", record),
    "Quality: time over half of Cycles 16's": lambda record: _faster("QUALITY", "16", 0.5, record),
}


def table(records: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row a scene, a column a target that some scene has the measurements for."""
    found = {name: [judge(record) for record in records] for name, judge in TARGETS.items()}
    found = {name: column for name, column in found.items() if any(verdict is not None for verdict in column)}
    rows = [[record["scene"], *("-" if column[i] is None else str(column[i]) for column in found.values())]
            for i, record in enumerate(records)]
    return ("Targets: what was measured over what it should be at most. Where that is above 1 the stages that take the "
            "most of the frame, or the kinds of light that are off most, are named with their share. Cycles has one bounce "
            "and its denoiser.\n\n" + text_table(("scene", *found), rows, True))
