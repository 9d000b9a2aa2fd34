"""Pixel ↔ metre: the frame of an image against the frame of a site."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fploc.errors import FplocError

Floats = NDArray[np.float64]

# A direction in which control points spread less than this part of their largest spread is no direction.
_LEAST_SPREAD = 1e-3
# A matrix that shrinks one direction this many times more than the other has no usable inverse.
_GREATEST_CONDITION = 1e9


@dataclass(frozen=True, eq=False)
class Georeference:
    """An affine map from metres of a site frame to pixels of one image.

    A pixel is ``(u, v)``: u the column, v the row counted downwards; integers are pixel *centres* (as in
    OpenCV), so the top-left pixel covers u and v from −0.5 to 0.5.

    Args:
        pixels_from_metres: Matrix M, shape (2, 3): ``(u, v) = M @ (x, y, 1)``.

    Raises:
        FplocError: If the matrix has another shape, holds no finite numbers or cannot be inverted.
    """

    pixels_from_metres: Floats

    def __post_init__(self) -> None:
        """Check the matrix and freeze a copy of it."""
        matrix = np.array(self.pixels_from_metres, dtype=np.float64)
        if matrix.shape != (2, 3) or not np.isfinite(matrix).all():
            raise FplocError(
                "georeference matrix (metres to pixels)",
                value=np.array2string(matrix, separator=", ").replace("\n", ""),
                expected="2 rows of 3 finite numbers",
                way_out="give it as [[a, b, u0], [c, d, v0]]",
            )
        if np.linalg.cond(matrix[:, :2]) > _GREATEST_CONDITION:
            raise FplocError(
                "georeference matrix (metres to pixels)",
                value=np.array2string(matrix, separator=", ").replace("\n", ""),
                expected="a matrix that can be inverted",
                way_out="fit it again from at least three points that do not lie on one line",
            )
        matrix.setflags(write=False)
        object.__setattr__(self, "pixels_from_metres", matrix)

    @classmethod
    def of_raster(cls, origin_m: ArrayLike, metres_per_pixel: float) -> Georeference:
        """Return the georeference of a raster whose columns run along x and whose rows run down along −y.

        Args:
            origin_m: Outer corner of the top-left pixel, shape (2,), metres.
            metres_per_pixel: Side of a pixel.

        Raises:
            FplocError: If ``metres_per_pixel`` is not positive.
        """
        if not metres_per_pixel > 0:
            raise FplocError(
                "metres_per_pixel of a plan",
                value=metres_per_pixel,
                expected="a number above 0",
                way_out="give the side of a pixel in metres, for example 0.05",
            )
        x_m, y_m = np.asarray(origin_m, dtype=np.float64)
        scale = 1.0 / metres_per_pixel
        return cls(np.array([[scale, 0.0, -x_m * scale - 0.5], [0.0, -scale, y_m * scale - 0.5]]))

    @property
    def metres_from_pixels(self) -> Floats:
        """The inverse map, shape (2, 3): ``(x, y) = N @ (u, v, 1)``."""
        linear = np.linalg.inv(self.pixels_from_metres[:, :2])
        return np.column_stack([linear, -linear @ self.pixels_from_metres[:, 2]])

    @property
    def pixels_per_metre(self) -> float:
        """Geometric mean of the two scales: exact where the map is a similarity."""
        return float(np.sqrt(abs(np.linalg.det(self.pixels_from_metres[:, :2]))))

    def to_pixels(self, points_m: ArrayLike) -> Floats:
        """Return where points (…, 2) in metres lie in the image, shape (…, 2), pixels (u, v)."""
        points = np.asarray(points_m, dtype=np.float64)
        return points @ self.pixels_from_metres[:, :2].T + self.pixels_from_metres[:, 2]

    def to_metres(self, points_px: ArrayLike) -> Floats:
        """Return where image points (…, 2), pixels (u, v), lie in the site, shape (…, 2), metres."""
        inverse = self.metres_from_pixels
        return np.asarray(points_px, dtype=np.float64) @ inverse[:, :2].T + inverse[:, 2]


@dataclass(frozen=True, eq=False)
class GeoreferenceFit:
    """A fitted georeference, and how far from its points it came to lie.

    Args:
        georeference: The map.
        residuals_m: Distance of each point's pixel, taken to metres, from its metres, shape (N,).
    """

    georeference: Georeference
    residuals_m: Floats


def fit_georeference(points_m: ArrayLike, points_px: ArrayLike) -> GeoreferenceFit:
    """Fit a map from metres to pixels to points known in both: affine, by least squares.

    Args:
        points_m: Points in the site frame, shape (N, 2), metres; N ≥ 3, not on one line.
        points_px: The same points in the image, shape (N, 2), pixels (u, v).

    Raises:
        FplocError: If there are fewer than three points, the two lists differ in length, a number is not
            finite, or the points lie on one line in either frame.
    """
    metres, pixels = _checked_points(points_m, "metres"), _checked_points(points_px, "pixels")
    if len(metres) != len(pixels):
        raise FplocError(
            "georeference points",
            value=f"{len(metres)} points in metres and {len(pixels)} in pixels",
            expected="as many in metres as in pixels",
            way_out="give every point in both frames, in one order",
        )
    with_one = np.column_stack([metres, np.ones(len(metres))])
    solution: Floats = np.linalg.lstsq(with_one, pixels, rcond=None)[0].astype(np.float64)
    georeference = Georeference(solution.T)
    return GeoreferenceFit(
        georeference=georeference,
        residuals_m=np.linalg.norm(georeference.to_metres(pixels) - metres, axis=1),
    )


def fit_similarity(points_m: ArrayLike, points_px: ArrayLike) -> GeoreferenceFit:
    """Fit a map of one scale and one turn (with the flip from y up to rows down), by least squares.

    Better than ``fit_georeference`` where the plan is drawn true to scale and the points are few or
    imprecise. The flip is taken from the points, so that mirrored drawings fit as well (Umeyama 1991).

    Args:
        points_m: Points in the site frame, shape (N, 2), metres; N ≥ 3, not on one line.
        points_px: The same points in the image, shape (N, 2), pixels (u, v).

    Raises:
        FplocError: As ``fit_georeference``.
    """
    affine = fit_georeference(points_m, points_px).georeference
    metres, pixels = np.asarray(points_m, np.float64), np.asarray(points_px, np.float64)
    centre_m, centre_px = metres.mean(axis=0), pixels.mean(axis=0)
    covariance = (pixels - centre_px).T @ (metres - centre_m)
    left, spread, right = np.linalg.svd(covariance)
    flip = np.sign(np.linalg.det(affine.pixels_from_metres[:, :2]) * np.linalg.det(left @ right))
    signs = np.array([1.0, flip])
    rotation = left @ np.diag(signs) @ right
    scale = float((spread * signs).sum() / ((metres - centre_m) ** 2).sum())
    linear = scale * rotation
    georeference = Georeference(np.column_stack([linear, centre_px - linear @ centre_m]))
    return GeoreferenceFit(
        georeference=georeference,
        residuals_m=np.linalg.norm(georeference.to_metres(pixels) - metres, axis=1),
    )


def _checked_points(points: ArrayLike, frame: str) -> Floats:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1:] != (2,) or len(array) < 3:
        raise FplocError(
            f"georeference points in {frame}",
            value=f"an array of shape {array.shape}",
            expected="at least 3 points of 2 numbers each",
            way_out="give more points, for example corners of the building",
        )
    if not np.isfinite(array).all():
        raise FplocError(
            f"georeference point {int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0]) + 1} in {frame}",
            value=array[~np.isfinite(array).all(axis=1)][0].tolist(),
            expected="two finite numbers",
            way_out="correct the point or leave it out",
        )
    spread = np.linalg.svd(array - array.mean(axis=0), compute_uv=False)
    if spread[1] <= _LEAST_SPREAD * spread[0]:
        raise FplocError(
            f"georeference points in {frame}",
            value=f"{len(array)} points on one line: {array.tolist()}",
            expected="points that do not lie on one line",
            way_out="add a point away from that line",
        )
    return array
