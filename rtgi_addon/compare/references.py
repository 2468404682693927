"""References for a scene: given as a file, kept from before, or rendered until their noise is low enough."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..imageio import replacing
from .halves import Reference, load_reference
from .measure import noise_of
from .progress import say

MOST_SAMPLES = 16384        # a half: a noise level that asks for more is not reached in an afternoon
KEPT_BYTES = 4e9            # of all references in the cache: about eighty at 640x360
_GROWTH = 8                 # one round may take this many times the samples so far: a first guess is a rough one
_MARGIN = 1.1               # samples beyond what the last round's noise asks for, since that noise is an estimate
_NEXT_SEEDS = 1000          # between rounds; far from the distance of the two halves' seeds


def until_quiet(render: Callable[[int, tuple[int, int]], Reference], noise: float, samples: int,
                seeds: tuple[int, int]) -> Reference:
    """A reference whose noise (block error of the picture that it gives a perfect render) is at most `noise`.

    Parameters
    ----------
    render : function of (samples, seeds) that renders two halves.
    noise : relative, such as 0.01.
    samples : of the first round; each further round adds what the noise so far asks for, as noise falls with their root.
    """
    if not 0 < noise < 1:
        raise InputError(f"the noise level must lie between 0 and 1 (100 %), got {noise:g}")
    found = render(samples, seeds)
    while (now := noise_of(found)["picture"]) > noise and found.samples < MOST_SAMPLES:
        wanted = math.ceil(found.samples * (now / noise) ** 2 * _MARGIN)
        more = min(wanted, found.samples * _GROWTH, MOST_SAMPLES) - found.samples
        seeds = (seeds[0] + _NEXT_SEEDS, seeds[1] + _NEXT_SEEDS)
        say(f"the reference's noise is {100 * now:.2f} % at 2 x {found.samples} samples; {more} more for {100 * noise:g} %")
        found = found.joined(render(more, seeds))
    return found


def name_of(stem: str, size: Sequence[int], *what: Any) -> str:
    """File name of a reference; `what` decides its picture, bytes and values whose repr is stable."""
    digest = hashlib.sha256()
    for part in what:
        data = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return f"{stem}_{size[0]}x{size[1]}_{digest.hexdigest()[:12]}.npz"


def keep(reference: Reference, path: Path, most_bytes: float = KEPT_BYTES) -> None:
    """Save a reference and remove those of the folder that were used longest ago while there is more than `most_bytes`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        reference.save(partial)
    others = sorted(path.parent.glob("*_*x*_*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
    total = 0
    for file in others:
        total += file.stat().st_size
        if total > most_bytes and file != path:
            file.unlink(missing_ok=True)


def reference_for(scene: Any, blend_path: Path | None, size: tuple[int, int], samples: int, cache: Path,
                  given: Path | None = None, noise: float | None = None) -> Reference:
    """A reference from file `given`, or `<scene>_<W>x<H>.npz` in folder `given`; else from the cache; else rendered.

    Kept under a hash of all that decides its picture: the .blend's bytes, frame, size, samples, noise level, seeds,
    Blender's version, and size and time of change of the files that the .blend links to. A file that is only open in
    Blender may have been changed since it was read, and is rendered anew.

    `source` of what comes back says where it is kept. With `noise`, `samples` is only where the first round starts.
    """
    from . import reference as blender

    stem = blend_path.stem if blend_path is not None else scene.name
    if given is not None:
        path = given / f"{stem}_{size[0]}x{size[1]}.npz" if given.is_dir() else given
        return dataclasses.replace(load_reference(path, size), source=str(path))
    kept = None
    if blend_path is not None:
        kept = cache / name_of(stem, size, blend_path.read_bytes(), scene.frame_current, size, samples, noise, blender.SEEDS,
                               blender.blender_version(), blender.linked_files())
        if kept.is_file():
            kept.touch()
            return dataclasses.replace(load_reference(kept, size), source=str(kept))
    say(f"{stem}: reference by Cycles, one bounce, 2 x {samples} samples, {size[0]}x{size[1]}")
    if noise is None:
        found = blender.render_reference(scene, samples, size)
    else:
        found = until_quiet(lambda count, seeds: blender.render_reference(scene, count, size, seeds=seeds), noise, samples,
                            blender.SEEDS)
    if kept is not None:
        keep(found, kept)
        found = dataclasses.replace(found, source=str(kept))
    return found
