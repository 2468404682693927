"""The report of a comparison: one HTML page that needs no network and no other file, and the table as CSV.

What the page shows is data (`Shown`), so that it is made and tested without Blender.
"""

from __future__ import annotations

import base64
import csv
import io
import json
import string
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from . import pareto, plot
from .report import ERROR_SCALE, ERROR_WINDOW_PX, colour_table, error_map, percent, png_bytes
from .targets import slowest

MOST_PX = 960               # width of the pictures in the page: a page of 1920 px and twenty renders would be 80 MB
_NOISY = 0.5                # an error less than twice the noise in it is mostly noise
_KIND_COLOURS = {"rtgi": "var(--other)", "cycles": "var(--cycles)", "denoised": "var(--denoised)", "eevee": "var(--quiet)"}

# (key of a row's "errors" or of a part, heading, what it tells); as in the CSV and in the page
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("block", "picture",
     "Relative error of the picture: sum |T\u2212R| / sum R over blocks of 8\u00d78 px. Fine noise averages out in "
     "a block as it does to the eye, wrong light does not. The headline, and what the plot shows."),
    ("luminance_bias", "too bright",
     "Mean luminance against the reference, signed: +2 % is too bright. Blind to where."),
    ("block_after_scale", "after scale",
     "The picture's error after the one factor that fits it best. Where this is far lower than the error itself, "
     "only the brightness is wrong; where it is not, the light is in the wrong places."),
    ("block_95", "95 % below",
     "95 of 100 blocks have a smaller relative error than this: how bad the bad places are."),
    ("nrmse", "per pixel",
     "Root mean square error a pixel over the mean, freed of the reference's noise by multiplying the errors "
     "against its two halves; 0 where noise hides it. Fireflies beyond 20 means are cut."),
    ("relmse", "relMSE",
     "Squared relative error a pixel, each pixel against the reference around it, freed of the reference's noise "
     "in the same way. Dark places count as much as bright ones."),
    ("ssim", "SSIM",
     "Structural similarity of the displayed pictures: 1 is the same. Hardly sees brightness."),
    ("flip", "FLIP",
     "What the eye sees between the displayed pictures, 0 to 1. Harder on brightness than on noise."),
)
PART_COLUMNS = ("direct", "bounce", "glossy bounce")
_PLAIN = ("relmse", "ssim", "flip")      # shown as numbers, the others in percent
_SIGNED = ("luminance_bias",)


@dataclass(frozen=True)
class Shown:
    """One render in the report.

    kind: "rtgi", "cycles", "denoised" or "eevee"; errors: as `measure.errors_of` gives them; display: (H, W, 3) uint8;
    linear: (H, W, 3 or 4); report: of RTGI's renders, with "stages".
    """

    name: str
    kind: str
    seconds: float
    errors: dict[str, Any]
    display: np.ndarray
    linear: np.ndarray
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def curve(self) -> str:
        """The renderer whose quality setting this is, "" for one that stands alone."""
        return {"cycles": "Cycles", "denoised": "Cycles + denoiser"}.get(self.kind, "")

    @property
    def point(self) -> pareto.Point:
        return pareto.Point(self.name, self.seconds, self.errors["picture"]["block"], self.curve)


def _small(pixels: np.ndarray) -> np.ndarray:
    """The picture, or means of whole squares of pixels so that it is at most `MOST_PX` wide."""
    step = -(-pixels.shape[1] // MOST_PX)
    height, width = (edge // step * step for edge in pixels.shape[:2])
    if step == 1 or not height:
        return pixels
    squares = pixels[:height, :width].reshape(height // step, step, width // step, step, 3)
    return squares.mean((1, 3)).round().astype(np.uint8)


def _uri(pixels: np.ndarray) -> str:
    return "data:image/png;base64," + base64.b64encode(png_bytes(_small(pixels))).decode("ascii")


def value_of(shown: Shown, key: str) -> float | None:
    """The number of a column of `COLUMNS` or `PART_COLUMNS`; None where there is none."""
    if key in PART_COLUMNS:
        return shown.errors.get(key, {}).get("block")
    return shown.errors["picture"].get(key)


def _text(key: str, value: float | None) -> str:
    if value is None:
        return "-"
    if key in _PLAIN:
        return f"{value:.4f}" if value >= 1e-4 or value == 0 else f"{value:.0e}"
    return ("+" if key in _SIGNED and value > 0 else "") + percent(value)


def _columns(rows: Sequence[Shown]) -> list[tuple[str, str]]:
    """(key, heading) of the columns that any row has a number for."""
    wanted = [(key, head) for key, head, _ in COLUMNS] + [(part, part) for part in PART_COLUMNS]
    return [(key, head) for key, head in wanted if any(value_of(row, key) is not None for row in rows)]


def _table(rows: Sequence[Shown], noise: dict[str, float], floors: dict[str, float]) -> str:
    columns = _columns(rows)
    heads = "".join(f'<th scope="col"><button type="button">{escape(head)}</button></th>'
                    for head in ("render", "seconds", *(head for _, head in columns)))
    lines = []
    for row in rows:
        cells = [f'<td data-value="{escape(row.name)}"><span class="dot" style="background:{_colour(row, rows)}"></span>'
                 f'{escape(row.name)}</td><td data-value="{row.seconds!r}">{row.seconds:.2f}</td>']
        for key, _ in columns:
            value = value_of(row, key)
            cells.append(f'<td data-value="{"" if value is None else repr(float(value))}">{escape(_text(key, value))}</td>')
        lines.append(f'<tr data-name="{escape(row.name)}">{"".join(cells)}</tr>')
    floor = "".join(f"<td>{escape(_text(key, floors.get(key, noise.get(key))))}</td>" for key, _ in columns)
    return (f"<thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody>"
            f"<tfoot><tr><td>noise of the reference</td><td></td>{floor}</tr></tfoot>")


def _colour(row: Shown, rows: Sequence[Shown]) -> str:
    return "var(--own)" if row is rows[0] else _KIND_COLOURS[row.kind]


def csv_text(rows: Sequence[Shown]) -> str:
    """The table as CSV: one line a render, plain numbers (0.02 is 2 %), empty where there is none."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    keys = [key for key, _, _ in COLUMNS]
    writer.writerow(["render", "kind", "seconds", *keys, "best_scale", "energy",
                     *(f"{part} block" for part in PART_COLUMNS)])
    for row in rows:
        values = [value_of(row, key) for key in (*keys, "best_scale", "energy", *PART_COLUMNS)]
        writer.writerow([row.name, row.kind, row.seconds, *("" if value is None else value for value in values)])
    return out.getvalue()


def plot_of(rows: Sequence[Shown], floors: dict[str, float]) -> str:
    """SVG of speed against the picture's error, the first row standing out; "" where there is no matplotlib to draw it."""
    return plot.speed_error_svg([row.point for row in rows], rows[0].name, floors.get("block"))


def crossing_words(rows: Sequence[Shown]) -> list[str]:
    """The Pareto front and where Cycles crosses the first row, in sentences."""
    return pareto.words(rows[0].point, [row.point for row in rows])


def summary_words(rows: Sequence[Shown], noise: dict[str, float]) -> list[str]:
    """What a hurried reader needs: time and error of the first row, what is wrong with it, whether the reference will do."""
    own = rows[0]
    errors = own.errors["picture"]
    block, bias, left = errors["block"], errors["luminance_bias"], errors["block_after_scale"]
    said = [f"{own.name} renders this view in {own.seconds:.2f} s with a picture error of {percent(block)}."]
    bright = "too bright" if bias > 0 else "too dark"
    of_it = ("most of the error is that: the right brightness alone would leave " if left < 0.5 * block else
             "the rest is light in the wrong places: the right brightness alone would leave ")
    said.append(f"Over all it is {percent(abs(bias))} {bright}; {of_it}{percent(left)}.")
    parts = [(own.errors[part]["of_picture"], part) for part in PART_COLUMNS if "of_picture" in own.errors.get(part, {})]
    if parts:
        worst, part = max(parts)
        name = "direct light" if part == "direct" else part
        said.append(f"Of the kinds of light the {name} is off most, by {percent(worst)} of the picture's light.")
    stages = {stage["name"]: stage["ms"] for stage in own.report.get("stages", ())}
    if stages:
        said.append(f"Of its time most goes to {slowest(stages, 1e3 * own.seconds).replace(', ', ' and ')}.")
    if noise["picture"] > _NOISY * block:
        said.append(f"The reference's own noise, {percent(noise['picture'])}, is a large part of these errors: more samples "
                    "(--samples, --noise) tell more.")
    return said


def _plan(report: dict[str, Any]) -> str:
    plan = report.get("plan", {})
    ran = ", ".join(escape(item["label"]) for item in plan.get("runs", ()))
    left = "".join(f"<li>{escape(item['what'])}: {escape(item['why'])}.</li>" for item in plan.get("left_out", ()))
    budget = "".join(f"<li>{escape(text)}.</li>" for text in plan.get("budget", ()))
    warned = "".join(f"<li>{escape(text)}</li>" for text in report.get("warnings", ()))
    return ((f"<p>In this order: {ran}.</p>" if ran else "") + (f"<p>Left out:</p><ul>{left}</ul>" if left else "")
            + (f"<p>Chosen by the budget:</p><ul>{budget}</ul>" if budget else "")
            + (f"<p>Warnings:</p><ul>{warned}</ul>" if warned else ""))


def _paragraphs(sentences: Sequence[str]) -> str:
    return "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)


def html_page(title: str, facts: Sequence[str], rows: Sequence[Shown], reference_words: str, reference_display: np.ndarray,
              reference_linear: np.ndarray, noise: dict[str, float], floors: dict[str, float],
              notes: Sequence[str] = ()) -> str:
    """The page's text.

    Parameters
    ----------
    facts : short phrases under the title, such as size and versions.
    rows : the renders; the first is the one that the page is about.
    reference_words : such as "two halves of 64 samples".
    reference_display, reference_linear : the reference as (H, W, 3) uint8 and (H, W, 3) linear.
    noise, floors : as `measure.noise_of` and `measure.floors_of` give them.
    notes : sentences about what was not measured and why.
    """
    pictures = [{"name": "reference", "picture": _uri(reference_display), "error": ""}]
    pictures += [{"name": row.name, "picture": _uri(row.display), "error": _uri(error_map(row.linear, reference_linear))}
                 for row in rows]
    stages = {row.name: row.report["stages"] for row in rows if row.report.get("stages")}
    table = colour_table()[None]
    has = {key for key, _ in _columns(rows)}
    glossary = [(head, doc) for key, head, doc in COLUMNS if key in has]
    glossary.append((", ".join(part for part in PART_COLUMNS if part in has),
                     "The same error of one kind of light alone, over that light. Errors of parts may cancel in the "
                     "picture."))
    glossary.append(("noise of the reference", "What the reference's own noise makes of a perfect picture (picture, parts), "
                     "or is by itself (per pixel, relMSE: taken out of the errors already). An error below it says little."))
    template = string.Template(Path(__file__).with_name("page_template.html").read_text(encoding="utf-8"))
    # a "<" in a name could end the script element that holds the data
    data = json.dumps({"pictures": pictures, "stages": stages}).replace("<", "\\u003c")
    return template.substitute(
        title=escape(title), facts=" &middot; ".join(map(escape, facts)), summary=_paragraphs(summary_words(rows, noise)),
        scale=percent(ERROR_SCALE).replace(".0", ""), window=ERROR_WINDOW_PX,
        colour_bar=_uri(np.repeat(table, 4, 0)), table=_table(rows, noise, floors), reference=escape(reference_words),
        notes=_paragraphs(notes), crossing=_paragraphs(crossing_words(rows)),
        plot=plot_of(rows, floors) if plot.available() else _paragraphs([plot.MISSING]),
        plan=_plan(rows[0].report), data=data,
        glossary="\n".join(f"<dt>{escape(head)}</dt><dd>{escape(doc)}</dd>" for head, doc in glossary))
