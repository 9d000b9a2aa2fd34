from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fploc.errors import BadFileError, FplocError
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan, read_grey_image, write_grey_image
from fploc.floorplan.walls import free_space, line_of_sight, render_plan, wall_crossings

SITES = (
    "office",
    "conference-room",
    "laboratory",
    "library",
    "shopping-mall",
    "canteen",
    "carpark",
)


def drawn(
    walls_m: list[tuple[float, float, float, float]], width_m: float = 20, height_m: float = 10
) -> FloorPlan:
    """Return a plan at 20 px/m with walls x0, y0, x1, y1 in metres; (0, 0) is its lower left corner."""
    georeference = Georeference.of_raster((0.0, height_m), 0.05)
    walls = np.zeros((round(height_m * 20), round(width_m * 20)), dtype=bool)
    for x0, y0, x1, y1 in walls_m:
        walls[round((height_m - y1) * 20) : round((height_m - y0) * 20), round(x0 * 20) : round(x1 * 20)] = (
            True
        )
    return FloorPlan("drawn", np.where(walls, 0, 255).astype(np.uint8), walls, georeference)


def f1(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """F1 of wall cells at one pixel of tolerance."""
    near = [cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0 for cells in (found, truth)]
    precision, recall = (found & near[1]).sum() / found.sum(), (truth & near[0]).sum() / truth.sum()
    return float(2 * precision * recall / (precision + recall))


@pytest.fixture(scope="module", params=SITES)
def rendered(
    request: pytest.FixtureRequest, source: Path, reference_plans: Path
) -> tuple[str, FloorPlan, Path]:
    folder = reference_plans
    entry = json.loads((folder / "georeference.json").read_text())[request.param]
    image = source / entry["source_revision"].split()[1] / entry["source_file"]
    plan = render_plan(
        image,
        native_from_metres=Georeference(np.array(entry["metres_to_native_pixels"])),
        origin_m=entry["plan_origin_metres"],
        size_px=tuple(entry["plan_size"]),
        metres_per_pixel=entry["plan_metres_per_pixel"],
        not_walls_m=entry["not_walls_polygons_m"],
        blank_boxes_px=entry["blank_native_pixel_boxes"],
        thinnest_wall_m=0.2 if request.param == "carpark" else 0.0,
        name=request.param,
    )
    return request.param, plan, folder / "plans"


class TestAgainstReferences:
    def test_drawing_is_registered(self, rendered: tuple[str, FloorPlan, Path]) -> None:
        name, plan, folder = rendered
        reference = read_grey_image(folder / f"{name}.png")
        assert plan.grey.shape == reference.shape
        shift, response = cv2.phaseCorrelate(255.0 - plan.grey, 255.0 - reference)
        assert np.hypot(*shift) < 1.0
        assert response > 0.9

    def test_walls_are_the_same(self, rendered: tuple[str, FloorPlan, Path]) -> None:
        name, plan, folder = rendered
        truth = read_grey_image(folder / f"{name}_walls.png") == 0
        # The car park's reference was cleaned by hand beyond what a rule can do.
        assert f1(plan.walls, truth) >= (0.9 if name == "carpark" else 0.95)


class TestRender:
    def native(self, tmp_path: Path) -> Path:
        """A turned image of 40 px/m: 0.1 m lines at y = 2 and x = 3, and text in its corner."""
        image = np.full((400, 800), 255, np.uint8)
        image[316:324] = 0
        image[:, 118:122] = 128
        image[:20, :50] = 0
        path = tmp_path / "native.png"
        write_grey_image(path, cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE))
        return path

    def render(self, path: Path, **changed: object) -> FloorPlan:
        # The upright image has v = 40 (10 - y) - 0.5; turned right, (u, v) becomes (399 - v, u).
        arguments: dict[str, object] = {
            "native_from_metres": Georeference(np.array([[0, 40.0, -0.5], [40.0, 0, -0.5]])),
            "origin_m": (0.0, 10.0),
            "size_px": (400, 200),
            "not_walls_m": [],
            "blank_boxes_px": [],
        } | changed
        return render_plan(path, **arguments)  # type: ignore[arg-type]

    def test_lines_lie_where_they_were_drawn(self, tmp_path: Path) -> None:
        plan = self.render(self.native(tmp_path))
        assert plan.grey.shape == plan.walls.shape == (200, 400)
        rows = np.flatnonzero(plan.walls[:, 200])
        y_m = plan.georeference.to_metres(np.column_stack([np.full(len(rows), 200), rows]))[:, 1]
        np.testing.assert_allclose([y_m.mean(), len(rows) * 0.05], [2.0, 0.2], atol=0.01)
        columns = np.flatnonzero(plan.walls[100])
        x_m = plan.georeference.to_metres(np.column_stack([columns, np.full(len(columns), 100)]))[:, 0]
        np.testing.assert_allclose([x_m.mean(), len(columns) * 0.05], [3.0, 0.1], atol=0.01)
        assert plan.grey[100, columns].tolist() == [128, 128]

    def test_what_is_blanked(self, tmp_path: Path) -> None:
        path = self.native(tmp_path)
        plain = self.render(path)
        assert plain.walls[5, 5]
        # The turned image has its text at the right edge.
        blanked = self.render(path, blank_boxes_px=[[380, 0, 400, 50]])
        assert not blanked.walls[:10, :25].any()
        opened = self.render(path, not_walls_m=[[[10, 1], [20, 1], [20, 3], [10, 3]]])
        assert opened.walls[:, 100].any()
        assert not opened.walls[:, 300].any()
        np.testing.assert_array_equal(opened.grey, plain.grey)

    def test_thin_lines_can_be_dropped(self, tmp_path: Path) -> None:
        plan = self.render(self.native(tmp_path), thinnest_wall_m=0.15)
        assert not plan.walls[100].any()
        assert plan.walls[:, 200].any()

    @pytest.mark.parametrize(
        ("thinnest_wall_m", "horizontal", "vertical"),
        [(0.05, True, True), (0.1, True, True), (0.2, True, False), (0.25, False, False)],
    )
    def test_only_lines_thinner_than_asked_for_are_dropped(
        self, tmp_path: Path, thinnest_wall_m: float, horizontal: bool, vertical: bool
    ) -> None:
        plan = self.render(self.native(tmp_path), thinnest_wall_m=thinnest_wall_m)
        # The line at y = 2 is 0.2 m thick, the one at x = 3 is 0.1 m.
        assert (plan.walls[:, 200].sum(), plan.walls[100].sum()) == (4 * horizontal, 2 * vertical)

    def test_a_box_from_the_corner_and_its_edges(self, tmp_path: Path) -> None:
        image = np.zeros((40, 40), np.uint8)
        write_grey_image(tmp_path / "black.png", image)
        plan = self.render(
            tmp_path / "black.png",
            native_from_metres=Georeference.of_raster((0.0, 2.0), 0.05),
            origin_m=(0.0, 2.0),
            size_px=(40, 40),
            blank_boxes_px=[[0, 0, 10, 5], [30, 35, 40, 40]],
        )
        expected = np.ones((40, 40), dtype=bool)
        expected[:5, :10] = expected[35:, 30:] = False
        np.testing.assert_array_equal(plan.walls, expected)
        assert plan.name == "black"

    def test_beyond_the_image_is_free(self, tmp_path: Path) -> None:
        write_grey_image(tmp_path / "black.png", np.zeros((40, 40), np.uint8))
        plan = self.render(
            tmp_path / "black.png",
            native_from_metres=Georeference.of_raster((0.0, 2.0), 0.05),
            origin_m=(-1.0, 3.0),
            size_px=(80, 80),
            name="larger",
        )
        expected = np.zeros((80, 80), dtype=bool)
        expected[20:60, 20:60] = True
        np.testing.assert_array_equal(plan.walls, expected)
        assert plan.name == "larger"

    def test_bad_input(self, tmp_path: Path) -> None:
        path = self.native(tmp_path)
        with pytest.raises(FplocError, match="box to blank"):
            self.render(path, blank_boxes_px=[[10, 0, 5, 5]])
        with pytest.raises(FplocError, match="polygon 1"):
            self.render(path, not_walls_m=[[[0, 0], [1, 1]]])
        with pytest.raises(FplocError, match="inside the image"):
            self.render(path, origin_m=(1000.0, 1000.0))
        text = tmp_path / "plan.jpg"
        text.write_text("no image")
        with pytest.raises(BadFileError, match=r"plan\.jpg"):
            self.render(text)


class TestCrossings:
    # Two walls across the plan, 0.2 m and 0.5 m thick, and a pillar.
    plan = drawn([(5, 0, 5.2, 10), (10, 0, 10.5, 10), (14, 4, 15, 5)])

    def test_known_walls(self) -> None:
        starts = [[1, 2], [1, 2], [1, 2], [6, 2], [16, 4.5], [5.1, 1]]
        ends = [[4, 9], [7, 2], [12, 2], [9, 9], [1, 4.5], [5.1, 9]]
        crossings = wall_crossings(self.plan, starts, ends)
        assert crossings.count.tolist() == [0, 1, 2, 0, 3, 1]
        np.testing.assert_allclose(crossings.thickness_m, [0, 0.2, 0.7, 0, 1.7, 8.0], atol=0.03)

    def test_aslant_is_longer(self) -> None:
        crossings = wall_crossings(self.plan, [[3, 2]], [[8, 7]])
        assert crossings.thickness_m[0] == pytest.approx(0.2 * np.sqrt(2), abs=0.03)

    def test_either_way_and_one_by_one_alike(self) -> None:
        rng = np.random.default_rng(0)
        starts, ends = rng.uniform([-2, -2], [22, 12], size=(2, 300, 2))
        together = wall_crossings(self.plan, starts, ends)
        back = wall_crossings(self.plan, ends, starts)
        np.testing.assert_array_equal(together.count, back.count)
        np.testing.assert_allclose(together.thickness_m, back.thickness_m, atol=0.03)
        single = [wall_crossings(self.plan, starts[i], ends[i]) for i in range(20)]
        assert [int(one.count[0]) for one in single] == together.count[:20].tolist()

    def test_memory_does_not_change_the_result(self, monkeypatch: pytest.MonkeyPatch) -> None:
        starts, ends = np.random.default_rng(1).uniform([0, 0], [20, 10], size=(2, 100, 2))
        whole = wall_crossings(self.plan, starts, ends)
        monkeypatch.setattr("fploc.floorplan.walls._SAMPLES_AT_ONCE", 500)
        chunked = wall_crossings(self.plan, starts, ends)
        np.testing.assert_array_equal(whole.count, chunked.count)
        np.testing.assert_array_equal(whole.thickness_m, chunked.thickness_m)

    def test_no_links_and_links_without_length(self) -> None:
        assert wall_crossings(self.plan, np.empty((0, 2)), np.empty((0, 2))).count.shape == (0,)
        crossings = wall_crossings(self.plan, [[5.1, 5], [1, 1]], [[5.1, 5], [1, 1]])
        assert crossings.count.tolist() == [1, 0]
        assert crossings.thickness_m.tolist() == [0, 0]

    def test_a_wall_of_one_pixel_is_never_stepped_over(self) -> None:
        plan = drawn([(9, 0, 9.05, 10)])
        rng = np.random.default_rng(2)
        starts, ends = rng.uniform([0, 0], [8.9, 10], (500, 2)), rng.uniform([9.1, 0], [20, 10], (500, 2))
        assert (wall_crossings(plan, starts, ends).count == 1).all()

    @pytest.mark.parametrize("turned", [False, True])
    def test_a_wall_begins_and_ends_at_its_faces(self, turned: bool) -> None:
        # One wall along y from x = 9 to 9.2 m, or one along x from y = 5 to 5.2 m.
        plan = drawn([(0, 5, 20, 5.2) if turned else (9, 0, 9.2, 10)])
        low, high = (5.0, 5.2) if turned else (9.0, 9.2)
        across = np.array([[low - 1.0, low - 0.01], [low - 1.0, low + 0.04], [high + 0.01, high + 1.0]])
        across = np.vstack([across, [high - 0.04, high + 1.0]])
        along = np.full_like(across, 3.0)
        points = np.stack([along, across] if turned else [across, along], axis=-1)
        assert wall_crossings(plan, points[:, 0], points[:, 1]).count.tolist() == [0, 1, 0, 1]

    def test_nothing_beyond_the_plan_is_a_wall(self) -> None:
        # A wall along every edge of the sheet, met from inside and never from outside.
        plan = drawn([(0, 0, 20, 0.05), (0, 9.95, 20, 10), (0, 0, 0.05, 10), (19.95, 0, 20, 10)])
        starts = [[-1, -0.03], [-1, 10.03], [-0.03, -1], [20.03, -1], [-5, 30]]
        ends = [[21, -0.03], [21, 10.03], [-0.03, 11], [20.03, 11], [25, 30]]
        assert wall_crossings(plan, starts, ends).count.tolist() == [0] * 5
        assert wall_crossings(plan, [[-1, 5], [10, -1]], [[21, 5], [10, 11]]).count.tolist() == [2, 2]

    def test_line_of_sight(self) -> None:
        starts, ends = [[1, 2], [1, 2], [5.1, 5]], [[4, 9], [7, 2], [8, 5]]
        assert line_of_sight(self.plan, starts, ends).tolist() == [True, False, False]
        # An access point inside the drawn wall that it hangs on sees the room before it.
        assert line_of_sight(self.plan, starts, ends, end_margin_m=0.3).tolist() == [True, False, True]


class TestFreeSpace:
    # A building of two rooms joined by a door of 1 m, with an entrance of 1 m, and a closed room.
    walls = (
        (2, 2, 18, 2.2), (2, 7.8, 9, 8), (10, 7.8, 18, 8), (2, 2, 2.2, 8), (17.8, 2, 18, 8),
        (8, 2, 8.2, 4), (8, 5, 8.2, 8), (14, 2, 14.2, 8),
    )  # fmt: skip

    def at(self, plan: FloorPlan, cells: NDArray[np.bool_], x_m: float, y_m: float) -> bool:
        column, row = np.round(plan.georeference.to_pixels([x_m, y_m])).astype(int)
        return bool(cells[row, column])

    def test_rooms_with_doors_are_reached_and_outdoors_is_not(self) -> None:
        plan = drawn(list(self.walls))
        cells = free_space(plan, [[2.3, 5], [7.5, 7.7]])
        assert self.at(plan, cells, 4, 4)
        assert self.at(plan, cells, 11, 5)
        assert not self.at(plan, cells, 16, 5)
        assert not self.at(plan, cells, 9.5, 9.5)
        assert not self.at(plan, cells, 1, 1)

    def test_clearance(self) -> None:
        plan = drawn(list(self.walls))
        cells = free_space(plan, [[4, 4]], clearance_m=0.4)
        assert not self.at(plan, cells, 2.2 + 0.3, 5)
        assert self.at(plan, cells, 2.2 + 0.5, 5)
        # The door of 1 m lets no one through who keeps 0.6 m away from its posts.
        assert not self.at(plan, free_space(plan, [[4, 4]], clearance_m=0.6), 11, 5)

    def test_margin_bounds_what_no_wall_does(self) -> None:
        plan = drawn([(0, 0, 40, 0.2)], width_m=40, height_m=10)
        cells = free_space(plan, [[18, 1], [20, 1]], margin_m=3.0)
        assert self.at(plan, cells, 15.5, 2)
        assert not self.at(plan, cells, 14, 2)
        assert not self.at(plan, cells, 19, 4.5)

    def test_nothing_free_near_any_seed(self) -> None:
        plan = drawn([(0, 0, 20, 10)])
        with pytest.raises(FplocError, match="no cell"):
            free_space(plan, [[5, 5]])

    def test_cells_are_free_from_the_clearance_on(self) -> None:
        # Cell centres lie 0.025, 0.075, … m from the face of the wall; all of the strip is within the margin.
        plan = drawn([(0, 0, 20, 0.5), (0, 9.5, 20, 10), (0, 0, 0.5, 10), (19.5, 0, 20, 10)])
        cells = free_space(plan, [[10, 5]], clearance_m=0.3, margin_m=20.0)
        expected = np.zeros_like(cells)
        expected[16:-16, 16:-16] = True
        np.testing.assert_array_equal(cells, expected)
        exactly = free_space(plan, [[10, 5]], clearance_m=5.5 / 20, margin_m=20.0)
        expected[15:-15, 15:-15] = True
        np.testing.assert_array_equal(exactly, expected)
        np.testing.assert_array_equal(free_space(plan, [[10, 5]], margin_m=20.0), cells)

    def test_the_box_reaches_as_far_as_the_margin(self) -> None:
        plan = drawn([(0, 0, 40, 0.2)], width_m=40, height_m=40)
        cells = free_space(plan, [[18, 20], [20, 21]], margin_m=3.0)
        height, width = cells.shape
        x_m, y_m = np.moveaxis(
            plan.georeference.to_metres(np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)), -1, 0
        )
        np.testing.assert_array_equal(cells, (abs(x_m - 19) <= 4) & (abs(y_m - 20.5) <= 3.5))

    @pytest.mark.parametrize(("entrance_m", "is_indoors"), [(2.8, True), (3.2, False)])
    def test_outdoors_comes_in_through_what_is_3_m_wide(self, entrance_m: float, is_indoors: bool) -> None:
        # Two rooms; the right one opens to the outside. Most access points hang in the closed one.
        walls = [(2, 1, 18, 1.2), (2, 8.8, 18, 9), (2, 1, 2.2, 9), (9.9, 1, 10.1, 4.5), (9.9, 5.5, 10.1, 9)]
        low = 5 - entrance_m / 2
        walls += [(17.8, 1, 18, low), (17.8, low + entrance_m, 18, 9)]
        cells = free_space(drawn(walls), [[3, 3], [4, 7], [8, 4], [16, 5]])
        assert self.at(drawn(walls), cells, 5, 5)
        assert self.at(drawn(walls), cells, 16, 5) is is_indoors

    @pytest.mark.parametrize("side", [[1, 0], [-1, 0], [0, 1], [0, -1]])
    def test_a_seed_stands_for_floor_up_to_one_and_a_half_metres_away(self, side: list[int]) -> None:
        # All wall but a room of 2 m × 2 m around (10, 5), of which cells 0.3 m from its walls are free.
        plan = drawn([(0, 0, 20, 4), (0, 6, 20, 10), (0, 4, 9, 6), (11, 4, 20, 6)])
        near, far = (np.add([10.0, 5.0], np.multiply(side, 0.7 + away)) for away in (1.4, 1.6))
        assert free_space(plan, [near]).any()
        with pytest.raises(FplocError, match="no cell"):
            free_space(plan, [far])

    def test_rooms_that_touch_at_a_corner_are_not_joined(self) -> None:
        # At 0 m of clearance two rooms of free cells meet at one corner of a cell.
        walls = [(0, 0, 20, 1), (0, 9, 20, 10), (0, 0, 1, 10), (19, 0, 20, 10), (1, 1, 10, 5), (10, 5, 19, 9)]
        cells = free_space(drawn(walls), [[5, 7]], clearance_m=0.0)
        assert self.at(drawn(walls), cells, 5, 7)
        assert not self.at(drawn(walls), cells, 15, 3)
