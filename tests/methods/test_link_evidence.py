from __future__ import annotations

import torch

from fploc.intervals import Intervals
from fploc.methods.link_evidence import ALONE, FEATURES, VIEWS, LinkEvidence, RangeExpectation

SILENT = torch.zeros(1, dtype=torch.float64)


def one_link(
    range_m: float, rss_dbm: float, t_s: float, *, heard: bool = True, std_m: float = 0.2
) -> Intervals:
    def cell(value: float) -> torch.Tensor:
        return torch.full((1, 1), value, dtype=torch.float64)

    return Intervals(
        t_s=torch.full((1,), t_s, dtype=torch.float64),
        ranges=cell(range_m),
        stds=cell(std_m),
        rss=cell(rss_dbm),
        heard=torch.full((1, 1), heard),
        present=torch.ones(1, dtype=torch.bool),
    )


def expected(distance_m: float) -> RangeExpectation:
    mean = torch.full((1, 1), distance_m, dtype=torch.float64)
    return RangeExpectation(by_others=mean, spread=torch.ones_like(mean), by_all=mean)


def named(features: torch.Tensor) -> dict[str, float]:
    return dict(zip(FEATURES, features[0, 0].tolist(), strict=True))


def test_a_link_alone_is_its_range_and_its_signal_strength_as_received() -> None:
    assert [FEATURES[index] for index in ALONE.features] == ["range", "signal strength"]
    assert set().union(*(view.features for view in VIEWS)) == set(range(len(FEATURES)))
    evidence = LinkEvidence.before(1, 1)
    for step, (range_m, rss_dbm) in enumerate(((5.0, -60.0), (6.0, -71.5))):
        dt_s = torch.full((1,), 0.4).double()
        evidence, features = evidence.after(one_link(range_m, rss_dbm, 0.4 * step), dt_s, expected(4.0))
        assert features[0, 0, list(ALONE.features)].tolist() == [range_m, rss_dbm]


def test_residuals_and_their_means_are_plain_differences_and_averages() -> None:
    evidence = LinkEvidence.before(1, 1)
    evidence, first = evidence.after(one_link(6.0, -60.0, 0.0), SILENT, expected(4.0))
    assert named(first)["range against what the others say"] == 2.0
    assert named(first)["the same residual, 10 s mean"] == 2.0
    assert named(first)["range, 2 s restlessness"] == 0.0
    evidence, second = evidence.after(one_link(7.0, -60.0, 1e-9), SILENT, expected(4.0))
    torch.testing.assert_close(named(second)["the same residual, 10 s mean"], 2.5)
    torch.testing.assert_close(named(second)["range, 2 s restlessness"], 0.5)


def test_losses_count_and_silent_links_keep_their_means() -> None:
    evidence = LinkEvidence.before(1, 1)
    evidence, _ = evidence.after(one_link(6.0, -60.0, 0.0), SILENT, expected(4.0))
    before = evidence.ranges.means
    evidence, missed = evidence.after(
        one_link(0.0, 0.0, 5.0, heard=False), torch.full((1,), 5.0).double(), expected(4.0)
    )
    assert torch.equal(evidence.ranges.means, before)
    torch.testing.assert_close(named(missed)["loss rate"], 1 - float(torch.tensor(-0.5).double().exp()))
