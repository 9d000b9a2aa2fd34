from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Recording
from fploc.evaluation.chain_stages import STAGES, chain_stages, chain_tracks
from fploc.filters.kalman import KalmanSettings
from fploc.floorplan.raster import PlanRaster
from fploc.localizer import localize
from fploc.methods.gnn import GNNMethod
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.models.deepvit import DeepViT
from fploc.models.fpdnn import FPDNN, CorrectionHead, DistanceHead
from fploc.models.gnn import GNN
from fploc.solvers.nonlinear import solve_nonlinear
from rooms import room

CORNERS = ((0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0))
SITE = room(CORNERS, height_m=1.0)
NONE = RangeOffsets("none", 0.0)


def recording(*, offset_m: float = 0.0, steps: int = 12) -> Recording:
    t_s = np.arange(steps) * 0.5
    path = np.column_stack([5 + 0.3 * t_s, 4 + 0.1 * t_s])
    slant = np.linalg.norm(path[:, None] - SITE.positions_m, axis=2) + offset_m
    heard = np.ones(slant.shape, dtype=bool)
    heard[3] = [True, True, False, False]
    slant[5, 1] = 70.0
    blank = np.zeros(slant.shape)
    return Recording(
        site="box",
        device=1,
        name="lap",
        t_s=t_s,
        slant_m=np.where(heard, slant, 0.0),
        std_m=blank,
        rss_dbm=np.where(heard, -60.0, 0.0),
        heard=heard,
        published_m=path + 100.0,
        repaired_m=path,
    )


def chain(head: nn.Module) -> GNNFPDNN:
    torch.manual_seed(5)
    vision = DeepViT(20, 200, (20, 10), dim=8, depth=1, num_heads=2, head_dim=4)
    return GNNFPDNN(
        coarse=GNNMethod(GNN(hidden=8, message_width=4, layers=2).eval(), variance_m2=1.0),
        network=FPDNN(vision, head).eval(),
        plan=PlanRaster(torch.rand(200, 400), torch.tensor([[10.0, 0.0, 20.0], [0.0, -10.0, 180.0]])),
        crops=vision.crops,
        solver=solve_nonlinear,
        sigma_m=0.5,
        filter_settings=KalmanSettings.for_speed(1.4),
    )


def test_an_untrained_correction_leaves_the_offset_that_ranges_have() -> None:
    tracks = chain_tracks(chain(CorrectionHead(64)), SITE, [recording(offset_m=1.5)], NONE, KalmanSettings())
    found = chain_stages(tracks, SITE, "repaired")
    # Not heard twice, beyond 60 m once, and no coarse position from the two ranges that are left then.
    assert found["links"] == 12 * 4 - 2 - 1 - 2
    assert found["range_raw_mae_m"] == pytest.approx(1.5)
    assert found["range_fpdnn_mae_m"] == pytest.approx(1.5, abs=1e-5)
    assert list(found) == ["links", "range_raw_mae_m", "range_fpdnn_mae_m", *STAGES]


def test_noise_free_ranges_end_at_the_truth() -> None:
    tracks = chain_tracks(chain(CorrectionHead(64)), SITE, [recording()], NONE, KalmanSettings())
    found = chain_stages(tracks, SITE, "repaired")
    assert found["range_raw_mae_m"] == pytest.approx(0.0, abs=1e-9)
    assert found["GNN + FPDNN"] < 0.1
    assert chain_stages(tracks, SITE, "published")["GNN + FPDNN"] == pytest.approx(100 * np.sqrt(2), abs=1.0)


def test_corrected_ranges_are_those_that_the_positions_were_solved_from() -> None:
    method = chain(DistanceHead(64))
    (track,) = chain_tracks(method, SITE, [recording()], NONE, KalmanSettings())
    heard = np.isfinite(track.corrected_m)
    corrected = torch.from_numpy(np.where(heard, track.corrected_m, 0.0))
    access_points = torch.from_numpy(SITE.positions_m)
    solved = solve_nonlinear(
        corrected, access_points, torch.full_like(corrected, method.sigma_m), torch.from_numpy(heard)
    )
    path = track.paths["GNN + FPDNN"]
    assert path.fixed.sum() >= 10
    np.testing.assert_allclose(solved.positions.numpy()[path.fixed], path.positions_m[path.fixed], atol=1e-4)


def test_stages_are_those_of_the_two_methods_with_their_own_filters() -> None:
    method, lap = chain(DistanceHead(64)), recording()
    (track,) = chain_tracks(method, SITE, [lap], NONE, KalmanSettings())
    (coarse,) = localize(method.coarse, SITE, [lap], NONE, method.filter.settings)
    (final,) = localize(method, SITE, [lap], NONE, KalmanSettings())
    expected = (coarse.unfiltered, coarse.filtered, final.unfiltered, final.filtered)
    for stage, path in zip(STAGES, expected, strict=True):
        assert path is not None
        np.testing.assert_array_equal(track.paths[stage].positions_m, path.positions_m)


def test_recordings_without_labels_have_no_stage() -> None:
    lap = recording()
    blind = replace(lap, repaired_m=np.full_like(lap.repaired_m, np.nan))
    tracks = chain_tracks(chain(CorrectionHead(64)), SITE, [blind], NONE, KalmanSettings())
    found = chain_stages(tracks, SITE, "repaired")
    assert found.pop("links") == 0 and set(found.values()) == {None}
