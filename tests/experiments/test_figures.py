from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import fploc.experiments.figures
from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.packed import PackedSite, read_packed
from fploc.evaluation.chain_stages import chain_tracks
from fploc.evaluation.error_series import ErrorSeries
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import Record, TrackedRecord
from fploc.experiments.figures import (
    Place,
    access_point_figures,
    cdf_figures,
    rmse_rows,
    split_figure,
    write_figures,
)
from fploc.filters.kalman import KalmanSettings
from fploc.floorplan.plan import read_grey_image
from fploc.floorplan.raster import PlanRaster
from fploc.methods.gnn import GNNMethod
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import FPDNN, CorrectionHead
from fploc.models.gnn import GNN
from fploc.solvers.nonlinear import solve_nonlinear

SOURCE, TARGET = "made-up-1", "made-up-2"


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory, pack: Callable[..., None]) -> dict[str, PackedSite]:
    root = tmp_path_factory.mktemp("data")
    for seed, name in enumerate((SOURCE, TARGET), start=1):
        pack(root, name, seed=seed, laps=5, duration_s=12.0)
    return {name: read_packed(root, name) for name in (SOURCE, TARGET)}


def series(device: int) -> ErrorSeries:
    errors = np.linspace(0.0, 2.0, 9)
    return ErrorSeries(device, "lap", 5.0, np.arange(9.0), errors, errors / 2, np.ones(9, dtype=np.bool_))


def chain(target: PackedSite) -> GNNFPDNN:
    vision = DeepViT(20, 200, (20, 10), dim=8, depth=1, num_heads=2, head_dim=4)
    return GNNFPDNN(
        coarse=GNNMethod(GNN(hidden=8, message_width=4, layers=1).eval(), variance_m2=1.0),
        network=FPDNN(vision, CorrectionHead(64)).eval(),
        plan=PlanRaster.of(target.plan),
        crops=vision.crops,
        solver=solve_nonlinear,
        sigma_m=0.5,
        filter_settings=KalmanSettings(),
    )


def place(packed: dict[str, PackedSite], protocol: str, target: str) -> Place:
    methods = ("nls", "gnn", "gnn-fpdnn")
    errors = {method: [series(1), series(2)] for method in methods}
    return Place(protocol_of(protocol, SOURCE), packed[SOURCE], packed[target], errors)


def record(method: str, filter_name: str, **changes: object) -> TrackedRecord:
    values: dict[str, object] = {
        "method": method, "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "labels": "repaired",
        "calibration": "none", "plan": "real", "speed_prior": 0.5, "smoother": False, "thin": 1,
        "filter": filter_name, "preset": "full", "seed": 0, "n": 1, "n_before_first_fix": 0,
        "no_fix_share": 0.0, "rmse_m": 2.0, "rmse_fixed_m": 2.0, "mae_m": 1.0, "p50_m": 1.0, "p90_m": 1.0,
        "p95_m": 1.0, "coverage95": None, "nees": None, "ms_per_fix": 0.1, "artifact": None, "commit": None,
    }  # fmt: skip
    return TrackedRecord(Record(**(values | changes)), "run", "hash", made_up=False)  # type: ignore[arg-type]


def test_everything_of_a_place_is_written_and_can_be_read(
    packed: dict[str, PackedSite], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fploc.experiments.figures, "DOTS_PER_INCH", 30)
    torch.manual_seed(0)
    target = packed[TARGET]
    method = chain(target)
    first = {one.device: one for one in reversed(target.recordings())}
    tracks = chain_tracks(
        method, target.site, list(first.values()), RangeOffsets("none", 0.0), KalmanSettings()
    )
    bare = place(packed, "zero-shot", TARGET)
    full = Place(bare.protocol, bare.source, bare.target, bare.errors, method, tracks)
    files = write_figures([full], [record("gnn", "kalman"), record("gnn", "none")], [], tmp_path / "figures")
    at = f"zero-shot--{TARGET}"
    assert [file.stem for file in files] == [
        "bars--zero-shot--none", "bars--zero-shot--kalman",
        f"cdf--{at}--device1", f"cdf-stages--{at}--device1",
        f"cdf--{at}--device2", f"cdf-stages--{at}--device2",
        f"stages--{at}--device1", f"stages--{at}--device2", f"crop--{at}", f"attention--{at}",
        f"devices--{TARGET}",
    ]  # fmt: skip
    assert sorted(files) == sorted((tmp_path / "figures").iterdir())
    assert all(read_grey_image(file).std() > 0 for file in files)


def test_the_split_shows_what_is_learned_from_and_nothing_where_nothing_is(
    packed: dict[str, PackedSite],
) -> None:
    seen = split_figure(place(packed, "seen", SOURCE))
    tuned = split_figure(place(packed, "fine-tuned", TARGET))
    assert seen is not None and tuned is not None
    labels = [text.get_text() for text in seen.legends[0].get_texts()]
    assert [label.partition(":")[0] for label in labels] == ["trains", "validates", "tests", "access points"]
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in tuned.axes[0].lines}
    parts = [lines[name] for name in ("fine-tunes", "tests", "left out")]
    known = [len(part[np.isfinite(part).all(axis=1)]) for part in parts]
    labelled = sum(
        int(np.isfinite(one.labels_m("repaired")).all(axis=1).sum()) for one in packed[TARGET].recordings()
    )
    assert sum(known) == labelled and min(known[:2]) > 0
    assert split_figure(place(packed, "zero-shot", TARGET)) is None


def test_stages_are_drawn_where_both_methods_of_the_chain_were_run(packed: dict[str, PackedSite]) -> None:
    whole = place(packed, "zero-shot", TARGET)
    names = [name.partition("--")[0] for name, _ in cdf_figures(whole)]
    assert names == ["cdf", "cdf-stages"] * 2
    rivals = Place(whole.protocol, whole.source, whole.target, {"nls": whole.errors["nls"]})
    assert [name.partition("--")[0] for name, _ in cdf_figures(rivals)] == ["cdf", "cdf"]
    (_, stages), *_ = [one for one in cdf_figures(whole) if one[0].startswith("cdf-stages")]
    medians = [float(np.median(np.asarray(line.get_xdata()))) for line in stages.axes[0].lines]
    assert medians == [1.0, 0.5, 1.0, 0.5]


def test_bars_hold_what_a_filter_made_and_what_the_paper_says() -> None:
    records = [
        record("gnn", "kalman"),
        record("gnn", "none"),
        record("bayes-grid", "own"),
        record("gnn", "kalman", labels="published"),
        record("gnn", "kalman", protocol="seen"),
    ]
    filtered = rmse_rows(records, "zero-shot", filtered=True)
    assert [(row.method, row.paper_m) for row in filtered] == [("gnn", (1.23,)), ("bayes-grid", ())]
    (plain,) = rmse_rows(records, "zero-shot", filtered=False)
    assert plain.paper_m == (1.57,) and plain.place == "shopping-mall\ndevice 1"


def test_access_points_are_drawn_over_their_number_for_each_device() -> None:
    studied = [
        record("nls", "kalman", condition="access points: 3", rmse_m=2.5),
        record("nls", "none", condition="access points: 3", rmse_m=9.0),
        record("bayes-grid", "own", condition="access points: 3", rmse_m=1.5),
        record("bayes-grid", "kalman", condition="access points: 3", rmse_m=9.0),
        record("nls", "kalman", condition="access points: as they are"),
        record("nls", "kalman", condition="survey error: 0.5 m"),
        record("nls", "kalman", condition="access points: 4", device=2, rmse_m=None),
    ]
    ((name, figure),) = access_point_figures(studied)
    assert name == "access-points--shopping-mall--device1"
    drawn = {line.get_label(): line.get_xydata().tolist() for line in figure.axes[0].lines}
    assert drawn == {"nls": [[3.0, 2.5]], "bayes-grid": [[3.0, 1.5]]}
