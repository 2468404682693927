"""Directional occlusion on the screen: what of the world's light gets through, and what the occluders send instead.

`gather_sectors` takes 64 pixels through each step together, one a lane: its inner loops run over lanes, without branches, on
rows of one scratch array at offsets that are known when the kernel is compiled, so that they vectorise. Branches on
what a tap finds cost 30 ns a tap, most of it mispredicted.
"""

from __future__ import annotations

import math

import numpy as np

from .fastmath import HALF_PI, PI, fast_atan2, fast_sin, fraction
from .jit import borrowed, device_jit, inline_jit, pixel_jit, prefetch, select
from .octahedron import table_at
from .sampling import dither, near_weight, place_id, r2_sequence, uniform
from .screen import TINY, is_inside, point_vs, to_screen, to_viewer_vs, turn_to_view, turn_to_world
from .shadow import ORTHOGRAPHIC
from .slices import (
    SECTORS,
    Slice,
    bits_below,
    count_bits,
    exit_px,
    into_slice,
    reach_px,
    screen_step,
    share_below,
    slice_of,
)
from .vec3 import (
    ONE,
    ZERO,
    Vec3,
    along,
    cross,
    dot,
    f32,
    length,
    load_pixel,
    scaled,
    sub,
    tangent_frame,
    to_world,
    turned_by,
)

HALF, TWO = f32(0.5), f32(2)
LANES = 64
FAR = f32(1e18)             # stands for a depth where nothing is seen: its square is still a float32
GOLDEN, SILVER = f32(0.618034), f32(0.754878)   # steps of the sequences that spread jitter over a pixel's slices
SKY_ARCS = 8                # parts of a slice that each look into the world once: 22 degrees, with a random place in each
HORIZON = f32(0.01)         # sine of elevation below which a tap is taken to lie on the pixel's own plane
SAME_PLANE = f32(0.05)      # distance from each other's plane, over distance, at which two taps are one sheet
SURE = f32(2)               # below this they are taken for one without a closer look (60 degrees)
STEEP = f32(8)              # steps of a walk across a sheet are longer than its footprint by this at most (83 degrees)
MIDDLE = f32(0.45)          # where between two taps the nearer one's share ends: the middle of a step from square to square
MOST_MORE = f32(0.05)       # of a slice: how far a sheet may be taken to go on past its last tap
EDGE = f32(1 / 16)          # of its distance on the screen: how well the edge of a sheet is found
SPLITS = f32(8)             # halvings of a step in search of the edge of a sheet: a step of 256 px to one pixel
TAPS_A_STEP = 3             # taps in all are this many times the steps, whatever edges there are

# rows of the scratch array
(_P, _VIEWER, _NORMAL, _SIDE, _SLICE, _Q, _N, _TAP, _DISTANCE, _TURN, _JITTER, _SHIFT, _COLUMN, _ROW, _COLUMNS, _ROWS,
 _RATE, _METRES, _REACH, _FIRST, _TODO, _R, _R_LAST, _R_FAR, _R_COARSE, _SPLIT, _HAS, _PLACE, _LIT, _HIT_COLUMN, _HIT_ROW,
 _FROM, _BETWEEN, _BEGIN, _TO, _SHARE, _SHARE_LAST, _SLOPE, _R_TAP, _RED, _GREEN, _BLUE, _OPEN_RED, _OPEN_GREEN,
 _OPEN_BLUE, _WHOLE_RED, _WHOLE_GREEN, _WHOLE_BLUE) = (
    LANES * k for k in (0, 3, 6, 9, 12, 19, 22, 25, *range(29, 69)))
_ROW_COUNT = 69
# of the scratch array of integers: pixels of the lane itself, of its tap and of the taps whose light is taken; lanes that
# take any
_SELF, _PIXEL, _PIXEL_LAST, _LIGHT, _LIGHT_LAST, _LISTED = (LANES * k for k in range(6))


@device_jit
def _vector(w, row, x):
    return Vec3(w[row + x], w[row + LANES + x], w[row + 2 * LANES + x])


@device_jit
def _put(w, row, x, v):
    w[row + x] = v.x
    w[row + LANES + x] = v.y
    w[row + 2 * LANES + x] = v.z


@device_jit
def _slice_at(w, x):
    row = _SLICE + x
    return Slice(w[row], w[row + LANES], w[row + 2 * LANES], w[row + 3 * LANES], w[row + 4 * LANES], w[row + 5 * LANES],
                 w[row + 6 * LANES])


@device_jit
def first_angle(turn, cos_b):
    """A first guess for `nearer_angle`: between its two extremes, a straight line at b = 0 and a sine at 90 degrees."""
    e = turn / HALF_PI
    return turn * cos_b + (ONE - cos_b) * fast_atan2(e, math.sqrt(max(ONE - e * e, ZERO)))


@device_jit
def nearer_angle(phi, turn, cos_b, sin_b):
    """A step of Newton towards the angle in [0, pi / 2] below which slices weigh `turn` (of pi in all).

    The normal leans from the viewer by b towards the angle 0. A slice at phi weighs w = cos b + g cos phi sin b with
    tan g = cos phi tan b, and the integral of w is sin phi sin b g + atan2(sin phi cos b, cos phi). Slices that are drawn in
    proportion to w all count the same, and an open surface has no noise. Two steps from `first_angle` leave less than 1e-5.
    """
    c, q = fast_sin(HALF_PI - phi), fast_sin(phi)
    g = fast_atan2(c * sin_b, cos_b)
    integral = q * sin_b * g + fast_atan2(q * cos_b, c)
    return min(max(phi - (integral - turn) / max(cos_b + g * c * sin_b, f32(1e-3)), ZERO), HALF_PI)


@device_jit
def _begin(s, table, w, c, ids, first, seed):
    """Rows that hold for all slices of 64 pixels; lanes past the last pixel take it once more."""
    width = s.depth.shape[1]
    for x in range(LANES):
        m = ids[min(first + x, ids.shape[0] - 1)]
        i, j = m // width, m % width
        p = point_vs(s, f32(j) + HALF, f32(i) + HALF, table[m, 3])
        c[_SELF + x] = m
        _put(w, _P, x, p)
        _put(w, _VIEWER, x, to_viewer_vs(s, p))
        _put(w, _NORMAL, x, turn_to_view(s, Vec3(table[m, 0], table[m, 1], table[m, 2])))
        w[_COLUMN + x], w[_ROW + x], w[_DISTANCE + x] = f32(j) + HALF, f32(i) + HALF, length(p)
        place = place_id(i, j)
        w[_TURN + x], w[_JITTER + x], w[_SHIFT + x] = dither(place, seed, 0), dither(place, seed, 1), uniform(m, seed, 2)
        for channel in range(9):
            w[_RED + channel * LANES + x] = ZERO


@device_jit
def _begin_slice(s, w, k, slices):
    """Rows of slice k: its side, its Slice, its line on the screen."""
    phi, turn, cos_b, sin_b = _FROM, _BETWEEN, _TO, _SHARE                       # rows of the walk, not yet in use
    for x in range(LANES):
        u, viewer, normal = (f32(k) + w[_TURN + x]) / f32(slices), _vector(w, _VIEWER, x), _vector(w, _NORMAL, x)
        w[turn + x] = PI * min(u, ONE - u)       # both halves are alike
        w[cos_b + x] = min(max(dot(normal, viewer), ZERO), ONE)
        w[sin_b + x] = length(cross(normal, viewer))
        w[phi + x] = first_angle(w[turn + x], w[cos_b + x])
    for _ in range(2):
        for x in range(LANES):
            w[phi + x] = nearer_angle(w[phi + x], w[turn + x], w[cos_b + x], w[sin_b + x])
    for x in range(LANES):
        p, viewer, normal = _vector(w, _P, x), _vector(w, _VIEWER, x), _vector(w, _NORMAL, x)
        # axes of the angle: the normal's lean, and across it
        leans, height, inv = w[sin_b + x] > f32(1e-3), dot(normal, viewer), ONE / max(w[sin_b + x], f32(1e-3))
        other, _ = tangent_frame(viewer)
        axis = Vec3((normal.x - height * viewer.x) * inv if leans else other.x,
                    (normal.y - height * viewer.y) * inv if leans else other.y,
                    (normal.z - height * viewer.z) * inv if leans else other.z)
        across = cross(viewer, axis)
        cosine, sine = fast_sin(HALF_PI - w[phi + x]), fast_sin(w[phi + x])
        cosine = cosine if (f32(k) + w[_TURN + x]) / f32(slices) < HALF else -cosine
        side = Vec3(cosine * axis.x + sine * across.x, cosine * axis.y + sine * across.y, cosine * axis.z + sine * across.z)
        a, _ = slice_of(viewer, side, normal)
        columns, rows = screen_step(s, p, side)
        rate = max(math.sqrt(columns * columns + rows * rows), TINY)
        _put(w, _SIDE, x, side)
        w[_SLICE + x], w[_SLICE + LANES + x], w[_SLICE + 2 * LANES + x] = a.n_v, a.n_s, a.rcp_n2
        w[_SLICE + 3 * LANES + x], w[_SLICE + 4 * LANES + x] = a.cos_g, a.sin_g
        w[_SLICE + 5 * LANES + x], w[_SLICE + 6 * LANES + x] = a.start, a.rcp_open
        w[_COLUMNS + x], w[_ROWS + x], w[_RATE + x], w[_METRES + x] = columns / rate, rows / rate, rate, ONE / rate


@device_jit
def _begin_side(s, w, c, way, k, slices, radius, steps):
    """Rows of a walk along one side of a slice, in `steps` steps whose distances are the squares of even numbers."""
    height, width = f32(s.depth.shape[0]), f32(s.depth.shape[1])
    for x in range(LANES):
        side = scaled(_vector(w, _SIDE, x), way)
        column, row, columns, rows = w[_COLUMN + x], w[_ROW + x], way * w[_COLUMNS + x], way * w[_ROWS + x]
        reach = reach_px(s, column, row, w[_DISTANCE + x], _vector(w, _VIEWER, x), side, radius, w[_RATE + x])
        reach = max(min(reach, exit_px(height, width, column, row, columns, rows) - f32(0.01)), ZERO)
        first = fraction(w[_JITTER + x] + f32(k) / f32(slices)) / f32(steps)
        start = min(ONE + (reach - ONE) * first * first, reach)
        w[_REACH + x], w[_FIRST + x], w[_TODO + x] = reach, first, f32(steps)
        w[_R + x], w[_R_COARSE + x], w[_R_LAST + x], w[_R_FAR + x], w[_SPLIT + x] = start, start, ZERO, ZERO, ZERO
        w[_HAS + x], w[_PLACE + x], w[_LIT + x], w[_SLOPE + x], w[_R_TAP + x] = ONE, max(way, ZERO), ZERO, ZERO, ZERO
        _put(w, _Q, x, _vector(w, _P, x))
        _put(w, _N, x, _vector(w, _NORMAL, x))
        c[_PIXEL_LAST + x] = c[_SELF + x]


@inline_jit
def _aim(s, table, w, c, way):
    """Rows of the pixel that each walk has come to, which the memory is told of before `_tap` asks for it."""
    height, width = f32(s.depth.shape[0]), f32(s.depth.shape[1])
    for x in range(LANES):
        # the order of min and max turns NaN into 0
        px = way * w[_R + x]
        w[_HIT_COLUMN + x] = f32(np.int32(max(ZERO, min(w[_COLUMN + x] + w[_COLUMNS + x] * px, width - ONE))))
        w[_HIT_ROW + x] = f32(np.int32(max(ZERO, min(w[_ROW + x] + w[_ROWS + x] * px, height - ONE))))
        c[_PIXEL + x] = np.int32(w[_HIT_ROW + x]) * np.int32(s.depth.shape[1]) + np.int32(w[_HIT_COLUMN + x])
    for x in range(LANES):
        prefetch(table, table.shape[1] * np.uint32(c[_PIXEL + x]))


@inline_jit
def _tap(table, w, c):
    """Rows of what the pixel shows that each walk has come to."""
    for x in range(LANES):
        m = np.uint32(c[_PIXEL + x])
        w[_TAP + x], w[_TAP + LANES + x] = table[m, 0], table[m, 1]
        w[_TAP + 2 * LANES + x], w[_TAP + 3 * LANES + x] = table[m, 2], table[m, 3]


@inline_jit
def _look(s, w, c, way, k, steps, radius, thickness, fade, left):
    """Take or refuse each walk's tap, note the sectors that it covers, and go on to the next; `left` taps remain.

    A tap goes on with the sheet of the tap before it if the two lie in one plane, or in two planes that meet between them:
    each tap in front of the other's plane (a corner), or each behind it (an edge). One in front and one behind is a gap.
    Before a gap is crossed the walk looks for the edges on its two sides, by halves.
    """
    is_parallel, end = s.projection == ORTHOGRAPHIC, max(way, ZERO)
    s_left, s_top, step_x, step_y, turn = s.left, s.top, s.step_x, s.step_y, s.view_from_world
    for x in range(LANES):
        p, viewer, side, normal = _vector(w, _P, x), _vector(w, _VIEWER, x), _vector(w, _SIDE, x), _vector(w, _NORMAL, x)
        a = _slice_at(w, x)
        depth = min(w[_TAP + 3 * LANES + x], FAR)
        scale = ONE if is_parallel else depth
        q = Vec3((s_left + (w[_HIT_COLUMN + x] + HALF) * step_x) * scale,
                 (s_top - (w[_HIT_ROW + x] + HALF) * step_y) * scale, -depth)
        q_last, n_last, n = _vector(w, _Q, x), _vector(w, _N, x), turned_by(turn, _vector(w, _TAP, x))
        r, r_last, r_far, r_coarse, reach = w[_R + x], w[_R_LAST + x], w[_R_FAR + x], w[_R_COARSE + x], w[_REACH + x]
        split, todo, has = w[_SPLIT + x], w[_TODO + x], w[_HAS + x] > ZERO
        pixel, pixel_last = c[_PIXEL + x], c[_PIXEL_LAST + x]
        d, d_last, step = sub(q, p), sub(q_last, p), sub(q, q_last)
        d2, step2 = dot(d, d), dot(step, step)
        is_active = r_last < reach
        is_same = has & (pixel == pixel_last)
        is_there = is_active & (not is_same) & (d2 <= radius * radius)
        above, before = dot(step, n_last), -dot(step, n)
        footprint = (r - r_last) * w[_METRES + x]
        is_flat = above * above + before * before < SAME_PLANE * SAME_PLANE * step2
        is_bent = (above * before >= ZERO) & (step2 < STEEP * STEEP * footprint * footprint)
        is_sheet = is_there & has & (is_flat | is_bent)
        height = dot(d, normal)
        is_up = (height > ZERO) & (height * height > HORIZON * HORIZON * d2)
        was_lit, is_facing = w[_LIT + x] > ZERO, is_up & (dot(d, n) < ZERO)
        # beyond an edge that turns the surface away, the edge itself is what is seen of it; and a long step to a steep plane
        # may have passed over a gap: both are looked at more closely
        is_doubtful = is_bent & (not is_flat) & (((above < ZERO) & (was_lit != is_facing))
                                                 | (step2 > SURE * SURE * footprint * footprint))
        goes_on = is_same | (is_sheet & (not is_doubtful)) | (not (is_there | has))
        nearest = max(ONE, EDGE * r)
        may_split = (split < SPLITS) & (f32(left) > todo)
        splits = is_active & (not goes_on) & (r - r_last > nearest) & may_split
        takes = is_active & (not splits)
        is_tap = takes & is_there
        v, b = into_slice(a, viewer, side, normal, d)
        front = share_below(a, v, b, end)
        front = front if is_up else end
        # the sectors from the tap before to this one, or from its own rear, deeper on the viewer's ray by the thickness; on
        # a sheet the two taps share them where the middle of the step would be seen: halves of the angle would favour the
        # farther one
        on = thickness / depth
        rear_v = v - thickness if is_parallel else v + on * (v - w[_DISTANCE + x])
        rear_b = b if is_parallel else b + on * b
        on = MIDDLE if is_parallel else MIDDLE * q_last.z / ((ONE - MIDDLE) * q.z + MIDDLE * q_last.z)
        v, b = into_slice(a, viewer, side, normal, Vec3(d.x - (ONE - on) * step.x, d.y - (ONE - on) * step.y,
                                                        d.z - (ONE - on) * step.z))
        border, start = share_below(a, select(is_sheet, v, rear_v), select(is_sheet, b, rear_b), end), w[_PLACE + x]
        between = min(max(border, min(start, front)), max(start, front))
        between = start if not was_lit else (between if is_facing else front)
        # a sheet that ends here does so somewhere between the taps, on average in the middle
        ends, place = takes & has & (not goes_on) & (not is_sheet), w[_PLACE + x]
        since = r - w[_R_TAP + x]
        more = place + min(HALF * since * abs(w[_SLOPE + x]), MOST_MORE) * (ONE if w[_SLOPE + x] > ZERO else -ONE)
        between = min(max(more, ZERO), ONE) if ends else between
        shift = fraction(w[_SHIFT + x] + f32(k) * SILVER)
        joins, is_lit = ends | (is_tap & is_sheet), is_tap & is_facing
        w[_FROM + x] = select(joins, f32(SECTORS) * place + shift, ZERO)
        w[_BETWEEN + x] = select(joins, f32(SECTORS) * between + shift, ZERO)
        w[_BEGIN + x] = select(is_tap, f32(SECTORS) * select(is_sheet, between, border) + shift, ZERO)
        w[_TO + x] = select(is_tap, f32(SECTORS) * front + shift, ZERO)
        w[_SHARE + x] = select(is_lit, near_weight(d2, fade), ZERO)
        w[_SHARE_LAST + x] = select((ends | is_sheet) & was_lit, near_weight(dot(d_last, d_last), fade), ZERO)
        w[_SLOPE + x] = select(is_tap, select(is_sheet, (front - place) / max(since, HALF), ZERO), w[_SLOPE + x])
        w[_R_TAP + x] = select(is_tap, r, w[_R_TAP + x])
        c[_LIGHT + x], c[_LIGHT_LAST + x] = pixel, pixel_last
        # the next tap: between, at the far end of the gap, or a step on
        is_short = takes & goes_on & (r < r_far)
        is_deeper = is_short & may_split & (r_far - r > nearest)
        is_coarse = takes & (not is_short)
        is_done = is_coarse & (r >= r_coarse)
        on = w[_FIRST + x] + ONE + (ONE - todo) / f32(steps)
        coarse = select(is_done, select(todo > ONE, min(ONE + (reach - ONE) * on * on, reach), reach), r_coarse)
        halved = HALF * (r + select(splits, r_last, r_far))
        r_next = select(is_coarse, coarse, select(splits | is_deeper, halved, r_far))
        w[_Q + x], w[_Q + LANES + x] = select(is_tap, q.x, q_last.x), select(is_tap, q.y, q_last.y)
        w[_Q + 2 * LANES + x] = select(is_tap, q.z, q_last.z)
        w[_N + x], w[_N + LANES + x] = select(is_tap, n.x, n_last.x), select(is_tap, n.y, n_last.y)
        w[_N + 2 * LANES + x] = select(is_tap, n.z, n_last.z)
        c[_PIXEL_LAST + x] = select(is_tap, pixel, pixel_last)
        w[_PLACE + x] = select(is_tap, front, w[_PLACE + x])
        w[_LIT + x] = select(is_lit | ((not is_tap) & was_lit), ONE, ZERO)
        w[_HAS + x] = select(is_tap | ((not takes) & has) | is_same, ONE, ZERO)
        w[_TODO + x] = select(is_done, todo - ONE, todo)
        w[_R_COARSE + x], w[_R_LAST + x], w[_R + x] = coarse, select(takes, r, r_last), r_next
        w[_R_FAR + x] = select(splits, r, select(is_coarse, ZERO, r_far))
        w[_SPLIT + x] = select(is_coarse, ZERO, select(splits | is_deeper, split + ONE, SPLITS))


@device_jit
def _bits_between(a, b):
    """uint64 of the sectors between two numbers in [0, 64], in either order."""
    return bits_below(np.int32(a)) ^ bits_below(np.int32(b))


@inline_jit
def _cover(w, c, covered, radiance):
    """Give each lane's newly covered sectors the radiance of the taps that cover them; True while a walk goes on."""
    goes_on = False
    for x in range(LANES):
        goes_on |= w[_R_LAST + x] < w[_REACH + x]
        of_last = _bits_between(w[_FROM + x], w[_BETWEEN + x]) & ~covered[x]
        of_this = _bits_between(w[_BEGIN + x], w[_TO + x]) & ~covered[x] & ~of_last
        covered[x] |= of_last | of_this
        w[_SHARE_LAST + x] *= f32(count_bits(of_last))
        w[_SHARE + x] *= f32(count_bits(of_this))
    number = 0
    for x in range(LANES):
        c[_LISTED + number] = x                  # a list without branches: most of them would be mispredicted
        number += np.int32(1 if w[_SHARE + x] + w[_SHARE_LAST + x] > ZERO else 0)
    for m in range(number):
        x = np.uint32(c[_LISTED + m])
        share, last, here, there = w[_SHARE + x], w[_SHARE_LAST + x], np.uint32(c[_LIGHT + x]), np.uint32(c[_LIGHT_LAST + x])
        w[_RED + x] += share * radiance[here, 0] + last * radiance[there, 0]
        w[_GREEN + x] += share * radiance[here, 1] + last * radiance[there, 1]
        w[_BLUE + x] += share * radiance[here, 2] + last * radiance[there, 2]
    return goes_on


@device_jit
def _add_sky(s, w, sky, covered, k):
    """Give each lane the world's radiance in the sectors that nothing covers, and what it would get if nothing did."""
    if sky.shape[0] == 0:
        for x in range(LANES):
            w[_OPEN_RED + x] += f32(SECTORS - count_bits(covered[x]))
        return
    share, whole = _TO, _SHARE
    for x in range(LANES):
        w[_PLACE + x] = ZERO
    for t in range(SKY_ARCS):
        # angles from the projected normal, -pi / 2 to pi / 2 over the slice
        end_psi = PI * (f32(t + 1) / f32(SKY_ARCS) - HALF)
        cos_end, sin_end, end = fast_sin(HALF_PI - abs(end_psi)), fast_sin(end_psi), f32(1 if t >= SKY_ARCS // 2 else 0)
        for x in range(LANES):
            a, viewer, side = _slice_at(w, x), _vector(w, _VIEWER, x), _vector(w, _SIDE, x)
            place = share_below(a, cos_end * a.cos_g - sin_end * a.sin_g, cos_end * a.sin_g + sin_end * a.cos_g, end)
            place = ONE if t == SKY_ARCS - 1 else place
            first, last = f32(SECTORS) * w[_PLACE + x] + HALF, f32(SECTORS) * place + HALF
            arc = _bits_between(first, last)
            w[share + x], w[whole + x] = f32(count_bits(arc & ~covered[x])), f32(count_bits(arc))
            w[_PLACE + x] = place
            psi = end_psi - PI / f32(SKY_ARCS) * fraction(w[_JITTER + x] + w[_SHIFT + x] + f32(k) * GOLDEN)
            cosine, sine = fast_sin(HALF_PI - abs(psi)), fast_sin(psi)
            v, b = cosine * a.cos_g - sine * a.sin_g, cosine * a.sin_g + sine * a.cos_g
            d = Vec3(v * viewer.x + b * side.x, v * viewer.y + b * side.y, v * viewer.z + b * side.z)
            _put(w, _Q, x, turn_to_world(s, d))
        for x in range(LANES):
            red, green, blue = table_at(sky, _vector(w, _Q, x))
            w[_OPEN_RED + x] += w[share + x] * red
            w[_OPEN_GREEN + x] += w[share + x] * green
            w[_OPEN_BLUE + x] += w[share + x] * blue
            w[_WHOLE_RED + x] += w[whole + x] * red
            w[_WHOLE_GREEN + x] += w[whole + x] * green
            w[_WHOLE_BLUE + x] += w[whole + x] * blue


@pixel_jit
def gather_sectors(begin, end, s, table, ids, slots, radiance, sky, radius, thickness, fade, slices, steps, seed, out):
    """Light at pixels by slices with a visibility bitmask, written to the planes `out` (9 or 4, N) float32 W/m2.

    Planes: the bounce by colour, the world's light by colour, and the world's light if nothing stood in the way. With an
    empty sky there are four, and the fourth is pi times the visibility.

    s: Screen; table (H W, 4): normal in the world and depth of each pixel, depth +inf for nothing; ids (M,) row times width
    plus column of pixels that see a surface, slots (M,) where their light goes; radiance (H W, 3) W/(m2 sr) that each
    pixel's surface sends out; sky (n, n, 3): the world's radiance as `kernels.octahedron` has it, or (0, 0, 3); radius,
    thickness in m.

    A tap covers the sectors from its own direction to that of the tap before it where both are one sheet, else to the
    direction of its rear, `thickness` behind it. Sectors that nothing nearer has covered take the radiance of the tap, or of
    the one before on the same sheet, whichever faces the pixel and is nearer; the solid angle is in the sector, so no cosine
    of the emitter enters. Taps farther than `radius` do not count. The bounce is weighted by `near_weight`.
    """
    s, = borrowed((s,))
    number = ids.shape[0]
    for block in range(begin, end):
        first = np.int64(block) * LANES
        w, c, covered = np.empty(_ROW_COUNT * LANES, np.float32), np.empty(6 * LANES, np.int32), np.empty(LANES, np.uint64)
        _begin(s, table, w, c, ids, first, seed)
        for k in range(slices):
            _begin_slice(s, w, k, slices)
            for x in range(LANES):
                covered[x] = 0
            for half in range(2):
                way = ONE if half == 0 else -ONE
                _begin_side(s, w, c, way, k, slices, radius, steps)
                _aim(s, table, w, c, way)
                left, goes_on = TAPS_A_STEP * steps, True
                while goes_on and left > 0:
                    left -= 1
                    _tap(table, w, c)
                    _look(s, w, c, way, k, steps, radius, thickness, fade, left)
                    _aim(s, table, w, c, way)
                    goes_on = _cover(w, c, covered, radiance)
            _add_sky(s, w, sky, covered, k)
        scale = PI / f32(SECTORS * slices)
        for x in range(min(number - first, LANES)):
            for channel in range(out.shape[0]):
                out[channel, slots[first + x]] = scale * w[_RED + channel * LANES + x]


@pixel_jit
def gather_samples(begin, end, s, ids, slots, radiance, sky, radius, fade, samples, seed, out):
    """Light at pixels by points in the hemisphere, as published; arguments and planes as those of `gather_sectors`.

    Ritschel, Grosch and Seidel 2009, Eq. 1 and 2: of `samples` directions, even over the hemisphere, each goes a random
    share of `radius`; where the surface seen there lies nearer to the viewer, the direction is blocked and the surface is a
    patch of area pi radius^2 / samples that sends light.
    """
    s, = borrowed((s,))
    width = s.depth.shape[1]
    patch_m2 = PI * radius * radius / f32(samples)
    for m in range(begin, end):
        i, j, slot = ids[m] // width, ids[m] % width, slots[m]
        p, n = load_pixel(s.position_ws, i, j), load_pixel(s.normal_ws, i, j)
        tangent, bitangent = tangent_frame(n)
        shift_u, shift_v = uniform(ids[m], seed, 0), uniform(ids[m], seed, 1)
        for channel in range(out.shape[0]):
            out[channel, slot] = ZERO
        for k in range(samples):
            u, turn = r2_sequence(k, shift_u, shift_v)
            sine = math.sqrt(max(ZERO, ONE - u * u))
            d = to_world(Vec3(sine * math.cos(TWO * PI * turn), sine * math.sin(TWO * PI * turn), u), tangent, bitangent, n)
            column, row, depth = to_screen(s, along(p, d, radius * uniform(ids[m], seed, 2 + k)))
            y, x = int(row), int(column)
            is_seen = depth > ZERO and is_inside(s, column, row) and s.depth[y, x] < FAR
            is_open = not is_seen or s.depth[y, x] >= depth
            weight = TWO * PI / f32(samples) * u
            if sky.shape[0] == 0:
                out[3, slot] += weight if is_open else ZERO
            else:
                red, green, blue = table_at(sky, d)
                out[6, slot] += weight * red
                out[7, slot] += weight * green
                out[8, slot] += weight * blue
                if is_open:
                    out[3, slot] += weight * red
                    out[4, slot] += weight * green
                    out[5, slot] += weight * blue
            if is_open:
                continue
            away = sub(load_pixel(s.position_ws, y, x), p)
            d2 = dot(away, away)
            cosines = max(dot(n, away), ZERO) * max(-dot(load_pixel(s.normal_ws, y, x), away), ZERO)
            if cosines > ZERO:
                # a patch fills the hemisphere at most: its area over pi is the least squared distance
                weight = patch_m2 * cosines / (d2 * max(d2, patch_m2 / PI)) * near_weight(d2, fade)
                at = y * width + x
                out[0, slot] += weight * radiance[at, 0]
                out[1, slot] += weight * radiance[at, 1]
                out[2, slot] += weight * radiance[at, 2]


@pixel_jit
def _tap_table(begin, end, normal, depth, out):
    for i in range(begin, end):
        for j in range(depth.shape[1]):
            n = load_pixel(normal, i, j)
            out[i, j, 0], out[i, j, 1], out[i, j, 2], out[i, j, 3] = n.x, n.y, n.z, depth[i, j]


def tap_table(normal, depth):
    """(H W, 4) float32: normal (H, W, 3) in the world, and depth (H, W) in m with +inf for nothing; a tap is one read."""
    out = np.empty((*depth.shape, 4), np.float32)
    _tap_table(depth.shape[0], normal, depth, out)
    return out.reshape(-1, 4)


@pixel_jit
def _sent_out(begin, end, lamps, world, albedo, out):
    for i in range(begin, end):
        for j in range(out.shape[1]):
            for c in range(3):
                arrives = lamps[i, j, c] + world[i, j, c] if world.shape[0] > 0 else lamps[i, j, c]
                out[i, j, c] = arrives * albedo[i, j, c] * f32(1 / math.pi)


def sent_out(lamps, world, albedo):
    """(H, W, 3) float32 W/(m2 sr): what matt surfaces send out after light (H, W, 3) W/m2 of lamps and the world has come.

    Without the world `world` is (0, 0, 3).
    """
    out = np.empty(albedo.shape, np.float32)
    _sent_out(albedo.shape[0], lamps, world, albedo, out)
    return out


@pixel_jit
def _world_through(begin, end, table, shares, normal, mask, light, visibility):
    is_even, is_coloured = table.shape[0] == 1, shares.shape[0] == 3
    second, third = (1, 2) if is_coloured else (0, 0)
    for i in range(begin, end):
        for j in range(mask.shape[1]):
            if not mask[i, j]:
                continue
            red, green, blue = table[0, 0, 0], table[0, 0, 1], table[0, 0, 2]
            if not is_even:
                red, green, blue = table_at(table, load_pixel(normal, i, j))
            share, whole = shares[0, i, j], red + green + blue
            red, green, blue = red * share, green * shares[second, i, j], blue * shares[third, i, j]
            light[i, j, 0], light[i, j, 1], light[i, j, 2] = red, green, blue
            arrives = (red + green + blue) / whole if whole > ZERO else ONE
            visibility[i, j] = min(arrives if is_coloured else share, ONE)


def world_through(table, shares, normal, mask):
    """World light by shares of it: (irradiance (H, W, 3) W/m2, visibility (H, W)), float32; zero and 1 outside `mask`.

    `table` (n, n, 3) holds what an open surface gets, by its normal, or (1, 1, 3) for every normal; `shares` (1 or 3, H, W)
    what gets through, of all light or of each colour: so a plane under any sky has no noise. Few samples of the published
    form add up to more than an open sky; light keeps that, for its mean is right, and visibility does not.
    """
    light, visibility = np.zeros((*mask.shape, 3), np.float32), np.ones(mask.shape, np.float32)
    _world_through(mask.shape[0], table, shares, normal, mask, light, visibility)
    return light, visibility


@pixel_jit
def _to_pixels(begin, end, planes, mask, out):
    for i in range(begin, end):
        for j in range(mask.shape[1]):
            if mask[i, j]:
                out[i, j, 0], out[i, j, 1], out[i, j, 2] = planes[0, i, j], planes[1, i, j], planes[2, i, j]


def to_pixels(planes, mask):
    """(H, W, 3) float32 from planes (3, H, W); zero outside `mask`."""
    out = np.zeros((*mask.shape, 3), np.float32)
    _to_pixels(mask.shape[0], planes, mask, out)
    return out
