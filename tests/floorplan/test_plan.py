from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan, read_floor_plan, read_grey_image, write_grey_image

GEOREFERENCE = Georeference.of_raster((0.0, 2.0), 0.05)


def test_written_and_read_again(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(0, 256, size=(40, 60), dtype=np.uint8)
    plan = FloorPlan("drawn", grey, grey < 200, GEOREFERENCE)
    plan.write(tmp_path / "plan.png", tmp_path / "walls.png")
    again = read_floor_plan(tmp_path / "plan.png", tmp_path / "walls.png", GEOREFERENCE, "drawn")
    np.testing.assert_array_equal(again.grey, plan.grey)
    np.testing.assert_array_equal(again.walls, plan.walls)
    assert (again.name, again.georeference) == ("drawn", GEOREFERENCE)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plan.png", "walls.png"]


@pytest.mark.parametrize(
    "contents",
    [b"", b"x,y\n1,2\n", b"\x89PNG\r\n\x1a\n truncated", b"P5 100000 100000 255\n" + bytes(100)],
)
def test_plan_that_is_no_image(tmp_path: Path, contents: bytes) -> None:
    path = tmp_path / "plan.png"
    path.write_bytes(contents)
    with pytest.raises(BadFileError, match=r"plan\.png.*PNG or JPEG"):
        read_grey_image(path)


def test_missing_plan(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"plan\.png"):
        read_grey_image(tmp_path / "plan.png")


def test_rasters_of_two_sizes(tmp_path: Path) -> None:
    write_grey_image(tmp_path / "plan.png", np.zeros((4, 5), np.uint8))
    write_grey_image(tmp_path / "walls.png", np.zeros((4, 6), np.uint8))
    with pytest.raises(BadFileError, match=r"walls\.png.*6 x 4.*5 x 4"):
        read_floor_plan(tmp_path / "plan.png", tmp_path / "walls.png", GEOREFERENCE, "drawn")


def test_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(self: Path, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="No space"):
        write_grey_image(tmp_path / "plan.png", np.zeros((4, 5), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_a_blank_plan_is_the_same_sheet_with_nothing_on_it() -> None:
    grey = np.random.default_rng(0).integers(0, 256, size=(40, 60), dtype=np.uint8)
    blank = FloorPlan("drawn", grey, grey < 200, GEOREFERENCE).blank()
    assert (blank.name, blank.georeference) == ("drawn, blank", GEOREFERENCE)
    np.testing.assert_array_equal(blank.grey, np.full((40, 60), 255, np.uint8))
    np.testing.assert_array_equal(blank.walls, np.zeros((40, 60), bool))
    assert (blank.grey.dtype, blank.walls.dtype) == (np.uint8, np.bool_)


def test_a_plan_in_the_place_of_another_keeps_its_drawing_and_scale() -> None:
    grey = np.random.default_rng(0).integers(0, 256, size=(40, 60), dtype=np.uint8)
    plan = FloorPlan("one", grey, grey < 200, GEOREFERENCE)
    other = FloorPlan("other", grey[:5], grey[:5] < 200, Georeference.of_raster((-7.0, 31.0), 0.1))
    placed = plan.placed_as(other)
    assert placed.name == "one"
    np.testing.assert_array_equal(placed.grey, plan.grey)
    np.testing.assert_allclose(placed.georeference.to_metres([-0.5, -0.5]), [-7.0, 31.0])
    np.testing.assert_allclose(
        placed.georeference.to_metres([59.5, 39.5]), [-7.0 + 60 * 0.05, 31.0 - 40 * 0.05]
    )


def test_walls_of_a_soft_image_are_what_is_nearer_to_black(tmp_path: Path) -> None:
    write_grey_image(tmp_path / "plan.png", np.full((1, 4), 255, np.uint8))
    write_grey_image(tmp_path / "walls.png", np.array([[0, 127, 128, 255]], np.uint8))
    plan = read_floor_plan(tmp_path / "plan.png", tmp_path / "walls.png", GEOREFERENCE, "soft")
    assert plan.walls.tolist() == [[True, True, False, False]]
