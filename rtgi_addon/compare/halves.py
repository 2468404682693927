"""The reference as data: the passes of two independent halves, saved as .npz, and what a picture is held against."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError

# by the names of Blender 5; files of Blender 4.5 are saved under the same keys
PASSES = ("Combined", "Depth", "Diffuse Direct", "Diffuse Indirect", "Diffuse Color", "Glossy Direct", "Glossy Indirect",
          "Glossy Color", "Emission", "Environment")
_NOTHING_M = 0.99e10        # Cycles writes 1e10 where a ray meets nothing

# what is compared beside the picture: (light pass, colour pass) products that sum up to it
PARTS: dict[str, tuple[tuple[str, str], ...]] = {
    "direct": (("Diffuse Direct", "Diffuse Color"), ("Glossy Direct", "Glossy Color")),
    "direct diffuse": (("Diffuse Direct", "Diffuse Color"),),
    "direct glossy": (("Glossy Direct", "Glossy Color"),),
    "bounce": (("Diffuse Indirect", "Diffuse Color"),),
    "glossy bounce": (("Glossy Indirect", "Glossy Color"),),
}


@dataclass(frozen=True)
class Reference:
    """Two independent renders of one view.

    half_a, half_b: {pass name of `PASSES`: (H, W, C) float32, row 0 at the top}; `samples` a pixel of each half, 0 where
    a file does not tell; `source` the file that it was read from or is kept in, if there is one.
    """

    half_a: dict[str, np.ndarray]
    half_b: dict[str, np.ndarray]
    samples: int = 0
    source: str = ""

    @property
    def mask(self) -> np.ndarray:
        """(H, W) bool, True on surfaces."""
        return self.half_a["Depth"][..., 0] < _NOTHING_M

    @property
    def shape(self) -> tuple[int, int]:
        return self.half_a["Combined"].shape[:2]

    @property
    def albedo(self) -> np.ndarray:
        """(H, W, 3) float32 diffuse colour at the pixel centres."""
        return self.half_a["Diffuse Color"]

    def halves(self, what: str) -> tuple[np.ndarray, np.ndarray]:
        """The two halves of "picture" or of a part in `PARTS`, (H, W, 3) float32 radiance, colour included."""
        return self._of(self.half_a, what), self._of(self.half_b, what)

    def mean(self, what: str) -> np.ndarray:
        """Mean of the halves, (H, W, 3) float64."""
        a, b = self.halves(what)
        return (a.astype(np.float64) + b) / 2

    @staticmethod
    def _of(half: dict[str, np.ndarray], what: str) -> np.ndarray:
        if what == "picture":
            return half["Combined"][..., :3]
        return sum(half[light] * half[colour] for light, colour in PARTS[what])

    def joined(self, other: Reference) -> Reference:
        """The mean of two references of one view from other seeds, each half weighted by its samples."""
        total = self.samples + other.samples
        share = np.float32(other.samples / total)

        def mean(mine: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            return {name: mine[name] + share * (theirs[name] - mine[name]) for name in PASSES}

        return Reference(mean(self.half_a, other.half_a), mean(self.half_b, other.half_b), total)

    def save(self, path: Path) -> None:
        """Write an uncompressed .npz with keys such as "a|Diffuse Indirect"."""
        arrays = {f"{letter}|{name}": half[name]
                  for letter, half in (("a", self.half_a), ("b", self.half_b)) for name in PASSES}
        np.savez(path, samples=self.samples, **arrays)


def load_reference(path: Path, size: tuple[int, int] | None = None) -> Reference:
    """Read a reference; InputError if it is none or not of `size` (width, height) px."""
    if not path.is_file():
        raise InputError(f"there is no reference {path}; leave it out and Cycles renders one")
    try:
        with np.load(path) as data:
            halves = [{name: np.nan_to_num(data[f"{letter}|{name}"], posinf=0.0, neginf=0.0) for name in PASSES}
                      for letter in "ab"]
            samples = int(data["samples"]) if "samples" in data else 0
    except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is no reference with the passes of two halves: {error}") from error
    reference = Reference(*halves, samples)
    height, width = reference.shape
    if size is not None and (width, height) != tuple(size):
        raise InputError(f"the reference {path} is {width}x{height}, the picture {size[0]}x{size[1]}; choose the same size")
    return reference
