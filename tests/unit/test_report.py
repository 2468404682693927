"""Pictures and tables of a comparison: the PNG is one, the error map shows the error, the tables say what was measured."""

import struct
import zlib

import numpy as np
import pytest

from rtgi_addon.compare import bench, report
from rtgi_addon.compare.halves import PARTS, PASSES, Reference
from rtgi_addon.compare.measure import errors_of, floors_of, noise_of, part_of, picture_errors
from rtgi_addon.errors import InputError
from rtgi_addon.passes.base import Transport
from rtgi_addon.pipeline import Result


def decoded(png):
    """(H, W, 3) uint8 of an unfiltered RGB PNG, by the format's own rules and nobody's library."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    at, data, size = 8, b"", None
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at:at + 8])
        body = png[at + 8:at + 8 + length]
        assert struct.unpack(">I", png[at + 8 + length:at + 12 + length])[0] == zlib.crc32(kind + body)
        if kind == b"IHDR":
            size = struct.unpack(">II", body[:8])
            assert body[8:] == bytes([8, 2, 0, 0, 0])
        data += body if kind == b"IDAT" else b""
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(size[1], 1 + 3 * size[0])
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(size[1], size[0], 3)


def luminance(colours):
    return (np.asarray(colours) / 255.0) ** 2.2 @ np.array([0.2126, 0.7152, 0.0722])


def test_png_holds_the_pixels(rng):
    pixels = rng.integers(0, 256, (5, 7, 3), np.uint8)
    assert np.array_equal(decoded(report.png_bytes(pixels)), pixels)


@pytest.mark.parametrize("pixels", [np.zeros((4, 4, 3)), np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4, 3), np.uint8)])
def test_png_refuses_what_it_cannot_hold(pixels):
    with pytest.raises(InputError, match="uint8"):
        report.png_bytes(pixels)


def test_written_picture_replaces_the_old_one(tmp_path):
    (tmp_path / "p.png").write_text("old")
    report.write_picture(tmp_path / "p.png", np.zeros((2, 2, 3), np.uint8))
    assert [p.name for p in tmp_path.iterdir()] == ["p.png"] and (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"


def test_colours_of_the_error_map_rise_in_lightness():
    steps = np.diff(luminance(report.colour_table()))
    # 8-bit rounding may make neighbours equal, never reverse the order
    assert steps.min() >= 0 and luminance(report.colour_table()[[0, -1]])[1] > 0.7


def test_relative_error_of_an_even_gain_is_the_gain():
    reference = np.full((20, 20, 3), 2.0)
    np.testing.assert_allclose(report.relative_error(1.1 * reference, reference), 0.1, rtol=1e-9)


def test_relative_error_forgets_noise_and_keeps_a_wrong_region(rng):
    reference = np.ones((40, 40, 3))
    noisy = 1 + 0.2 * rng.standard_normal((40, 40, 1)) * np.ones(3)
    wrong = reference.copy()
    wrong[:, 20:] = 1.3
    # noise of 0.2 averages to 0.2/5 over 25 pixels
    assert report.relative_error(noisy, reference).mean() < 0.05
    assert report.relative_error(wrong, reference)[:, 30].min() == pytest.approx(0.3)
    assert report.relative_error(wrong, reference)[:, :17].max() < 1e-12


def test_error_map_sees_two_percent_and_a_pixel_and_refuses_a_nan(rng):
    reference = rng.random((40, 60, 3)) + 0.2
    gain, shift = 1.02 * reference, np.roll(reference, 1, 1)
    assert report.relative_error(gain, reference).min() > 0.0199
    # windows of noise that differ by a row of pixels
    assert report.relative_error(shift, reference).mean() > 0.01
    for pair in ((gain, reference), (reference, gain)):
        pair[0][7, 3, 1] = np.nan
        with pytest.raises(InputError, match="not finite"):
            report.error_map(*pair)
        pair[0][7, 3, 1] = 0.5


def test_relative_error_of_two_black_pictures_is_zero():
    assert not report.relative_error(np.zeros((9, 9, 3)), np.zeros((9, 9, 3))).any()


def test_error_map_shows_a_wrong_region_in_brighter_colours():
    reference = np.ones((20, 20, 3))
    wrong = reference.copy()
    wrong[:, 10:] = 1.3
    shown = luminance(report.error_map(wrong, reference))
    assert shown[10, 15] > 3 * shown[10, 3]


def _panels(count=3, size=(30, 50)):
    return [(f"title {i}", f"foot {i}", np.full((*size, 3), 40 * i + 30, np.uint8)) for i in range(count)]


def test_panels_stand_side_by_side():
    picture = report.side_by_side(_panels(), 0.5)
    row = picture[picture.shape[0] // 2]
    for i in range(3):
        assert np.count_nonzero((row == 40 * i + 30).all(-1)) == 50


def test_panels_of_different_size_are_refused():
    with pytest.raises(InputError, match="one size"):
        report.side_by_side([*_panels(2), ("", "", np.zeros((30, 51, 3), np.uint8))], 0.5)


def test_words_are_drawn_and_the_error_map_gets_the_scale():
    words = []

    def draw(text, height_px):
        words.append(text)
        return np.ones((height_px, 4), np.float32)

    with_words = report.side_by_side(_panels(), 0.5, draw)
    assert words == ["title 0", "foot 0", "title 1", "foot 1", "title 2", "0 ", " 50 % and more"]
    assert (with_words == 255).all(-1).any() and not (report.side_by_side(_panels(), 0.5) == 255).all(-1).any()


def test_words_wider_than_a_panel_are_cut_not_an_error():
    panels = _panels()
    picture = report.side_by_side(panels, 0.5, lambda text, height_px: np.ones((height_px, 9999), np.float32))
    assert picture.shape == report.side_by_side(panels, 0.5).shape


@pytest.mark.parametrize(("value", "text"), [
    (None, "-"), (0.0123, "1.23 %"), (0.5, "50.0 %"), (-0.02, "-2.00 %"), (12.0, "1200 %")])
def test_percent_shows_three_digits(value, text):
    assert report.percent(value) == text


def test_text_table_aligns_columns():
    assert report.text_table(("name", "x"), [("a", "1"), ("long name", "100")]).splitlines() == [
        "name         x", "---------  ---", "a            1", "long name  100"]


def test_markdown_table_has_a_rule_that_aligns_numbers_right():
    assert report.text_table(("a", "x"), [("b", "10")], True).splitlines()[1] == "| - | -: |"


# ---- measuring ----

SHAPE = (16, 24)


@pytest.fixture
def reference(rng):
    """A noisy reference whose picture is the sum of its parts; the top rows are sky."""
    truth = {name: rng.random((*SHAPE, 3)) + 0.2 for name in PASSES}
    halves = []
    for _ in range(2):
        half = {name: (values * (1 + 0.05 * rng.standard_normal(values.shape))).astype(np.float32)
                for name, values in truth.items()}
        for name in ("Diffuse Color", "Glossy Color"):
            half[name] = truth[name].astype(np.float32)
        half["Depth"] = np.ones((*SHAPE, 1), np.float32)
        half["Depth"][:4] = 1e10
        products = [pair for part in ("direct", "bounce", "glossy bounce") for pair in PARTS[part]]
        parts = sum(half[light] * half[colour] for light, colour in products)
        half["Combined"] = np.concatenate([parts, np.ones((*SHAPE, 1), np.float32)], -1)
        halves.append(half)
    return Reference(*halves, 16)


def result_of(reference):
    """RTGI's result that equals the reference's mean in every part."""
    light = {Transport.DIRECT_DIFFUSE: reference.mean("direct diffuse") / reference.albedo * np.pi,
             Transport.DIRECT_GLOSSY: reference.mean("direct glossy"),
             Transport.BOUNCE_DIFFUSE: reference.mean("bounce") / reference.albedo * np.pi,
             Transport.BOUNCE_GLOSSY: reference.mean("glossy bounce")}
    combined = np.ones((*SHAPE, 4), np.float32)
    combined[..., :3] = reference.mean("picture")
    return Result(combined, {name: values.astype(np.float32) for name, values in light.items()}, np.ones(SHAPE, np.float32))


@pytest.fixture
def perfect(reference):
    return result_of(reference)


def test_result_equal_to_the_reference_has_no_error_in_any_part(perfect, reference):
    # float32 transports
    assert max(errors["block"] for errors in errors_of(perfect, reference).values()) < 1e-6


def test_world_light_counts_as_direct(perfect, reference):
    light = dict(perfect.transports)
    light[Transport.WORLD_DIFFUSE] = light[Transport.DIRECT_DIFFUSE] * 0.25
    light[Transport.DIRECT_DIFFUSE] = light[Transport.DIRECT_DIFFUSE] * 0.75
    assert errors_of(Result(perfect.combined, light, perfect.visibility), reference)["direct"]["block"] < 1e-6


def test_error_of_one_part_is_told_from_the_others(perfect, reference):
    light = dict(perfect.transports)
    light[Transport.BOUNCE_DIFFUSE] = light[Transport.BOUNCE_DIFFUSE] * 1.1
    errors = errors_of(Result(perfect.combined, light, perfect.visibility), reference)
    assert errors["bounce"]["block"] == pytest.approx(0.1, rel=1e-4)
    assert errors["bounce"]["energy"] == pytest.approx(1.1, rel=1e-4)
    assert errors["direct"]["block"] < 1e-6


def test_error_in_the_picture_is_the_parts_error_times_its_share_of_the_light(perfect, reference):
    light = dict(perfect.transports)
    light[Transport.BOUNCE_DIFFUSE] = light[Transport.BOUNCE_DIFFUSE] * 1.1
    errors = errors_of(Result(perfect.combined, light, perfect.visibility), reference)
    share = reference.mean("bounce")[reference.mask].sum() / reference.mean("picture")[reference.mask].sum()
    assert errors["bounce"]["of_picture"] == pytest.approx(0.1 * share, rel=1e-4)


def test_missing_transport_is_black_not_an_error(perfect, reference):
    light = {k: v for k, v in perfect.transports.items() if k is not Transport.BOUNCE_GLOSSY}
    errors = errors_of(Result(perfect.combined, light, perfect.visibility), reference)
    assert errors["glossy bounce"]["block"] == pytest.approx(1.0)


def test_light_in_a_part_that_the_reference_lacks_shows_in_the_picture(perfect, reference):
    for half in (reference.half_a, reference.half_b):
        half["Glossy Indirect"] = np.zeros_like(half["Glossy Indirect"])
    errors = errors_of(perfect, reference)
    assert "block" not in errors["glossy bounce"] and errors["glossy bounce"]["of_picture"] > 0.1
    assert "glossy bounce" not in noise_of(reference)


# how far from perfect each number of `errors_of` has to be for a gain of 2 % and a shift of a pixel, as "larger is worse";
# best_scale and energy see no shift, block_after_scale forgives a gain
FAR = {"block": (0.019, 0.01), "nrmse": (0.015, 0.1), "relmse": (1e-4, 0.01), "block_95": (0.019, 0.02),
       "energy": (0.019, None), "luminance_bias": (0.019, None), "best_scale": (0.019, None),
       "block_after_scale": (None, 0.01), "within_1_percent": (0.9, 0.5)}
PERFECT = {"energy": 1.0, "best_scale": 1.0, "within_1_percent": 1.0}


def changed(result, change):
    """The result with all its pictures changed."""
    return Result(change(result.combined), {name: change(image) for name, image in result.transports.items()},
                  result.visibility)


@pytest.mark.parametrize(("change", "number"), [(lambda image: image * np.float32(1.02), 0),
                                                (lambda image: np.roll(image, 1, 1), 1)], ids=["gain", "shift"])
def test_two_percent_and_a_pixel_are_seen_in_the_picture_and_in_every_part(reference, change, number):
    quiet = Reference(reference.half_a, reference.half_a, 16)
    before, errors = (errors_of(result, quiet) for result in (result_of(quiet), changed(result_of(quiet), change)))
    assert set(errors) == {"picture", *PARTS} and set(errors["picture"]) == set(FAR)
    for part in errors:
        for name, bounds in FAR.items():
            if bounds[number] is not None:
                off, was = (abs(found[part][name] - PERFECT.get(name, 0)) for found in (errors, before))
                assert off > bounds[number] and off > 2 * was, (part, name, off, was)
    assert min(errors[part]["of_picture"] for part in PARTS) > 0.001


@pytest.mark.parametrize("values", [picture_errors, noise_of, floors_of])
def test_one_nan_in_a_half_of_the_reference_is_an_error(perfect, reference, values):
    reference.half_b["Combined"][9, 3, 1] = np.nan
    with pytest.raises(InputError, match="not finite"):
        values(*((perfect.combined,) if values is picture_errors else ()), reference)


@pytest.mark.parametrize("name", ["Diffuse Direct", "Glossy Indirect"])
def test_one_nan_in_a_part_of_the_reference_is_an_error(perfect, reference, name):
    reference.half_a[name][9, 3, 1] = np.nan
    for values in (lambda: errors_of(perfect, reference), lambda: noise_of(reference)):
        with pytest.raises(InputError, match="not finite"):
            values()


def test_one_nan_in_a_picture_is_an_error(perfect, reference):
    perfect.combined[9, 3, 1] = np.nan
    with pytest.raises(InputError, match="1 pixels that are not finite, the first at column 3, row 9"):
        picture_errors(perfect.combined, reference)


@pytest.mark.parametrize("values", [noise_of, floors_of])
def test_two_percent_and_a_pixel_between_the_halves_are_seen(reference, values):
    quiet = Reference(reference.half_a, reference.half_a, 16)
    for change in (lambda image: image * np.float32(1.02), lambda image: np.roll(image, 1, 1)):
        # the depth says which pixels count, and stays
        other = Reference(reference.half_a, {name: image if name == "Depth" else change(image)
                                             for name, image in reference.half_a.items()}, 16)
        before, after = values(quiet), values(other)
        assert max(before.values()) < 1e-12 and min(after.values()) > 5e-5, after


def test_nan_in_a_transport_is_an_error(perfect, reference):
    perfect.transports[Transport.BOUNCE_DIFFUSE][3, 3] = np.nan
    with pytest.raises(InputError, match="not finite"):
        errors_of(perfect, reference)


def test_result_of_another_size_is_refused(perfect, reference):
    small = Result(perfect.combined[1:], perfect.transports, perfect.visibility)
    with pytest.raises(InputError, match="one size"):
        errors_of(small, reference)


def test_diffuse_part_is_irradiance_times_albedo_over_pi():
    albedo = np.full((2, 2, 3), 0.5)
    part = part_of({Transport.BOUNCE_DIFFUSE: np.full((2, 2, 3), np.pi)}, "bounce", albedo)
    np.testing.assert_allclose(part, 0.5, rtol=1e-12)


# ---- tables of the benchmark ----

def record(scene="box", size=(64, 36), presets=("BALANCED",), with_errors=True, seconds=0.25):
    errors = {"picture": {"block": 0.011, "nrmse": 0.1, "energy": 1.0, "within_1_percent": 0.5},
              "direct": {"of_picture": 0.001, "block": 0.002, "nrmse": 0.1, "energy": 1.0, "within_1_percent": 0.995},
              "bounce": {"of_picture": 0.0098, "block": 0.029, "nrmse": 0.1, "energy": 0.999, "within_1_percent": 0.1},
              "glossy bounce": {"of_picture": 0.0}}
    rtgi = {"first_seconds": 3.5, "jit_ms": 2500.0, "seconds": seconds, "all_seconds": [seconds], "peak_memory_mb": 700.0,
            "stages_ms": {"camera view": 60.0, "light views": 40.0, "bvh": 10.0, "direct": 20.0, "rsm": 90.0, "ssr": 12.0,
                          "write": 5.0}}
    cycles = {"1": {"seconds": 0.5}, "4": {"seconds": 1.0}}
    out = {"scene": scene, "size": list(size), "threads": 2, "processor": "A processor",
           "rtgi": {p: dict(rtgi) for p in presets}, "cycles": cycles,
           "versions": {"blender": "5.2.0", "numba": "1", "numpy": "2"}}
    if with_errors:
        for row in out["rtgi"].values():
            row["errors"] = errors
        for row in cycles.values():
            row["errors"] = {"picture": {"block": 0.02}}
        out["reference"] = {"samples": 16, "noise": {"picture": 0.003, "bounce": 0.007}}
    return out


def cells(text, scene):
    """The cells of a scene's row in each table."""
    return [[cell.strip() for cell in line.strip("|").split("|")]
            for line in text.splitlines() if line.startswith(f"| {scene} ")]


def test_times_table_groups_stages_and_names_the_rest():
    row, _ = cells(bench.markdown([record(with_errors=False)]), "box")
    # views 60 + 40, triangles 10, direct 20, rsm 90, ssr 12, and 250 - 232 ms are left; what did not run has no column
    assert row == ["box", "0.25 s", "0.50 s", "1.00 s", "0.50", "100", "10", "20", "90", "12", "18", "700 MB", "3.50 s",
                   "2.50 s"]


def test_errors_table_stands_beside_cycles():
    _, row, _ = cells(bench.markdown([record()]), "box")
    assert row == ["box", "99.5 %", "0.20 %", "2.90 %", "0.999", "0.98 %", "0.00 %", "1.10 %", "2.00 %", "2.00 %", "0.30 %",
                   "0.70 %"]


def test_without_a_reference_there_is_no_errors_table():
    assert "within 1 %" not in bench.markdown([record(with_errors=False)])


def test_presets_get_a_table_when_there_are_several():
    assert "| draft:" not in bench.markdown([record()])
    text = bench.markdown([record(presets=("DRAFT", "BALANCED"))])
    assert "draft: time, picture, bounce" in text and "0.25 s, 1.10 %, 2.90 %" in text


def test_sizes_get_sections_of_their_own():
    text = bench.markdown([record(size=(64, 36)), record("hall", size=(32, 18))])
    assert [line for line in text.splitlines() if line.startswith("## ")] == ["## 64x36", "## 32x18"]


def test_bench_without_a_scene_is_refused(tmp_path):
    with pytest.raises(InputError, match="no scene"):
        bench.bench([], tmp_path)


def test_bench_of_a_missing_scene_is_refused_before_anything_runs(tmp_path):
    with pytest.raises(InputError, match="there is no file"):
        bench.bench([tmp_path / "none.blend"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_bench_of_no_frames_is_refused(tmp_path):
    (tmp_path / "a.blend").touch()
    with pytest.raises(InputError, match="repeats"):
        bench.bench([tmp_path / "a.blend"], tmp_path, repeats=0)
