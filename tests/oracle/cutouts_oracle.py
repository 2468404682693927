"""Light through cut-out triangles in float64: every triangle asked, maps looked up by the formula of bilinear filtering."""

from __future__ import annotations

import numpy as np

from rtgi_addon.core.frame import Cutouts


def opacity(cutouts: Cutouts, triangle: int, u: float, v: float) -> float:
    """Opacity at barycentric (u, v) of a triangle: texels weighed by tents around their middles, the map repeated."""
    row = cutouts.row[triangle]
    if row < 0:
        return 1.0
    start, height, width = (int(n) for n in cutouts.place[row])
    texels = cutouts.texels[start:start + height * width].reshape(height, width).astype(np.float64) / 255
    corners = cutouts.uv[row].astype(np.float64)
    x, y = (1 - u - v) * corners[0] + u * corners[1] + v * corners[2]

    def weights(at: float, number: int) -> np.ndarray:
        # distance to each texel's middle and to its two nearest repeats; one texel is its own neighbour
        middles = (np.arange(number) + 0.5) / number
        away = (at - middles + 0.5) % 1 - 0.5
        if number == 1:
            return np.ones(1)
        tents = np.maximum(1 - np.abs(away[:, None] + np.array([-1, 0, 1])) * number, 0)
        return tents.sum(1)

    return float(weights(y, height) @ texels @ weights(x, width))


def meetings(origin: np.ndarray, vector: np.ndarray, corners: np.ndarray) -> list[tuple[float, int, float, float]]:
    """(t, triangle, u, v) of every triangle that the segment meets, by Cramer's rule, in order of t."""
    found = []
    for k, (a, b, c) in enumerate(corners.astype(np.float64)):
        matrix = np.stack([-vector, b - a, c - a], 1)
        if abs(np.linalg.det(matrix)) > 0:
            t, u, v = np.linalg.solve(matrix, origin - a)
            if t > 0 and u >= 0 and v >= 0 and u + v <= 1:
                found.append((t, k, u, v))
    return sorted(found)


def visibility(origin: np.ndarray, vector: np.ndarray, corners: np.ndarray, cutouts: Cutouts) -> float:
    """Share of light along the segment: the product of what each triangle lets through, nothing behind too many."""
    shares = [1 - opacity(cutouts, k, u, v) for t, k, u, v in meetings(origin, vector, corners)
              if t < 0.9999]                     # a target lies on a surface itself
    return float(np.prod(shares)) if len(shares) <= cutouts.most_layers else 0.0
