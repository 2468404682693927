"""The report's page is whole by itself, shows what it was given and says it in words; the CSV holds the same numbers."""

import base64
import csv
import io
import json
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from rtgi_addon.compare import page, plot
from rtgi_addon.compare.page import Shown

SIZE = (12, 20)
NOISE, FLOORS = {"picture": 0.004, "bounce": 0.01}, {"block": 0.004, "nrmse": 0.1, "relmse": 0.02}
PLAN = {"runs": [{"technique": "rsm", "label": "Reflective Shadow Maps"}],
        "left_out": [{"what": "Screen-Space Reflections", "why": "no pixel is <glossy>"}]}


def errors(block=0.02, bias=0.001, after=0.019, bounce=0.06):
    return {"picture": {"block": block, "nrmse": 0.05, "relmse": 0.003, "block_95": 0.08, "energy": 1 + bias,
                        "luminance_bias": bias, "best_scale": 1 - bias, "block_after_scale": after, "ssim": 0.97},
            "direct": {"of_picture": 0.001, "block": 0.002}, "bounce": {"of_picture": 0.018, "block": bounce}}


def shown(name, kind="rtgi", seconds=0.5, found=None, report=None):
    rng = np.random.default_rng(len(name))
    display = rng.integers(0, 256, (*SIZE, 3), np.uint8)
    return Shown(name, kind, seconds, found or errors(), display, display / 255, report or {})


@pytest.fixture
def rows():
    stages = [{"name": "camera view", "ms": 60.0}, {"name": "rsm", "ms": 90.0}]
    peers = [shown(f"Cycles {n} + denoiser", "denoised", 0.6 * n, {"picture": errors(0.05 / n)["picture"]}) for n in (1, 4)]
    return [shown("RTGI", report={"stages": stages, "plan": PLAN, "warnings": ["one lamp is odd"]}),
            shown("</script><b>odd</b>", seconds=0.4), *peers]


def page_of(rows):
    return page.html_page("box & hall", ["20x12 px"], rows, "two halves of 64 samples", rows[0].display, rows[0].linear,
                          NOISE, FLOORS, ["EEVEE is left out."])


@pytest.fixture
def text(rows):
    return page_of(rows)


class Parsed(HTMLParser):
    """Tags with attributes in order, text by tag, and whether what was opened was closed."""

    VOID = {"meta", "img", "input", "link", "br"}

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.text = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append((self.open[-1] if self.open else "", data))


def data_of(text):
    start = text.index('type="application/json">') + len('type="application/json">')
    return json.loads(text[start:text.index("</script>", start)])


def test_every_element_of_the_page_is_closed_in_order(text):
    assert Parsed(text).open == []


def test_page_needs_no_other_file_and_no_network(text):
    for tag, attributes in Parsed(text).tags:
        assert tag not in {"link", "iframe", "object"}
        for name in ("src", "href", "srcset", "data"):
            assert attributes.get(name, "data:").startswith(("data:", "#"))
    assert re.search(r"url\((?!#)", text) is None and "@import" not in text and "fetch(" not in text


def test_page_holds_each_picture_and_its_error_map(text, rows):
    pictures = data_of(text)["pictures"]
    assert [p["name"] for p in pictures] == ["reference", *(row.name for row in rows)]
    for picture in pictures[1:]:
        for uri in (picture["picture"], picture["error"]):
            head, _, encoded = uri.partition(",")
            assert head == "data:image/png;base64" and base64.b64decode(encoded).startswith(b"\x89PNG")


def test_a_name_that_looks_like_markup_is_text(text):
    assert "<b>odd" not in text and "&lt;glossy&gt;" in text
    assert data_of(text)["pictures"][2]["name"] == "</script><b>odd</b>"


def test_table_has_a_row_for_each_render_with_numbers_to_sort_by(text, rows):
    tags = Parsed(text).tags
    assert [a["data-name"] for tag, a in tags if tag == "tr" and "data-name" in a] == [row.name for row in rows]
    values = [a["data-value"] for tag, a in tags if tag == "td" and "data-value" in a]
    assert "0.02" in values and "" in values                 # peers have no bounce of their own


def test_page_says_what_ran_what_was_left_out_and_why(text):
    said = " ".join(data for _, data in Parsed(text).text)
    assert "Reflective Shadow Maps" in said and "Screen-Space Reflections: no pixel is <glossy>." in said
    assert "one lamp is odd" in said and "EEVEE is left out." in said


def test_page_names_the_crossing_with_cycles(text):
    said = " ".join(data for _, data in Parsed(text).text)
    assert "On the Pareto front" in said and "Cycles + denoiser comes down to RTGI's error of 2 %" in said


def test_page_shows_the_plot(text):
    assert text.count("<svg") == 1 and "Cycles + denoiser at equal error" in text and plot.MISSING not in text


def test_page_without_matplotlib_has_all_but_the_plot_and_says_so(rows, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    text = page_of(rows)
    parsed = Parsed(text)
    assert parsed.open == [] and "<svg" not in text
    assert [data for _, data in parsed.text].count(plot.MISSING) == 1
    assert [a["data-name"] for tag, a in parsed.tags if tag == "tr" and "data-name" in a] == [row.name for row in rows]
    assert len(data_of(text)["pictures"]) == 1 + len(rows) and "On the Pareto front" in text


def test_stages_of_the_renders_that_have_them_are_in_the_page(text):
    assert data_of(text)["stages"] == {"RTGI": [{"name": "camera view", "ms": 60.0}, {"name": "rsm", "ms": 90.0}]}


def test_every_column_of_the_table_is_explained(text):
    parsed = Parsed(text)
    heads = {data for tag, data in parsed.text if tag == "button"} - {"render", "seconds"}
    explained = {word.strip() for tag, data in parsed.text if tag == "dt" for word in data.split(",")}
    assert heads and heads <= explained


def test_a_column_without_numbers_is_left_out(text):
    assert "FLIP" not in text


def test_wide_pictures_are_made_smaller_for_the_page():
    wide = np.zeros((1080, 1920, 3), np.uint8)
    wide[:, 960:] = 200
    small = page._small(wide)
    assert small.shape == (540, 960, 3) and not small[:, :480].any() and (small[:, 480:] == 200).all()


@pytest.mark.parametrize(("found", "said"), [
    (errors(0.1, 0.1, 0.01), "10.0 % too bright; most of the error is that"),
    (errors(0.1, -0.02, 0.09), "2.00 % too dark; the rest is light in the wrong places"),
    (errors(0.1), "the bounce is off most, by 1.80 %")])
def test_summary_says_what_is_wrong(found, said):
    assert said in " ".join(page.summary_words([shown("RTGI", found=found)], NOISE))


def test_summary_says_when_the_reference_is_too_noisy():
    assert "more samples" in page.summary_words([shown("RTGI", found=errors(0.005))], NOISE)[-1]
    assert "more samples" not in page.summary_words([shown("RTGI")], NOISE)[-1]


def test_csv_holds_the_numbers_of_the_table(rows):
    lines = list(csv.DictReader(io.StringIO(page.csv_text(rows))))
    assert [line["render"] for line in lines] == [row.name for row in rows]
    assert float(lines[0]["block"]) == 0.02 and float(lines[0]["bounce block"]) == 0.06 and lines[2]["bounce block"] == ""
