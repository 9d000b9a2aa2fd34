from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fploc.calibration.offsets import RangeOffsets, SourceRecordings
from fploc.calibration.ranges import calibrated_plan_ranges
from fploc.datasets.packed import read_packed
from fploc.errors import FplocError
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.protocols import protocol_of
from fploc.experiments.scoring import answer
from fploc.experiments.source_fit import check_protocol, examples_of
from fploc.methods.fingerprints import Knn
from fploc.methods.gbm import Gbm


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, pack: Callable[..., None]) -> Path:
    folder = tmp_path_factory.mktemp("source-fit")
    pack(folder, "office", seed=3, laps=5, duration_s=20.0)
    pack(folder, "made-up-4", seed=4, laps=1, duration_s=15.0)
    return folder


def test_examples_are_what_a_method_will_be_given(root: Path) -> None:
    packed = read_packed(root, "office")
    recordings = packed.recordings()[:2]
    made = examples_of(SourceRecordings(recordings, packed.site, packed.plan), RangeOffsets("0.7", 0.7))
    for index, one in enumerate(recordings):
        length = len(one)
        expected = calibrated_plan_ranges(one, packed.site, RangeOffsets("0.7", 0.7))
        ranges = made.intervals.ranges[:length, index].numpy()
        np.testing.assert_allclose(ranges[one.heard], expected[one.heard])
        assert not ranges[~one.heard].any()
        np.testing.assert_array_equal(made.labels[:length, index].numpy(), one.repaired_m)
        assert made.labels[length:, index].isnan().all() and not made.intervals.present[length:, index].any()


def test_fingerprints_are_for_places_seen_alone() -> None:
    check_protocol(Knn(), protocol_of("seen"))
    check_protocol(Gbm(), protocol_of("zero-shot"))
    with pytest.raises(FplocError, match="--protocol seen --site office"):
        check_protocol(Knn(), protocol_of("zero-shot"))


def test_they_learn_while_they_are_evaluated(root: Path, tmp_path: Path) -> None:
    seen = EvaluationRequest("seen", "office", device="1", labels="repaired")
    first, second = (answer("knn", seen, None, root, tmp_path) for _ in range(2))
    assert [record.rmse_m for record in first] == [record.rmse_m for record in second]
    elsewhere = EvaluationRequest("zero-shot", "made-up-4", device="1", labels="repaired", thin=10)
    for record in (*first, *answer("gbm", elsewhere, None, root, tmp_path)):
        assert record.rmse_m is not None and record.n > 0 and record.artifact is None
