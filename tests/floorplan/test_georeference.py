from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fploc.errors import FplocError
from fploc.floorplan.georeference import Georeference, fit_georeference, fit_similarity

angles = st.floats(-np.pi, np.pi)
scales = st.floats(0.5, 200.0)
shifts = st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
CORNERS_M = np.array([[0.0, 0.0], [12.0, 1.0], [11.0, 8.0], [-3.0, 6.0]])


def similarity(angle: float, scale: float, shift: tuple[float, float], mirrored: bool) -> Georeference:
    flip = np.diag([1.0, 1.0 if mirrored else -1.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Georeference(np.column_stack([scale * turn @ flip, shift]))


@given(angles, scales, shifts, st.booleans())
def test_there_and_back(angle: float, scale: float, shift: tuple[float, float], mirrored: bool) -> None:
    georeference = similarity(angle, scale, shift, mirrored)
    points = np.random.default_rng(0).uniform(-50, 50, size=(3, 4, 2))
    there = georeference.to_pixels(points)
    assert there.shape == points.shape
    np.testing.assert_allclose(georeference.to_metres(there), points, atol=1e-6)
    assert georeference.pixels_per_metre == pytest.approx(scale)


def test_raster_puts_the_corner_of_its_first_pixel_at_the_origin() -> None:
    georeference = Georeference.of_raster((-16.0, 29.0), 0.05)
    np.testing.assert_allclose(georeference.to_metres([[-0.5, -0.5]]), [[-16.0, 29.0]])
    # x = origin + (column + 0.5) * side; y = origin - (row + 0.5) * side
    np.testing.assert_allclose(georeference.to_metres([[3, 7]]), [[-16 + 3.5 * 0.05, 29 - 7.5 * 0.05]])


@given(angles, scales, shifts, st.booleans())
def test_both_fits_give_back_a_similarity(
    angle: float, scale: float, shift: tuple[float, float], mirrored: bool
) -> None:
    truth = similarity(angle, scale, shift, mirrored)
    for fit in (fit_georeference, fit_similarity):
        fitted = fit(CORNERS_M, truth.to_pixels(CORNERS_M))
        np.testing.assert_allclose(
            fitted.georeference.to_pixels(CORNERS_M), truth.to_pixels(CORNERS_M), atol=1e-4
        )
        assert fitted.residuals_m.max() < 1e-4


def test_residuals_are_metres() -> None:
    truth = similarity(0.3, 20.0, (5.0, 5.0), False)
    pixels = truth.to_pixels(CORNERS_M)
    pixels[2] += [20.0, 0.0]
    fitted = fit_similarity(CORNERS_M, pixels)
    assert 0.2 < fitted.residuals_m.max() < 1.0
    assert fitted.residuals_m.argmax() == 2


@pytest.mark.parametrize(
    ("points_m", "points_px", "message"),
    [
        ([[0, 0], [1, 1], [2, 2]], [[0, 0], [5, 1], [3, 9]], "one line"),
        ([[0, 0], [5, 1], [3, 9]], [[0, 0], [10, 10], [20, 20]], "pixels.*one line"),
        ([[3, 3], [3, 3], [3, 3]], [[0, 0], [5, 1], [3, 9]], "one line"),
        ([[0, 0], [1, 0]], [[0, 0], [1, 0]], "at least 3 points"),
        ([[0, 0], [1, 0], [0, 1], [5, 5]], [[0, 0], [1, 0], [0, 1]], "as many in metres as in pixels"),
        ([[0, 0], [1, np.nan], [0, 1]], [[0, 0], [1, 0], [0, 1]], "point 2 in metres"),
    ],
)
def test_points_that_fix_no_map(points_m: list, points_px: list, message: str) -> None:
    with pytest.raises(FplocError, match=message):
        fit_georeference(points_m, points_px)


@pytest.mark.parametrize(
    "matrix", [[[1, 2, 0], [2, 4, 0]], [[0, 0, 0], [0, 0, 0]], [[1, 0, np.nan], [0, 1, 0]], [[1, 0], [0, 1]]]
)
def test_matrix_without_an_inverse(matrix: list) -> None:
    with pytest.raises(FplocError, match="georeference matrix"):
        Georeference(np.array(matrix))


def test_raster_without_a_scale() -> None:
    with pytest.raises(FplocError, match="metres_per_pixel"):
        Georeference.of_raster((0, 0), 0.0)


def test_nobody_can_change_the_matrix_of_a_georeference() -> None:
    matrix = np.array([[20.0, 0.0, 0.0], [0.0, -20.0, 100.0]])
    georeference = Georeference(matrix)
    with pytest.raises(ValueError, match="read-only"):
        georeference.pixels_from_metres[0, 0] = 1.0
    matrix[0, 0] = 1.0
    assert georeference.pixels_per_metre == pytest.approx(20.0)
