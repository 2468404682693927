"""Make docs/hard_cases.md: `python tools/hard_cases.py`. Every number in it is computed here; needs no Blender.

"Before" is the same technique without what mends the case: the frame as it is instead of as `core/mending.py` hands it on,
or a parameter that takes the published method. Where nothing can be switched off there is a number for now alone.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.core.frame import Frame  # noqa: E402
from rtgi_addon.core.mending import mend_frame  # noqa: E402
from rtgi_addon.core.techniques import EmissionParams, LpvParams, RsmParams, VxgiParams  # noqa: E402
from tests import hard_cases as measure  # noqa: E402
from tests.hard_frames import CHEAP, ODD_FRAMES, run_as_it_is  # noqa: E402

Number = Callable[[], float]


@dataclass(frozen=True)
class Case:
    """A hard case: its name, what its numbers are, what mends it, by technique the numbers before (None: not measurable) and
    now, and the tests, "file::name" below tests/.
    """

    name: str
    what: str
    mend: str
    numbers: dict[str, tuple[Number | None, Number]]
    tests: tuple[str, ...]


def _of(function: Callable[..., float], names: tuple[str, ...] | dict, **fixed: object) -> dict[str, tuple[None, Number]]:
    """Numbers for now of several techniques."""
    return {name: (None, partial(function, name, **fixed)) for name in names}


_IMAGES = ("depth", "position_ws", "normal_ws", "albedo", "specular", "roughness", "emission")


def _worst_broken(name: str, is_mended: bool) -> float:
    return max(measure.beside_broken(name, what, is_mended) for what in _IMAGES)


def _over_decades(name: str) -> float:
    return max(measure.of_power(name, factor) for factor in (1e-11, 1e10))      # of a lamp of 100 W


_PLACES, _DIGITS, _MACHINES, _VOLUMES, _ODD = (f"hard/test_{name}.py" for name in (
    "places", "digits", "machines", "volumes", "odd_frames"))
_CORNER = {"rsm": RsmParams(rays=64, clusters=256, lattice_px=1), "lpv": LpvParams(resolution=16, lattice_px=1),
           "vxgi": VxgiParams(resolution=32, lattice_px=1, cones=128)}
_CONES = VxgiParams(resolution=32, lattice_px=1, exact_voxels=0)
_PUBLISHED = LpvParams(mode="PAPER", resolution=8, lattice_px=1)
_plain: dict[str, np.ndarray] = {}                   # light of kernels that were not compiled


def _plain_difference(name: str) -> float:
    if not _plain:
        with tempfile.TemporaryDirectory() as folder:
            _plain.update(measure.plain_python_light(Path(folder)))
    return measure.as_plain_python(_plain, name)


CASES = (
    Case("1/r^2 at corners", "largest error on a wall 0.1 to 2 texels above the edge of a lit floor, of the sum over texels",
         "mended by: texels as squares instead of points, an option of the sum that the pass does not yet take",
         {"rsm": (partial(measure.corner_of_texels, False), partial(measure.corner_of_texels, True))},
         ("analytic/test_rsm_form_factors.py::test_square_texels_are_right_in_a_corner",
          f"{_PLACES}::test_square_texels_take_away_the_error_of_points_in_a_corner")),
    Case("1/r^2 at corners", "brightest pixel over what is right, on the lowest 0.7 texels of a wall over a lit floor",
         "what bounds it, rsm: a ray gives at most 8 times its fair share. vxgi: form factors of the walls in a voxel. lpv: "
         "directions",
         {"rsm": (None, partial(measure.brightest_in_corner, "rsm", _CORNER["rsm"], 0.06)),
          "vxgi": (None, partial(measure.brightest_in_corner, "vxgi", _CORNER["vxgi"], 0.06)),
          "lpv": (partial(measure.brightest_in_corner, "lpv", dataclasses.replace(_CORNER["lpv"], mode="PAPER"), 0.06),
                  partial(measure.brightest_in_corner, "lpv", _CORNER["lpv"], 0.06))},
         (f"{_PLACES}::test_light_in_a_corner_has_no_spikes",
          "analytic/test_vxgi.py::test_furnace_gives_one_in_its_corners_to_a_thousandth")),
    Case("1/r^2 at corners", "light missing on the lowest 0.07 texels of that wall; negative is too much",
         "not mended for rsm: most of the light there comes from a strip of the nearest texel that few of its rays find, "
         "and one ray gives at most eight times its share",
         _of(lambda name: measure.missing_in_corner(name, _CORNER[name], 0.006), _CORNER), ()),
    Case("grazing angles", "mean error against closed forms, of a floor seen at an angle of 0.001 rad",
         "",
         _of(measure.grazing_error, ("direct", "world", "emission", "hbao", "ssao", "ssdo", "ssr"), tilt=1e-3),
         (f"{_PLACES}::test_light_of_a_surface_seen_at_a_grazing_angle_is_the_closed_form",
          "metamorphic/test_ssr.py::test_grazing_surfaces_give_a_picture",
          "analytic/test_direct.py::test_plane_in_grazing_light_shows_no_acne")),
    Case("degenerate and non-unit normals", "change by normals of three times their length",
         "mended by: `core/mending.py` gives them a length of 1",
         {name: (partial(measure.stretched_normals, name, 3.0, False), partial(measure.stretched_normals, name, 3.0, True))
          for name in CHEAP},
         (f"{_DIGITS}::test_normals_of_another_length_make_no_difference",
          f"{_ODD}::test_an_odd_frame_gives_a_finite_picture",
          "metamorphic/test_ssr.py::test_normals_that_are_zero_turned_away_or_not_finite_give_a_picture")),
    Case("background beside foreground",
         "change of the mean on surfaces by background in every third pixel of every third row, which also draws anew", "",
         _of(measure.change_by_holes, tuple(name for name in CHEAP if name != "ssr")),
         (f"{_PLACES}::test_background_beside_foreground_is_black_and_takes_nothing_from_it",
          "unit/test_depth_pyramid.py::test_slope_beside_a_silhouette_is_that_of_the_pixels_own_surface",
          "metamorphic/test_rsm.py::test_background_stays_black",
          "metamorphic/test_ssdo.py::test_pixels_without_a_surface_stay_black")),
    Case("far from the origin", "change of a room that is moved by 1000 km",
         "mended by: positions relative to the camera, taken off in float64 (`Frame.origin_ws`)",
         {name: (partial(measure.far_away, name, 1e6, False), partial(measure.far_away, name, 1e6, True)) for name in CHEAP},
         (f"{_DIGITS}::test_a_room_a_thousand_kilometres_away_looks_the_same_once_its_origin_is_taken_off",
          f"{_DIGITS}::test_a_room_as_far_out_as_may_keep_its_origin_looks_the_same",
          "blender/test_engine.py::test_scene_far_from_the_origin_renders_like_one_at_it",
          "analytic/test_direct.py::test_plane_far_from_the_origin_shows_no_acne")),
    Case("far from the origin", "change of a room that is moved by 1 km, where the origin is kept", "",
         _of(measure.far_away, tuple(CHEAP), distance_m=1e3, is_kept_near=False), ()),
    Case("tiny and huge units", "change of a room in millimetres, fluxes by the square of lengths", "",
         _of(measure.in_other_units, tuple(CHEAP), scale=1e-3),
         ("metamorphic/test_laws.py::test_lengths_times_s_with_fluxes_times_s_squared_give_the_same_light",
          "metamorphic/test_vxgi.py::test_bounds_of_a_millimetre_and_a_million_metres_give_the_same_picture",
          "analytic/test_lpv.py::test_a_room_of_a_millimetre_and_of_a_thousand_kilometres_has_the_same_light",
          "metamorphic/test_any_frame.py::test_any_frame_and_parameters_give_light_as_documented")),
    Case("LPV divergence", "change of the light in a closed room from 64 steps to 256",
         "both settle; before: clamped steps, now: unclamped ones",
         {"lpv": (partial(measure.settled, "PAPER"), partial(measure.settled, "HARMONICS"))},
         (f"{_VOLUMES}::test_light_in_a_closed_room_settles",)),
    Case("LPV divergence", "largest factor off 1/r^2 on a texel's axis, 2 to 6 cells away; before: as published",
         "mended by: flux by directions, swept through the grid once",
         {"lpv": (partial(measure.fall_off, "PAPER"), partial(measure.fall_off, "ORDINATES"))},
         (f"{_VOLUMES}::test_directions_fall_off_as_they_should_where_the_published_form_does_not",
          "analytic/test_lpv.py::test_light_falls_off_as_one_over_r_squared_without_a_scale")),
    Case("negative lobes", "flux of a texel after 8 steps over what it sent, less 1; before: clamped",
         "mended by: no clamping: a negative part moves on with its sign",
         {"lpv": (partial(measure.growth_of_flux, True, 8), partial(measure.growth_of_flux, False, 8))},
         (f"{_VOLUMES}::test_steps_without_clamping_neither_add_nor_lose_light",
          "analytic/test_lpv.py::test_clamping_adds_an_eighth_of_a_lobe_once")),
    Case("thin walls", "light behind a wall without thickness over that before it; before: as published, or all texels",
         "mended by, rsm: rays. vxgi: an exact walk through planes in voxels. lpv: links that triangles close",
         {**_of(measure.leak, ("direct", "world", "emission", "final_gather", "ssr")),
          "rsm": (partial(measure.leak, "rsm", RsmParams(method="ALL")), partial(measure.leak, "rsm")),
          "vxgi": (partial(measure.leak, "vxgi", dataclasses.replace(_CONES, resolution=16)), partial(measure.leak, "vxgi")),
          "lpv": (partial(measure.leak, "lpv", _PUBLISHED), partial(measure.leak, "lpv"))},
         (f"{_PLACES}::test_no_light_comes_through_a_wall_without_thickness",
          f"{_PLACES}::test_published_forms_let_light_through_a_wall",
          "analytic/test_vxgi.py::test_no_light_comes_through_a_wall_thinner_than_a_voxel",
          "analytic/test_lpv.py::test_no_light_passes_a_closed_wall_without_thickness",
          "oracle/test_rsm_oracle.py::test_a_wall_between_texel_and_point_makes_exactly_zero")),
    Case("cone self-intersection", "light that a lone plane askew to the grid gives to itself, over the lamp's; before: as "
         "published", "mended by, vxgi: exact rays begin on the plane in the voxel. lpv: cells that a point can see",
         {**_of(measure.own_light, ("rsm", "final_gather"), turned_rad=0.7),
          "vxgi": (partial(measure.own_light, "vxgi", _CONES, turned_rad=0.7),
                   partial(measure.own_light, "vxgi", dataclasses.replace(_CONES, exact_voxels=1024), turned_rad=0.7)),
          "lpv": (partial(measure.own_light, "lpv", _PUBLISHED, turned_rad=0.7),
                  partial(measure.own_light, "lpv", dataclasses.replace(_PUBLISHED, mode="ORDINATES"), turned_rad=0.7))},
         (f"{_PLACES}::test_a_lone_plane_gives_itself_nothing",
          f"{_PLACES}::test_published_cones_and_steps_light_the_plane_that_they_start_on")),
    Case("rays along axes and cell edges", "largest error in a box that shines evenly, walls on planes between cells",
         "mended by exact rays; before: cones as published",
         {"vxgi": (partial(measure.furnace_on_cells, 0.0, 0.0), partial(measure.furnace_on_cells, 1e6, 0.0))},
         (f"{_PLACES}::test_walls_on_the_planes_between_cells_and_rays_along_axes_make_no_difference",
          "unit/test_bvh.py::test_rays_along_an_axis_meet_flat_boxes",
          "analytic/test_lpv.py::test_a_surface_on_a_plane_of_centres_is_lit")),
    Case("light in a corner", "bounce of a lamp 0.1 mm from three walls against the plain sum over its texels",
         "", {"rsm": (None, partial(measure.lamp_in_corner, 1e-4))},
         (f"{_PLACES}::test_a_lamp_in_a_corner_lights_as_the_sum_over_its_texels_does",
          f"{_PLACES}::test_a_lamp_in_a_corner_lights_the_same_once_its_texels_lie_in_one_cell",
          f"{_ODD}::test_an_odd_frame_gives_a_finite_picture")),
    Case("flux 1e-9 to 1e12 W", "change at 1e-9 and at 1e12 W, scaled back; the larger",
         "what helps: no constant has the unit of light",
         _of(_over_decades, tuple(CHEAP)),
         (f"{_ODD}::test_light_is_linear_in_power_over_21_decades",)),
    Case("zero and one albedo", "change of light between white surfaces, halved, against grey ones", "",
         _of(measure.white_against_grey, tuple(name for name in CHEAP if name != "ssr")),
         (f"{_DIGITS}::test_one_bounce_is_linear_in_the_albedo_from_black_to_white",
          f"{_DIGITS}::test_bounces_without_end_between_white_surfaces_are_no_more_than_an_open_sky")),
    Case("HDR spikes", "largest error on a floor under a sky that shines from one texel of 2048; emission: under a square "
         "of 1 mm with 1e9 W/(m2 sr)", "what helps: directions and points are drawn by their light",
         {**_of(measure.spike_in_the_sky, measure.WORLDS),
          "emission": (None, partial(measure.tiny_emitter, "emission", EmissionParams(rays=16, lattice_px=1)))},
         (f"{_DIGITS}::test_a_sky_that_shines_from_one_texel_lights_a_floor_as_the_sum_says",
          f"{_DIGITS}::test_a_square_of_a_millimetre_that_shines_lights_a_floor_as_a_point_does",
          f"{_DIGITS}::test_a_texel_a_million_times_as_bright_as_others_is_all_that_counts")),
    Case("NaN and infinity in input passes", "change of all other pixels by one NaN, the worst of seven images",
         "mended by: `core/mending.py` takes the pixel for background, or its colour for black",
         {name: (partial(_worst_broken, name, False), partial(_worst_broken, name, True)) for name in CHEAP},
         (f"{_DIGITS}::test_a_broken_pixel_changes_its_neighbours_by_no_more_than_one_of_background",
          f"{_ODD}::test_an_odd_frame_gives_a_finite_picture",
          f"{_ODD}::test_a_broken_pixel_is_named_and_its_neighbours_stay")),
    Case("one-pixel features", "light of a strip one pixel wide, gathered at every fourth pixel, against every pixel",
         "mended by: pixels that no gather point can serve are gathered themselves; not so by hbao, ssao and ssdo",
         _of(measure.pole_error, tuple(name for name in CHEAP if hasattr(CHEAP[name], "lattice_px")), lattice_px=4),
         (f"{_PLACES}::test_a_strip_one_pixel_wide_keeps_its_light_between_gather_points",)),
    Case("1 and N threads", "values that differ", "what helps: each thread writes its own pixels",
         _of(measure.on_threads, tuple(CHEAP)),
         (f"{_MACHINES}::test_one_two_and_all_threads_give_the_same_bits",)),
    Case("no-JIT equality", "change by kernels that run as plain Python", "",
         _of(_plain_difference, tuple(CHEAP)),
         (f"{_MACHINES}::test_kernels_as_plain_python_give_the_same_light",)),
    Case("open meshes, broken triangles, many at one place, no scene, one plane, a lamp in a wall", "", "", {},
         (f"{_ODD}::test_an_odd_frame_gives_a_finite_picture",
          "metamorphic/test_vxgi.py::test_odd_geometry_gives_a_finite_picture",
          "metamorphic/test_vxgi.py::test_a_lamp_inside_a_wall_gives_a_finite_picture",
          "unit/test_voxels.py::test_a_million_triangles_in_one_voxel_are_one_voxel")),
    Case("background only, a camera inside an object, a near plane through one, depths of 1 mm to 1000 km, pictures of 1x1 "
         "and 7x5, roughness 0 and 1, mirrors all around", "", "", {},
         (f"{_ODD}::test_an_odd_frame_gives_a_finite_picture",
          "metamorphic/test_ssr.py::test_room_of_mirrors_gives_a_picture",
          "metamorphic/test_any_frame.py::test_any_frame_and_parameters_give_light_as_documented",
          "metamorphic/test_any_frame.py::test_any_frame_gives_a_finite_picture")),
)

_HEAD = """# Hard cases

Made by `tools/hard_cases.py`; the numbers are from small frames and few rays, as the tests have them (`tests/hard/`).

## The list

Each number is an error, 0 for a perfect technique, on scenes of `tests/hard_cases.py`: relative to the light where nothing
else is said. "Before" is the same technique without what mends the case, where that can be switched off; "now" is as it is
when it renders. A technique that is not named has nothing to do with the case: `hbao`, `ssao` and `ssdo` know of walls and
lamps what the picture shows.

"""

_BROKEN = """## Broken input

Each row is a small room with something broken in it (every fifth pixel, or every seventh texel of the lamp's view, holds the
value); each cell is the number of pixels of {pixels} that are not finite, before and after `core/mending.py` has put the
frame right. Rows without a broken pixel before are left out; "stops" means that the technique ended with an error.
`tests/hard/test_odd_frames.py` runs all {count} frames on every technique.

"""


def _written(value: float) -> str:
    if value == 0:
        return "0"
    if not np.isfinite(value):
        return "no number"
    return f"{value:.2g}" if 0.01 <= value < 1000 else f"{value:.0e}"


def section(case: Case, has_heading: bool) -> list[str]:
    """The lines of one case."""
    lines = [f"### {case.name}", ""] if has_heading else []
    if case.numbers:
        found = {name: (before and before(), now()) for name, (before, now) in case.numbers.items()}
        lines += [f"{case.what[0].upper()}{case.what[1:]}.", ""]
        lines += ["| | " + " | ".join(found) + " |", "|---" * (len(found) + 1) + "|"]
        if any(before is not None for before, _ in found.values()):
            lines.append("| before | " + " | ".join("" if b is None else _written(b) for b, _ in found.values()) + " |")
        lines += ["| now | " + " | ".join(_written(now) for _, now in found.values()) + " |", ""]
        lines += [f"{case.mend[0].upper()}{case.mend[1:]}.", ""] if case.mend else []
    if case.tests:
        lines += ["Tests: " + ", ".join(f"`tests/{test}`" for test in case.tests) + ".", ""]
    return lines


def broken_pixels(name: str, frame: Frame) -> str:
    """How many pixels of a technique's light are not finite, or "stops"."""
    try:
        light = run_as_it_is(name, frame).light.values()
    except (ValueError, IndexError, AttributeError):
        return "stops"
    return str(int(np.logical_or.reduce([~np.isfinite(image).all(-1) for image in light]).sum()))


def broken_table() -> list[str]:
    """The table of broken input."""
    lines = ["| frame | " + " | ".join(CHEAP) + " |", "|---" * (len(CHEAP) + 1) + "|"]
    for what, make in ODD_FRAMES.items():
        before = [broken_pixels(name, make()) for name in CHEAP]
        if set(before) == {"0"}:
            continue
        after = [broken_pixels(name, mend_frame(make())) if b != "0" else "" for name, b in zip(CHEAP, before, strict=True)]
        cells = [f"{b}, {a}" if a else "" for b, a in zip(before, after, strict=True)]
        lines.append(f"| {what} | " + " | ".join(cells) + " |")
    return lines


def page() -> str:
    """The whole page."""
    pixels = next(iter(ODD_FRAMES.values()))().gbuffer.depth.size
    before = (None, *(case.name for case in CASES))
    lines = [line for case, last in zip(CASES, before, strict=False) for line in section(case, case.name != last)]
    return (_HEAD + "\n".join(lines) + "\n" + _BROKEN.format(pixels=pixels, count=len(ODD_FRAMES))
            + "\n".join(broken_table()) + "\n")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    (ROOT / "docs" / "hard_cases.md").write_text(page(), encoding="utf-8")
