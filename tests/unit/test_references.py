"""References: rendered until they are quiet, kept under what decides them, the cache kept small; FLIP beside them."""

import os
import sys

import numpy as np
import pytest

from rtgi_addon.compare import flip, references
from rtgi_addon.compare.halves import PASSES, Reference
from rtgi_addon.compare.measure import floors_of, noise_of, picture_errors
from rtgi_addon.core import cache_root
from rtgi_addon.errors import InputError

SHAPE = (48, 64)
NOISE_OF_ONE = 0.8          # standard deviation of a sample over the mean; the blocks' noise at 16 samples is 1.4 %


def rendered(samples, seeds):
    """Two halves of an even grey view with the noise of `samples`."""
    halves = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        half = {name: np.ones((*SHAPE, 3), np.float32) for name in PASSES}
        noise = NOISE_OF_ONE / samples**0.5 * rng.standard_normal((*SHAPE, 3))
        half["Combined"] = np.concatenate([1 + noise, np.ones((*SHAPE, 1))], -1).astype(np.float32)
        half["Depth"] = np.ones((*SHAPE, 1), np.float32)
        halves.append(half)
    return Reference(*halves, samples)


def test_reference_is_rendered_until_its_noise_is_below_the_level():
    asked = []

    def render(samples, seeds):
        asked.append((samples, seeds))
        return rendered(samples, seeds)

    found = references.until_quiet(render, 0.003, 16, (11, 77))
    assert noise_of(found)["picture"] <= 0.003 and found.samples == sum(samples for samples, _ in asked)
    assert len({seed for _, seeds in asked for seed in seeds}) == 2 * len(asked)
    # noise falls with the root of the samples; the margin and the last estimate are worth a third
    first = noise_of(rendered(16, (11, 77)))["picture"]
    assert found.samples == pytest.approx(16 * (first / 0.003) ** 2, rel=0.35)


def test_a_quiet_first_round_is_the_only_one():
    assert references.until_quiet(rendered, 0.05, 16, (11, 77)).samples == 16


@pytest.mark.parametrize("noise", [0, -0.1, 1, float("nan")])
def test_noise_level_that_is_none_is_refused(noise):
    with pytest.raises(InputError, match="noise level"):
        references.until_quiet(rendered, noise, 16, (11, 77))


def test_rounds_end_at_the_most_samples(monkeypatch):
    monkeypatch.setattr(references, "MOST_SAMPLES", 40)
    assert references.until_quiet(rendered, 1e-6, 16, (11, 77)).samples == 40


def test_joined_halves_are_weighted_by_their_samples():
    one, three = rendered(1, (1, 2)), rendered(3, (3, 4))
    joined = one.joined(three)
    expected = 0.25 * one.half_a["Combined"] + 0.75 * three.half_a["Combined"]
    np.testing.assert_allclose(joined.half_a["Combined"], expected, rtol=1e-5, atol=1e-6)     # float32
    assert joined.samples == 4


def test_noise_of_joined_halves_falls_with_the_root_of_the_samples():
    one = noise_of(rendered(16, (1, 2)))["picture"]
    four = noise_of(rendered(16, (1, 2)).joined(rendered(48, (3, 4))))["picture"]
    # means of |noise| over 48 blocks and 3 channels: 6 % each
    assert four == pytest.approx(one / 2, rel=0.2)


def test_an_independent_reference_gives_the_same_errors_within_their_noise():
    picture = rendered(1, (5, 6)).half_a["Combined"] * 0 + 1.05
    few, many = (picture_errors(picture, rendered(n, seeds)) for n, seeds in ((64, (11, 77)), (400, (5, 6))))
    floors = floors_of(rendered(64, (11, 77)))
    assert abs(few["block"] - many["block"]) < floors["block"]
    # the means of 9,000 noisy values
    assert few["luminance_bias"] == pytest.approx(0.05, abs=0.003) and few["nrmse"] == pytest.approx(0.05, rel=0.1)
    assert floors["relmse"] == pytest.approx(floors["nrmse"] ** 2 / 1.01**2, rel=0.05)


def test_name_changes_with_each_thing_that_decides_the_picture():
    base = ("scene", (64, 36), b"bytes", 1, 64, None)
    names = {references.name_of(*base), references.name_of("scene", (64, 36), b"other", 1, 64, None),
             references.name_of("scene", (64, 36), b"bytes", 2, 64, None),
             references.name_of("scene", (64, 36), b"bytes", 1, 64, 0.01),
             references.name_of("scene", (64, 36), b"bytes", 1, 6, 4, None)}
    assert len(names) == 5 and references.name_of(*base) in names


def test_what_was_used_longest_ago_leaves_a_full_cache(tmp_path):
    size = None
    for age, name in ((30, "a_64x48_1.npz"), (20, "b_64x48_2.npz")):
        references.keep(rendered(1, (1, 2)), tmp_path / name)
        then = os.stat(tmp_path / name).st_mtime - age
        os.utime(tmp_path / name, (then, then))
        size = (tmp_path / name).stat().st_size
    (tmp_path / "notes.txt").write_text("of the user's own")
    references.keep(rendered(1, (1, 2)), tmp_path / "c_64x48_3.npz", 2.5 * size)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b_64x48_2.npz", "c_64x48_3.npz", "notes.txt"]


def test_the_newest_reference_stays_however_large(tmp_path):
    references.keep(rendered(1, (1, 2)), tmp_path / "c_64x48_3.npz", 1)
    assert (tmp_path / "c_64x48_3.npz").is_file()


def test_references_are_kept_where_an_extension_may_write(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr(cache_root, "_root", tmp_path)
    assert cache_root.references_root() == tmp_path / "references"


# ---- FLIP ----

GREY = np.full((8, 8, 3), 100, np.uint8)


def stand_in(tmp_path, body):
    """A Python with a library of FLIP that does what `body` says, and none other on its path."""
    (tmp_path / "flip_evaluator.py").write_text(body)
    program = tmp_path / "python"
    program.write_text(f'#!/bin/sh\nPYTHONPATH="{tmp_path}:$PYTHONPATH" exec "{sys.executable}" "$@"\n')
    program.chmod(0o755)
    return str(program)


def test_flip_of_the_library_is_returned(tmp_path):
    python = stand_in(tmp_path, "def evaluate(reference, test, kind, inputsRGB, applyMagma):\n"
                                "    return None, float(abs(test - reference).mean()), {}\n")
    assert flip.mean_flip(GREY + np.uint8(51), GREY, python) == pytest.approx(0.2, abs=1e-6)     # float32


def test_two_percent_and_a_pixel_reach_the_library_of_flip(tmp_path, rng):
    # the pictures arrive as they are, test and reference not exchanged: what the library makes of them is its own
    python = stand_in(tmp_path, "def evaluate(reference, test, kind, inputsRGB, applyMagma):\n"
                                "    return None, float((test - reference).mean() + 2 * abs(test - reference).mean()), {}\n")
    picture = rng.integers(20, 200, (8, 8, 3), np.uint8)
    gain = np.round(picture * 1.02).astype(np.uint8)
    shift = np.roll(picture, 1, 1)
    for changed in (gain, shift):
        d = changed.astype(float) / 255 - picture / 255
        assert flip.mean_flip(changed, picture, python) == pytest.approx(d.mean() + 2 * abs(d).mean(), abs=1e-6) != 0


def test_flip_takes_nothing_that_could_hold_a_nan():
    broken = GREY.astype(np.float32) / 255
    broken[3, 3] = np.nan
    for pair in ((broken, GREY), (GREY, broken)):
        with pytest.raises(InputError, match="FLIP needs"):
            flip.mean_flip(*pair)


def test_missing_library_is_one_line(tmp_path):
    found = flip.mean_flip(GREY, GREY, stand_in(tmp_path, "raise ImportError"))
    assert "left out" in found and "pip install flip-evaluator" in found


def test_library_that_ends_the_process_is_one_line(tmp_path):
    found = flip.mean_flip(GREY, GREY, stand_in(tmp_path, "import os\ndef evaluate(*a, **k):\n    os._exit(255)\n"))
    assert found == "FLIP ended with code 255"


def test_python_that_is_not_there_is_one_line():
    assert "did not run" in flip.mean_flip(GREY, GREY, "/none/python")


@pytest.mark.parametrize("other", [GREY[1:], GREY / 255])
def test_flip_refuses_pictures_that_it_cannot_hold_together(other):
    with pytest.raises(InputError, match="FLIP needs"):
        flip.mean_flip(GREY, other)
