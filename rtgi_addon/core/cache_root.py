"""Where compiled kernels and references are kept: chosen at registration, read when needed. Imports no numba."""

from __future__ import annotations

import os
from pathlib import Path

_root: Path | None = None


def set_cache_root(root: str | os.PathLike | None) -> None:
    """Keep kernels under `root` (None: the user's own cache); call it before the first kernel is loaded."""
    global _root
    _root = None if root is None else Path(root)


def cache_root() -> Path:
    """$NUMBA_CACHE_DIR where set, else the root that was set, else the user's cache folder; it need not exist yet."""
    if from_environment := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(from_environment)
    if _root is not None:
        return _root
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "rtgi" / "numba"


def references_root() -> Path:
    """Where references by Cycles are kept, in the cache folder, so that an extension may write to it; need not exist yet."""
    return cache_root() / "references"
