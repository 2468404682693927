"""What the command line understands and refuses, without Blender."""

import dataclasses
import gzip
from pathlib import Path

import pytest

from rtgi_addon import cli
from rtgi_addon.blendfile import blend_version, refuse_newer
from rtgi_addon.core.techniques import TECHNIQUE_PARAMS, default_settings
from rtgi_addon.errors import InputError


def blend(path: Path, head: bytes = b"BLENDER17-01v0502REND") -> Path:
    path.write_bytes(head + bytes(64))
    return path


def run(capsys, *argv) -> tuple[int, list[str]]:
    """Exit code and the lines on stderr."""
    code = cli.main([str(a) for a in argv])
    return code, capsys.readouterr().err.splitlines()


def test_missing_scene_is_one_line_and_code_2(tmp_path, capsys):
    code, lines = run(capsys, "render", tmp_path / "none.blend", "-o", tmp_path / "o.exr")
    assert code == 2 and len(lines) == 1 and "there is no file" in lines[0]


def test_file_that_is_no_blend_is_one_line_and_code_2(tmp_path, capsys):
    (tmp_path / "text.blend").write_text("hello")
    code, lines = run(capsys, "render", tmp_path / "text.blend", "-o", tmp_path / "o.exr")
    assert code == 2 and len(lines) == 1 and "is not a .blend file" in lines[0]


def test_unknown_technique_names_the_nearest(tmp_path, capsys):
    code, lines = run(capsys, "render", blend(tmp_path / "a.blend"), "-o", tmp_path / "o.exr", "--techniques", "rms")
    assert code == 2 and len(lines) == 1 and "did you mean 'rsm'" in lines[0]


def test_unknown_preset_names_the_known_ones(tmp_path, capsys):
    code, lines = run(capsys, "render", blend(tmp_path / "a.blend"), "-o", tmp_path / "o.exr", "--preset", "best")
    assert code == 2 and len(lines) == 1 and "draft, balanced, quality" in lines[0]


def test_output_in_a_missing_folder_is_refused(tmp_path, capsys):
    code, lines = run(capsys, "render", blend(tmp_path / "a.blend"), "-o", tmp_path / "none" / "o.exr")
    assert code == 2 and len(lines) == 1 and "cannot write" in lines[0]


def test_output_under_a_file_is_refused(tmp_path, capsys):
    scene = blend(tmp_path / "a.blend")
    code, lines = run(capsys, "render", scene, "-o", scene / "o.exr")
    assert code == 2 and len(lines) == 1 and "cannot write" in lines[0]


def test_output_of_another_kind_is_refused(tmp_path, capsys):
    code, lines = run(capsys, "render", blend(tmp_path / "a.blend"), "-o", tmp_path / "o.jpg")
    assert code == 2 and len(lines) == 1 and "must end in .exr or .png" in lines[0]


@pytest.mark.parametrize("size", ["0x540", "960x0", "0x0"])
def test_picture_of_zero_size_is_refused(tmp_path, capsys, size):
    code, lines = run(capsys, "render", blend(tmp_path / "a.blend"), "-o", tmp_path / "o.exr", "--size", size)
    assert code == 2 and len(lines) == 1 and "zero size" in lines[0]


def test_reversed_frames_are_refused_with_the_right_order(tmp_path, capsys):
    code, lines = run(capsys, "render", blend(tmp_path / "a.blend"), "-o", tmp_path / "o.exr", "--frames", "9-2")
    assert code == 2 and len(lines) == 1 and "write 2-9" in lines[0]


def test_missing_words_are_one_line(capsys):
    code, lines = run(capsys, "render")
    assert code == 2 and len(lines) == 1 and "--output" in lines[0]


def test_unknown_command_is_one_line(capsys):
    code, lines = run(capsys, "rendr")
    assert code == 2 and len(lines) == 1


def test_refused_words_leave_no_file(tmp_path, capsys):
    scene = blend(tmp_path / "a.blend")
    run(capsys, "render", scene, "-o", tmp_path / "o.exr", "--passes", tmp_path / "p.png")
    assert sorted(tmp_path.iterdir()) == [scene]


@pytest.mark.parametrize("command", [[], ["render"], ["compare"], ["bench"], ["doctor"], ["warmup"]])
def test_help_ends_with_code_0(capsys, command):
    assert cli.main([*command, "--help"]) == 0
    assert "usage: rtgi" in capsys.readouterr().out


def test_frames_include_the_last():
    assert list(cli.parse_frames("3-5")) == [3, 4, 5]


def test_frames_may_be_negative():
    assert list(cli.parse_frames("-2--1")) == [-2, -1]


def test_number_fills_the_hashes():
    assert cli.numbered(Path("a/door_####.exr"), 7, True) == Path("a/door_0007.exr")


def test_number_is_appended_in_a_sequence_without_hashes():
    assert cli.numbered(Path("a/door.exr"), 7, True) == Path("a/door_0007.exr")


def test_single_frame_keeps_its_plain_name():
    assert cli.numbered(Path("a/door.exr"), 7, False) == Path("a/door.exr")


@pytest.mark.parametrize("text", ["rsm.rays=many", "rsm.none=1", "none.rays=1", "rays=1", "rsm.glossy_texels=maybe"])
def test_wrong_setting_is_refused(text):
    with pytest.raises(InputError):
        cli.parse_setting(text)


def test_setting_takes_the_type_of_its_default():
    assert cli.parse_setting("rsm.rays=64") == ("rsm", "rays", 64)
    assert cli.parse_setting("rsm.radius=0.5") == ("rsm", "radius", 0.5)
    assert cli.parse_setting("rsm.method=all") == ("rsm", "method", "ALL")
    assert cli.parse_setting("rsm.glossy_texels=off") == ("rsm", "glossy_texels", False)


def words(*argv):
    return cli.parser().parse_args(["render", "a.blend", "-o", "o.exr", *argv])


def test_words_that_say_nothing_keep_the_scenes_settings():
    before = default_settings("DRAFT").with_params("rsm", rays=5)
    assert cli.settings_from_words(words(), before) == before


def test_listed_techniques_switch_the_planner_off():
    settings = cli.settings_from_words(words("--techniques", "direct"), default_settings())
    assert not settings.use_auto and not settings.enabled["rsm"] and settings.enabled["world"]


def test_setting_out_of_range_is_refused():
    with pytest.raises(InputError, match="rsm.rays must be from 1 to 1024"):
        cli.settings_from_words(words("--set", "rsm.rays=0"), default_settings())


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0:00"), (65, "1:05"), (3725, "1:02:05")])
def test_clock_reads_like_a_clock(seconds, text):
    assert cli.clock(seconds) == text


@pytest.mark.parametrize(("head", "version"), [(b"BLENDER-v405RENDH", (4, 5)), (b"BLENDER_V279RENDH", (2, 79)),
                                               (b"BLENDER17-01v0503", (5, 3))])
def test_version_is_read_from_old_and_new_heads(tmp_path, head, version):
    assert blend_version(blend(tmp_path / "a.blend", head)) == version


def test_version_is_read_from_a_gzip_file(tmp_path):
    path = tmp_path / "a.blend"
    with gzip.open(path, "wb") as file:
        file.write(b"BLENDER-v279" + bytes(50))
    assert blend_version(path) == (2, 79)


@pytest.mark.parametrize("start", [b"\x28\xb5\x2f\xfd", b"\x1f\x8b"])
def test_broken_compressed_file_is_no_blend(tmp_path, start):
    with pytest.raises(InputError, match="is not a .blend file"):
        blend_version(blend(tmp_path / "a.blend", start + b"broken"))


def test_file_of_a_newer_blender_is_refused(tmp_path):
    with pytest.raises(InputError, match="saved by Blender 5.3, this is 5.2"):
        refuse_newer(blend(tmp_path / "a.blend", b"BLENDER17-01v0503"), (5, 2))


def test_blender_4_5_reads_a_5_0_file_with_a_warning(tmp_path):
    assert "it loads" in refuse_newer(blend(tmp_path / "a.blend", b"BLENDER17-01v0500"), (4, 5))


def test_file_of_the_same_blender_needs_no_warning(tmp_path):
    assert refuse_newer(blend(tmp_path / "a.blend"), (5, 2)) is None


def test_settings_are_listed_with_range_meaning_and_when_they_are_read(capsys):
    assert cli.main(["settings"]) == 0
    said = capsys.readouterr().out
    for name, kind in TECHNIQUE_PARAMS.items():
        for field in dataclasses.fields(kind):
            assert f"  {name}.{field.name}={cli.setting_words(field.default)} " in said and field.metadata["doc"] in said
    assert cli.main(["settings", "rsm"]) == 0
    said = capsys.readouterr().out
    assert "rsm.radius=0.3   (0.001 to 1.0)" in said and "Read only with method paper" in said and "lpv." not in said


def test_listed_defaults_can_be_set(capsys):
    for name, kind in TECHNIQUE_PARAMS.items():
        for field in dataclasses.fields(kind):
            text = f"{name}.{field.name}={cli.setting_words(field.default)}"
            assert cli.parse_setting(text) == (name, field.name, field.default)


@pytest.mark.parametrize(("text", "peers"), [
    ("1,4,eevee", ([1, 4], True)), ("16, 1", ([1, 16], False)), ("none", ([], False)), ("EEVEE", ([], True))])
def test_peers_are_sample_counts_and_eevee(text, peers):
    assert cli.parse_peers(text) == peers


@pytest.mark.parametrize("text", ["", "0", "-1", "1.5", "cycles", "1,none"])
def test_peers_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="--peers"):
        cli.parse_peers(text)


@pytest.mark.parametrize(("text", "level"), [("1%", 0.01), ("0.5 %", 0.005), ("0.02", 0.02), ("1e-3", 0.001)])
def test_noise_level_is_a_share_or_percent(text, level):
    assert cli.parse_share(text, "--noise", "noise level") == pytest.approx(level, rel=1e-12)


@pytest.mark.parametrize("text", ["", "0", "-1%", "100%", "low", "1%%", "nan", "1e%"])
def test_noise_level_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="--noise"):
        cli.parse_share(text, "--noise", "noise level")


@pytest.mark.parametrize(("text", "seconds"), [("1.5s", 1.5), ("800ms", 0.8), ("2", 2.0), ("1e-1 s", 0.1)])
def test_target_time_is_seconds_or_milliseconds(text, seconds):
    assert cli.parse_time(text) == pytest.approx(seconds, rel=1e-12)


@pytest.mark.parametrize("text", ["", "0", "-1s", "fast", "1h", "nan", "inf", "1e999"])
def test_target_time_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="--target-time"):
        cli.parse_time(text)


def test_a_target_stands_above_a_preset_and_a_preset_clears_the_scenes_target():
    before = dataclasses.replace(default_settings(), target_time_s=3.0)
    assert cli.settings_from_words(words(), before).target_time_s == 3.0
    assert cli.settings_from_words(words("--target-error", "2%"), before).target_error == 0.02
    assert cli.settings_from_words(words("--target-error", "2%"), before).target_time_s == 0
    plain = words("--preset", "draft")
    plain.preset = cli.parse_preset(plain.preset)
    assert cli.settings_from_words(plain, before).target_time_s == 0


def test_two_targets_are_refused():
    with pytest.raises(InputError, match="not allowed with"):
        words("--target-error", "2%", "--target-time", "1s")
