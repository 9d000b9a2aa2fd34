from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

import fploc.experiments.model as modelling
import fploc.experiments.scoring as scoring
from fploc.datasets.packed import read_packed
from fploc.errors import FplocError, MissingArtifactError, MissingFileError, UnknownNameError
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.records import Record
from fploc.experiments.model_card import model_card
from fploc.experiments.scoring import answer
from fploc.methods.learned_grid import LearnedGrid, LearnedGridSettings
from fploc.shipped import POOLED

READ = LearnedGridSettings.read()
SMALL = replace(
    READ,
    coarse=replace(READ.coarse, cell_m=1.0),
    lessons=replace(READ.lessons, rows=2, hidden=8, epochs=1, fewest_steps=20),
)
LEFT_OUT = EvaluationRequest("zero-shot-pooled", "laboratory", device="1", labels="repaired", thin=5)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, pack: Callable[..., None]) -> Path:
    folder = tmp_path_factory.mktemp("model")
    pack(folder, "office", seed=3, laps=2, duration_s=12.0)
    pack(folder, "library", seed=4, laps=1, duration_s=12.0)
    pack(folder, "laboratory", seed=5, laps=1, duration_s=12.0)
    return folder


@pytest.fixture(scope="module")
def made(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Record]]:
    """Folder of runs with a model that did not see the laboratory, and its records."""
    runs = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(modelling, "LearnedGrid", partial(LearnedGrid, SMALL))
        return runs, modelling.make_model(["laboratory"], root, runs, None)


@pytest.fixture
def learned_there(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What ships has learned where the laboratory and the library of the test are."""
    places = {read_packed(root, site).site.place for site in ("laboratory", "library")}
    monkeypatch.setattr(scoring, "learned_places", lambda artifact: places)


@pytest.mark.usefixtures("learned_there")
def test_a_site_that_was_learned_at_is_scored_without_its_place(
    made: tuple[Path, list[Record]], root: Path
) -> None:
    runs, records = made
    answered = answer("default", replace(LEFT_OUT, thin=1, device="all"), None, root, runs)
    whole = [one for one in answered if one.filter == "own"]
    assert [one.rmse_m for one in whole] == [one.rmse_m for one in records]
    assert {one.artifact for one in whole} == {"model/zero-shot-pooled/laboratory/learned-grid/seed-0"}
    assert {one.method for one in whole} == {"default"}


@pytest.mark.usefixtures("learned_there")
def test_where_that_is_missing_the_command_is_named(made: tuple[Path, list[Record]], root: Path) -> None:
    with pytest.raises(MissingArtifactError, match="make it: fploc model --sites library"):
        answer("default", replace(LEFT_OUT, site="library"), None, root, made[0])


def test_another_site_takes_what_ships_with_nothing_packed_beside_it(
    tmp_path: Path, pack: Callable[..., None]
) -> None:
    pack(tmp_path, "barn", seed=6, laps=1, duration_s=12.0)
    for protocol in ("zero-shot-pooled", "zero-shot"):
        records = answer(
            "default", replace(LEFT_OUT, protocol=protocol, site="barn"), None, tmp_path, tmp_path
        )
        for one in records:
            assert one.artifact == f"pretrained/model/{protocol}/any-site/learned-grid/seed-0"
            assert one.rmse_m is not None and one.calibration == "source-los"


def test_a_calibration_of_ones_own_takes_the_place_of_the_trained_one(root: Path, tmp_path: Path) -> None:
    (plain, _), (moved, _) = (answer("default", LEFT_OUT, one, root, tmp_path) for one in (None, "4.0"))
    assert moved.calibration == "4.0" and moved.rmse_m != plain.rmse_m


def test_what_ships_needs_every_site_that_it_learns_at(root: Path, tmp_path: Path) -> None:
    with pytest.raises(
        MissingFileError, match=r"office-position1, .*fploc data build --sites office-position1,"
    ):
        modelling.make_model([], root, tmp_path, tmp_path / "out")


@pytest.mark.parametrize(
    ("site", "error"), [("moon", UnknownNameError), ("office", FplocError)], ids=["unknown", "source"]
)
def test_sites_that_cannot_be_left_out_are_named(
    site: str, error: type[FplocError], root: Path, tmp_path: Path
) -> None:
    with pytest.raises(error, match=site):
        modelling.make_model([site], root, tmp_path, None)


def test_another_seed_is_refused(root: Path, tmp_path: Path) -> None:
    with pytest.raises(FplocError, match="--seed with --method default: found 3"):
        answer("default", replace(LEFT_OUT, seed=3), None, root, tmp_path)


def test_the_card_shows_every_record(made: tuple[Path, list[Record]]) -> None:
    card = model_card(made[1])
    assert card.startswith("# Model card: `learned-grid`")
    for one in made[1]:
        assert f"| {one.site} | {one.device} | {one.rmse_m:.2f} |" in card
    assert POOLED.protocol in card
