"""Plots as SVG, all axes in logarithms: speed against error with the Pareto front, and time against amount of work.

Colours are CSS variables with a value to fall back to, so that the picture follows the page that it stands in and can be
opened alone. Points are told apart by shape as well as by colour.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from html import escape

from .pareto import Point, pareto_front

_WIDTH, _HEIGHT = 900, 480
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 20, 16, 52
_TICKS = (1, 2, 5)
_CURVE_COLOURS = ("var(--cycles, #c2571a)", "var(--denoised, #1c7c54)")
_CURVE_SHAPES = ("square", "diamond")
_OWN = "var(--own, #2a5bd7)"
_OTHER = "var(--other, #7b6fa8)"
_INK, _FAINT = "var(--ink, #222)", "var(--line, #ccc)"
_HALO = 'stroke="var(--card, #fff)" stroke-width="3" paint-order="stroke" stroke-linejoin="round"'
_LABEL_PX = 7.6             # width of a letter of the labels, a generous mean


class _Axis:
    """A logarithmic axis: values to px, with room of a fifth of a decade at its ends at least."""

    def __init__(self, values: Sequence[float], start: float, end: float) -> None:
        low, high = math.log10(min(values)), math.log10(max(values))
        room = max(0.15, 0.08 * (high - low))
        self.low, self.high, self.start, self.end = low - room, high + room, start, end

    def __call__(self, value: float) -> float:
        return self.start + (math.log10(value) - self.low) / (self.high - self.low) * (self.end - self.start)

    def ticks(self) -> list[float]:
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        found = [step * 10.0**decade for decade in decades for step in _TICKS]
        return [value for value in found if self.low <= math.log10(value) <= self.high]


def _paper(title: str, x: _Axis, y: _Axis, x_title: str, y_title: str, y_text: Callable[[float], str]) -> list[str]:
    """The head of a plot: its ground, grid, numbers and the axes' names."""
    right = x.end
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" font-size="13" '
             f'font-family="system-ui, sans-serif"><title>{escape(title)}</title>'
             f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="var(--card, #fff)"/>']
    for value in x.ticks():
        parts.append(f'<path d="M{x(value):.1f} {_TOP}V{_HEIGHT - _BOTTOM}" stroke="{_FAINT}" fill="none"/>'
                     f'<text x="{x(value):.1f}" y="{_HEIGHT - _BOTTOM + 18}" text-anchor="middle" fill="{_INK}">'
                     f'{_short(value)}</text>')
    for value in y.ticks():
        parts.append(f'<path d="M{_LEFT} {y(value):.1f}H{right}" stroke="{_FAINT}" fill="none"/>'
                     f'<text x="{_LEFT - 8}" y="{y(value) + 4:.1f}" text-anchor="end" fill="{_INK}">{y_text(value)}</text>')
    parts.append(f'<text x="{(_LEFT + right) / 2}" y="{_HEIGHT - 10}" text-anchor="middle" fill="{_INK}">'
                 f'{escape(x_title)}</text>'
                 f'<text transform="translate(16 {(_TOP + _HEIGHT - _BOTTOM) / 2}) rotate(-90)" text-anchor="middle" '
                 f'fill="{_INK}">{escape(y_title)}</text>')
    return parts


def _short(value: float) -> str:
    """A number on an axis: 200000 is 200k."""
    for unit, sign in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:g}{sign}"
    return f"{value:g}"


def _marker(shape: str, x: float, y: float, colour: str, title: str) -> str:
    if shape == "square":
        body = f'<rect x="{x - 5:.1f}" y="{y - 5:.1f}" width="10" height="10"'
    elif shape == "diamond":
        body = f'<path d="M{x:.1f} {y - 7:.1f}l7 7-7 7-7-7z"'
    elif shape == "star":
        corners = [(x + r * math.sin(math.pi * i / 5), y - r * math.cos(math.pi * i / 5))
                   for i in range(10) for r in [10 if i % 2 == 0 else 4.5]]
        body = '<polygon points="' + " ".join(f"{px:.1f},{py:.1f}" for px, py in corners) + '"'
    else:
        body = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5.5"'
    return f'{body} fill="{colour}"><title>{escape(title)}</title></{body[1:].split()[0]}>'


def _label(point: Point) -> str:
    """What stands beside a point: of a curve only its setting, since the legend names the curve."""
    return point.name.removeprefix("Cycles ").removesuffix(" + denoiser") if point.curve else point.name


def _placed(wanted: Sequence[tuple[float, float, str]], taken: list[tuple[float, float, float, float]]) -> list[str]:
    """Labels beside their points, each at the first of eight places where it covers no other; else it is left out."""
    parts = []
    for x, y, text in wanted:
        width = _LABEL_PX * len(text)
        for dx, dy in ((8, -9), (-8 - width, 18), (8, 18), (-8 - width, -9), (-width / 2, -11), (-width / 2, 20), (10, 4),
                       (-10 - width, 4)):
            box = (x + dx, y + dy - 11, x + dx + width, y + dy + 3)
            inside = box[0] >= _LEFT and box[2] <= _WIDTH - _RIGHT and box[1] >= _TOP and box[3] <= _HEIGHT - _BOTTOM
            if inside and all(box[2] < b[0] or box[0] > b[2] or box[3] < b[1] or box[1] > b[3] for b in taken):
                taken.append(box)
                parts.append(f'<text x="{x + dx:.1f}" y="{y + dy:.1f}" fill="{_INK}" {_HALO}>{escape(text)}</text>')
                break
    return parts


def speed_error_svg(points: Sequence[Point], own: str, noise: float | None = None) -> str:
    """SVG text. `own` names the point that stands out; `noise` is the error that the reference's own noise gives."""
    shown = [p for p in points if p.seconds > 0 and p.error > 0]
    if not shown:
        return ""
    errors = [p.error for p in shown] + ([noise] if noise else [])
    curves = list(dict.fromkeys(p.curve for p in shown if p.curve))
    below_legend = _TOP + 20 * (len(curves) + 1)
    x, y = _Axis([p.seconds for p in shown], _LEFT, _WIDTH - _RIGHT), _Axis(errors, _HEIGHT - _BOTTOM, below_legend)
    parts = _paper("Speed against error", x, y, "seconds a frame", "error of the picture", lambda e: f"{100 * e:g} %")
    taken: list[tuple[float, float, float, float]] = []
    if noise:
        parts.append(f'<path d="M{_LEFT} {y(noise):.1f}H{_WIDTH - _RIGHT}" stroke="{_INK}" stroke-dasharray="2 4"/>'
                     f'<text x="{_LEFT + 6}" y="{y(noise) - 5:.1f}" fill="{_INK}">noise of the reference</text>')
        taken.append((_LEFT, y(noise) - 18, _LEFT + 150, y(noise)))
    front = pareto_front(shown)
    path = "H".join([f"M{x(front[0].seconds):.1f} {y(front[0].error):.1f}",
                     *(f"{x(p.seconds):.1f}V{y(p.error):.1f}" for p in front[1:])])
    parts.append(f'<path d="{path}H{_WIDTH - _RIGHT}" stroke="{_INK}" stroke-opacity=".35" stroke-width="6" fill="none"/>')
    wanted = []
    for number, name in enumerate(curves):
        line = sorted((p for p in shown if p.curve == name), key=lambda p: p.seconds)
        colour = _CURVE_COLOURS[number % 2]
        parts.append(f'<polyline points="{" ".join(f"{x(p.seconds):.1f},{y(p.error):.1f}" for p in line)}" fill="none" '
                     f'stroke="{colour}" stroke-width="2"/>')
    for point in sorted(shown, key=lambda p: p.name == own):      # the own one lies on top
        at = x(point.seconds), y(point.error)
        if point.curve:
            number = curves.index(point.curve) % 2
            shape, colour = _CURVE_SHAPES[number], _CURVE_COLOURS[number]
        else:
            shape, colour = ("star", _OWN) if point.name == own else ("circle", _OTHER)
        parts.append(_marker(shape, *at, colour, f"{point.name}: {point.seconds:.3g} s, {100 * point.error:.3g} %"))
        taken.append((at[0] - 7, at[1] - 7, at[0] + 7, at[1] + 7))
        wanted.insert(0 if point.name == own else len(wanted), (*at, _label(point)))
    for number, name in enumerate([*curves, "Pareto front"]):
        row = _TOP + 14 + 20 * number
        if name in curves:
            parts.append(_marker(_CURVE_SHAPES[number % 2], _WIDTH - 285, row, _CURVE_COLOURS[number % 2], name))
        else:
            parts.append(f'<path d="M{_WIDTH - 295} {row}h20" stroke="{_INK}" stroke-opacity=".35" stroke-width="6"/>')
        said = f"{name}, samples beside it" if name in curves else name
        parts.append(f'<text x="{_WIDTH - 270}" y="{row + 4}" fill="{_INK}" {_HALO}>{escape(said)}</text>')
    taken.append((_WIDTH - 300, _TOP, _WIDTH, below_legend))
    parts += _placed(wanted, taken)
    return "\n".join([*parts, "</svg>"])


# ---- time against work ----

_SERIES_COLOURS = ("var(--ink, #222)", "#2a5bd7", "#c2571a", "#1c7c54", "#a03a8c", "#8a7a00", "#0f8296", "#b03030")
_MOST_SERIES = len(_SERIES_COLOURS)
_NAMES_PX = 210             # room at the right for the names of the lines
_NAME_STEP_PX = 17


def cost_svg(title: str, work_title: str, work: Sequence[float], series: Mapping[str, Sequence[float]]) -> str:
    """SVG text of times in ms against work, a line a name; "" without two amounts of work and a time above zero.

    The first of `series` is the one that stands out, and its ends are joined to a dotted line of proportional growth. Of
    the others those with the longest times are drawn.
    """
    shown = {name: ms for name, ms in series.items() if min(ms) > 0}
    names = [*list(shown)[:1], *sorted(list(shown)[1:], key=lambda name: -max(shown[name]))][:_MOST_SERIES]
    if not names or len(set(work)) < 2:
        return ""
    right = _WIDTH - _NAMES_PX
    x, y = _Axis(work, _LEFT, right), _Axis([ms for name in names for ms in shown[name]], _HEIGHT - _BOTTOM, _TOP)
    parts = _paper(title, x, y, work_title, "ms a frame", _short)
    start = shown[names[0]][0]
    parts.append(f'<clipPath id="area"><path d="M{_LEFT} {_TOP}H{right}V{_HEIGHT - _BOTTOM}H{_LEFT}z"/></clipPath>'
                 f'<path clip-path="url(#area)" d="M{x(work[0]):.1f} {y(start):.1f}L{x(work[-1]):.1f} '
                 f'{y(start * work[-1] / work[0]):.1f}" stroke="{_INK}" stroke-dasharray="2 4" fill="none"/>')
    rows = _spread([y(shown[name][-1]) for name in names])
    for number, name in enumerate(names):
        colour = _SERIES_COLOURS[number]
        corners = [(x(w), y(ms)) for w, ms in zip(work, shown[name], strict=True)]
        parts.append(f'<polyline points="{" ".join(f"{px:.1f},{py:.1f}" for px, py in corners)}" fill="none" '
                     f'stroke="{colour}" stroke-width="{3 if number == 0 else 1.6}"/>')
        for corner, w, ms in zip(corners, work, shown[name], strict=True):
            parts.append(f'<circle cx="{corner[0]:.1f}" cy="{corner[1]:.1f}" r="3.5" fill="{colour}">'
                         f'<title>{escape(name)}: {ms:.3g} ms at {w:g}</title></circle>')
        parts.append(f'<path d="M{corners[-1][0] + 6:.1f} {corners[-1][1]:.1f}L{right + 4} {rows[number]:.1f}" '
                     f'stroke="{colour}" stroke-opacity=".4" fill="none"/>'
                     f'<text x="{right + 8}" y="{rows[number] + 4:.1f}" fill="{colour}">{escape(name)}</text>')
    return "\n".join([*parts, "</svg>"])


def _spread(rows: Sequence[float]) -> list[float]:
    """Rows for names beside the ends of lines: as near as they can be without covering each other, within the plot."""
    placed = [0.0] * len(rows)
    before = -math.inf
    for i in sorted(range(len(rows)), key=lambda i: rows[i]):
        before = placed[i] = max(rows[i], before + _NAME_STEP_PX)
    beyond = max(0.0, max(placed) - (_HEIGHT - _BOTTOM))
    return [row - beyond for row in placed] if beyond else placed
