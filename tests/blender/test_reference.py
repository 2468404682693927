"""Cycles one-bounce references: what they hold, what they do not depend on, and that the user's scene stays as it was."""

import numpy as np
import pytest

from rtgi_addon.errors import CaptureError, InputError

pytestmark = pytest.mark.blender

SIZE = (48, 28)
SAMPLES = 4


@pytest.fixture
def blender(bpy_session):
    from rtgi_addon.compare import reference

    return reference


@pytest.fixture
def own_settings(small_scene):
    """The small scene with settings of the user's that would spoil a reference, and that must come back."""
    scene, layer = small_scene, small_scene.view_layers[0]
    cycles, render = scene.cycles, scene.render
    cycles.samples, cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 77, 5, 3, 0
    cycles.use_adaptive_sampling, cycles.use_denoising, cycles.seed = True, True, 5
    cycles.sample_clamp_direct, cycles.sample_clamp_indirect, cycles.light_sampling_threshold = 0.5, 0.001, 0.5
    cycles.blur_glossy, cycles.use_fast_gi, cycles.film_exposure = 2.0, True, 3.0
    cycles.pixel_filter_type, cycles.filter_width, cycles.use_layer_samples = "GAUSSIAN", 3.0, "USE"
    layer.samples, layer.use_pass_mist, layer.use_pass_z = 1, True, False
    render.film_transparent, render.use_motion_blur, render.use_persistent_data = True, True, False
    render.use_border, render.border_min_x, render.border_max_x = True, 0.5, 0.75
    render.filepath, render.image_settings.file_format, render.image_settings.color_mode = "//own_", "JPEG", "BW"
    render.resolution_percentage, render.pixel_aspect_x = 50, 2.0
    scene.camera.data.dof.use_dof = True
    return scene


def settings(scene):
    """Every plain setting that a comparison might touch, by place."""
    layer = scene.view_layers[0]
    places = {"render": scene.render, "image": scene.render.image_settings, "cycles": scene.cycles, "layer": layer,
              "layer.cycles": layer.cycles, "dof": scene.camera.data.dof, "rtgi": scene.rtgi, "rsm": scene.rtgi.rsm,
              "direct": scene.rtgi.direct, "view": scene.view_settings}
    found = {}
    for place, owner in places.items():
        for prop in owner.bl_rna.properties:
            value = getattr(owner, prop.identifier)
            if isinstance(value, (bool, int, float, str)):
                found[f"{place}.{prop.identifier}"] = value
    return found


def test_settings_are_many_enough_to_see_a_change(own_settings):
    before = settings(own_settings)
    own_settings.view_layers[0].cycles.use_denoising = not own_settings.view_layers[0].cycles.use_denoising
    assert len(before) > 200 and settings(own_settings) != before


@pytest.fixture
def reference(blender, small_scene):
    return blender.render_reference(small_scene, SAMPLES, SIZE)


def test_reference_has_the_asked_size_and_two_different_halves(reference):
    assert reference.shape == SIZE[::-1] and reference.samples == SAMPLES
    assert not np.array_equal(*reference.halves("bounce"))


def test_parts_and_emission_add_up_to_the_picture(reference):
    half = reference.half_a
    total = sum(reference.halves(part)[0] for part in ("direct", "bounce", "glossy bounce"))
    total = total + half["Emission"] + half["Environment"]
    # float32 rounding of Cycles' division by the colour and our multiplication
    np.testing.assert_allclose(total, half["Combined"][..., :3], atol=1e-5)


def test_row_zero_is_the_top(reference):
    # the red wall stands behind the grey floor
    top, bottom = reference.albedo[8, 24], reference.albedo[-2, 2]
    assert top[0] > 4 * top[1] and bottom[0] == pytest.approx(bottom[1], rel=1e-3)


def test_samples_lie_at_the_pixel_centres(reference):
    # a filter of 1.5 px makes 6 % of these pixels differ by more than 0.1; colour under gloss varies a little with the view
    np.testing.assert_allclose(reference.half_a["Diffuse Color"], reference.half_b["Diffuse Color"], atol=1e-3)


def test_sky_is_not_in_the_mask(blender, small_scene):
    small_scene.camera.rotation_euler[0] = 1.65                  # sees over the wall
    reference = blender.render_reference(small_scene, 1, SIZE)
    assert not reference.mask[0].any() and reference.mask[-1].any()


def test_point_light_gives_the_irradiance_of_the_inverse_square_law(blender, bpy_session, small_scene):
    lamp = bpy_session.data.lights["Spot"]
    lamp.type, lamp.energy, lamp.shadow_soft_size = "POINT", 100.0, 0.0
    small_scene.camera.location, small_scene.camera.rotation_euler = (-1.5, -1.0, 2.0), (0.0, 0.0, 0.0)
    small_scene.objects["Spot"].location = (-1.5, -1.0, 4.0)
    reference = blender.render_reference(small_scene, 1, SIZE)
    # straight below the lamp: E = P / (4 pi d^2), the pass is E / pi; 0.5 % as four pixels are a little off the axis
    middle = reference.half_a["Diffuse Direct"][13:15, 23:25]
    np.testing.assert_allclose(middle, 100 / (4 * np.pi * 4.0**2) / np.pi, rtol=5e-3)


def test_reference_does_not_depend_on_the_users_settings(blender, bpy_session, reference, own_settings):
    layer = own_settings.view_layers[0]
    spoiled = blender.render_reference(own_settings, SAMPLES, SIZE, layer)
    for name, values in reference.half_a.items():
        np.testing.assert_array_equal(spoiled.half_a[name], values, err_msg=name)


def test_reference_leaves_the_scene_as_it_was(blender, own_settings):
    before = settings(own_settings)
    blender.render_reference(own_settings, 1, SIZE)
    assert settings(own_settings) == before


def test_peer_leaves_the_scene_as_it_was(blender, own_settings):
    before = settings(own_settings)
    blender.render_peer(own_settings, 1, True, 1, SIZE)
    assert settings(own_settings) == before


def test_failed_reference_leaves_the_scene_as_it_was(blender, own_settings, monkeypatch):
    def fail(*_args, **_words):
        raise CaptureError("on purpose")

    monkeypatch.setattr(blender, "_render", fail)
    before = settings(own_settings)
    with pytest.raises(CaptureError, match="on purpose"):
        blender.render_reference(own_settings, 1, SIZE)
    assert settings(own_settings) == before


def test_scene_without_camera_is_refused(blender, small_scene):
    small_scene.camera = None
    with pytest.raises(InputError, match="no camera"):
        blender.render_reference(small_scene, 1, SIZE)


def test_equal_seeds_are_refused(blender, small_scene):
    with pytest.raises(InputError, match="different seeds"):
        blender.render_reference(small_scene, 1, SIZE, seeds=(3, 3))


def test_layer_whose_name_has_a_dot_is_read(blender, small_scene):
    small_scene.view_layers[0].name = "View.001"
    assert blender.render_reference(small_scene, 1, SIZE).mask.any()


def test_denoised_peer_is_nearer_to_the_reference_than_the_raw_one(blender, small_scene):
    from rtgi_addon.compare.metrics import relative_l1

    truth = blender.render_reference(small_scene, 64, SIZE)
    pictures = {denoise: blender.render_peer(small_scene, 1, denoise, 1, SIZE).combined for denoise in (False, True)}
    errors = {denoise: relative_l1(p[..., :3], truth.mean("picture"), truth.mask) for denoise, p in pictures.items()}
    assert errors[True] < errors[False]


def test_peer_times_as_many_frames_as_asked(blender, small_scene):
    peer = blender.render_peer(small_scene, 1, False, 3, SIZE)
    assert len(peer.seconds) == 3 and min(peer.seconds) > 0


def test_picture_goes_through_the_view_transform(blender, small_scene):
    small_scene.view_settings.view_transform, small_scene.view_settings.look = "Standard", "None"
    small_scene.view_settings.exposure = 1.0
    shown = blender.displayed(np.full((4, 4, 3), 0.25), small_scene)
    # 0.25 doubled by the exposure is 0.5, sRGB 187.5
    assert shown.shape == (4, 4, 3) and np.all(np.abs(shown.astype(int) - 188) <= 1)


def test_longer_text_is_drawn_wider(blender):
    short, long = blender.drawn_text("RTGI", 20), blender.drawn_text("RTGI RTGI", 20)
    assert short.shape[0] == 20 and long.shape[1] > 1.5 * short.shape[1]
    assert short.max() == pytest.approx(1.0, abs=0.02)
