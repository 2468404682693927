"""Pictures and tables of a comparison: RTGI, the reference and the error map side by side, as PNG; text tables.

Nothing here knows Blender: text is drawn by a function that the caller hands in, pictures come in display values.
"""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..imageio import replacing
from .metrics import DARK, luminance_of, window_sums

ERROR_SCALE = 0.5           # relative error at the top of the error map's scale
ERROR_WINDOW_PX = 5
_GAP_PX = 6
_BACKGROUND = 24
# OKLab to linear sRGB (Ottosson 2020)
_LMS_FROM_LAB = np.array([[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728],
                          [1, -0.0894841775, -1.2914855480]])
_RGB_FROM_LMS = np.array([[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965],
                          [-0.0041960863, -0.7034186147, 1.7076147010]])

TextDrawer = Callable[[str, int], np.ndarray]


def png_bytes(pixels: np.ndarray) -> bytes:
    """(H, W, 3) uint8 sRGB, row 0 at the top, as a PNG file."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise InputError(f"a PNG needs (H, W, 3) uint8, got {pixels.shape} {pixels.dtype}")
    height, width = pixels.shape[:2]

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = np.zeros((height, 1 + 3 * width), np.uint8)           # each row starts with filter 0
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6))
            + chunk(b"IEND", b""))


def write_picture(path: Path, pixels: np.ndarray) -> None:
    """Write (H, W, 3) uint8 as PNG."""
    with replacing(path) as partial:
        partial.write_bytes(png_bytes(pixels))


@functools.cache
def colour_table() -> np.ndarray:
    """(256, 3) uint8 from dark blue over magenta to light yellow: lightness rises evenly, so that order is seen without hue.

    A spiral in OKLCh: lightness 0.16 to 0.95, hue 270 to 465 degrees, chroma that fits the gamut at both ends.
    """
    t = np.linspace(0, 1, 256)
    lightness, hue = 0.16 + 0.79 * t, np.radians(270 + 195 * t)
    chroma = 0.05 + 0.13 * np.maximum(np.sin(np.pi * t), 0) ** 0.8
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], -1)
    linear = np.clip((lab @ _LMS_FROM_LAB.T) ** 3 @ _RGB_FROM_LMS.T, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(encoded * 255).astype(np.uint8)


def _window_means(image: np.ndarray, size: int) -> np.ndarray:
    """Means of (H, W) over the odd window of `size` px around each pixel, cut at the edges."""
    return window_sums(image, size) / window_sums(np.ones_like(image), size)


def relative_error(test: np.ndarray, reference: np.ndarray, window_px: int = ERROR_WINDOW_PX) -> np.ndarray:
    """(H, W) float64 |T - R| / max(R, a tenth of the mean R) of the luminance, T - R and R being means over a small window.

    The window takes out most of the reference's noise, which would else be all that the map shows. InputError for a value
    that is not finite: it would blacken a window, or look like no error.
    """
    if not (np.isfinite(test[..., :3]).all() and np.isfinite(reference[..., :3]).all()):
        raise InputError("a picture with values that are not finite has no error map")
    t, r = (luminance_of(np.asarray(image, np.float64)[..., :3]) for image in (test, reference))
    floor = DARK * r.mean()
    return np.abs(_window_means(t - r, window_px)) / np.maximum(_window_means(r, window_px), floor if floor > 0 else 1.0)


def error_map(test: np.ndarray, reference: np.ndarray, scale: float = ERROR_SCALE) -> np.ndarray:
    """(H, W, 3) uint8 colours of `relative_error`, the top colour from `scale` on."""
    return colour_table()[np.round(np.clip(relative_error(test, reference) / scale, 0, 1) * 255).astype(np.intp)]


def _stamp(canvas: np.ndarray, coverage: np.ndarray, row: int, column: int, most_px: int) -> None:
    """Blend white text into the canvas; what does not fit in `most_px` is cut."""
    coverage = coverage[:max(canvas.shape[0] - row, 0), :max(min(most_px, canvas.shape[1] - column), 0), None]
    part = canvas[row:row + coverage.shape[0], column:column + coverage.shape[1]]
    part[:] = np.round(part + (255 - part.astype(np.float32)) * coverage).astype(np.uint8)


def side_by_side(panels: Sequence[tuple[str, str, np.ndarray]], scale: float, draw: TextDrawer | None = None) -> np.ndarray:
    """One picture (H, W, 3) uint8 of panels in a row; the last is an error map and gets its scale below.

    Parameters
    ----------
    panels : (title, foot, (h, w, 3) uint8) each; all of one size.
    scale : float
        Relative error at the right end of the scale.
    draw : function of (text, height in px) giving (h, w) coverage in [0, 1], optional
        Without it there are no words in the picture.
    """
    sizes = {panel.shape for _, _, panel in panels}
    if len(sizes) != 1:
        raise InputError(f"the panels must be of one size, got {sorted(sizes)}")
    height, width = panels[0][2].shape[:2]
    line = min(max(14, height // 20), 40)
    top, bottom = line + 2 * _GAP_PX, line + 2 * _GAP_PX
    canvas = np.full((top + height + bottom, len(panels) * (width + _GAP_PX) + _GAP_PX, 3), _BACKGROUND, np.uint8)
    for number, (title, foot, panel) in enumerate(panels):
        left = _GAP_PX + number * (width + _GAP_PX)
        canvas[top:top + height, left:left + width] = panel
        if draw is not None:
            _stamp(canvas, draw(title, line), _GAP_PX, left, width)
            if number < len(panels) - 1:
                _stamp(canvas, draw(foot, line), top + height + _GAP_PX, left, width)
    _draw_scale(canvas, top + height + _GAP_PX, left, width, line, scale, draw)
    return canvas


def _draw_scale(canvas: np.ndarray, row: int, left: int, width: int, line: int, scale: float,
                draw: TextDrawer | None) -> None:
    """The colour table from 0 to `scale`, with its ends written at its sides."""
    low = high = np.zeros((line, 0), np.float32)
    if draw is not None:
        low, high = draw("0 ", line), draw(f" {100 * scale:g} % and more", line)
    if low.shape[1] + high.shape[1] > 3 * width // 4:            # a small picture: the bar alone
        low = high = np.zeros((line, 0), np.float32)
    bar = width - low.shape[1] - high.shape[1]
    _stamp(canvas, low, row, left, width)
    table = colour_table()[np.linspace(0, 255, bar).round().astype(np.intp)]
    canvas[row + line // 5:row + line - line // 5, left + low.shape[1]:left + low.shape[1] + bar] = table
    _stamp(canvas, high, row, left + low.shape[1] + bar, width - low.shape[1] - bar)


def percent(value: float | None) -> str:
    """0.0123 as "1.23 %", None as "-"; three digits that count."""
    if value is None:
        return "-"
    shown = 100 * value
    return f"{shown:.2f} %" if abs(shown) < 10 else f"{shown:.1f} %" if abs(shown) < 100 else f"{shown:.0f} %"


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], markdown: bool = False) -> str:
    """Aligned columns, the first to the left and the others to the right."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = [cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(cells, widths, strict=True))]
        return "| " + " | ".join(padded) + " |" if markdown else "  ".join(padded).rstrip()

    rule = "| " + " | ".join("-" * w if i == 0 else "-" * (w - 1) + ":" for i, w in enumerate(widths)) + " |"
    return "\n".join([line(head), rule if markdown else "  ".join("-" * w for w in widths), *(line(row) for row in rows)])
