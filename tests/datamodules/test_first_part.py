from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from datamodules.first_part import FirstPartDataModule
from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import calibrated_plan_ranges
from fploc.datasets.build import build_sites
from fploc.datasets.path_parts import GAP_M, along_path_m
from fploc.evaluation.protocols import protocol_of
from fploc.sites.made_up import made_up_site

NAME = "made-up-6"
OFFSETS = RangeOffsets("source-los", 0.8, recordings=("office/1/lab1",))
PROTOCOL = protocol_of("fine-tuned")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    build_sites(None, folder, [made_up_site(6, folder / "files", laps=2, duration_s=60.0)])
    return folder


def module(root: Path, **changes: Any) -> FirstPartDataModule:
    sizes = {"batch_size": 6, "batches": 4} | changes
    made = FirstPartDataModule(PROTOCOL, NAME, OFFSETS, data_root=root, **sizes)
    made.setup()
    return made


def by_recording(made: FirstPartDataModule, part: str) -> dict[tuple[int, str], NDArray[np.float64]]:
    """Return the times of the intervals of a part, by device and recording."""
    return {(one.device, one.name): one.t_s for one in made.recordings(part)}


def test_learned_validating_and_tested_intervals_are_far_apart_along_every_path(root: Path) -> None:
    made = module(root)
    assert made.packed is not None
    tested = {(one.device, one.name): one.t_s for one in PROTOCOL.testing(made.packed, "all")}
    learned, validating = by_recording(made, "train"), by_recording(made, "validate")
    recordings = made.packed.recordings()
    assert len(recordings) == len(tested) == len(learned) == len(validating) == 4
    for one in recordings:
        key = (one.device, one.name)
        along = along_path_m(one.repaired_m)
        parts = [along[np.isin(one.t_s, times[key])] for times in (learned, validating, tested)]
        for before, after in pairwise(parts):
            assert after.min() - before.max() > GAP_M
        lengths = [part.max() - part.min() for part in parts]
        assert lengths[0] + GAP_M == pytest.approx(0.4 * along[-1], abs=GAP_M)
        assert lengths[2] < 0.5 * along[-1] + GAP_M, "less where the path comes back to learned places"


def test_offsets_are_those_given_and_not_fitted_on_the_target(root: Path) -> None:
    made = module(root)
    assert made.packed is not None and made.offsets is OFFSETS
    expected = [calibrated_plan_ranges(one, made.packed.site, OFFSETS) for one in made.recordings("train")]
    np.testing.assert_allclose(made.intervals("train").ranges, np.concatenate(expected), atol=1e-4)


def test_batches_are_drawn_from_the_learned_part_seeded(root: Path) -> None:
    made = module(root)
    known = {tuple(row.tolist()) for row in made.intervals("train").positions}

    def positions(seed: int) -> list[torch.Tensor]:
        stream = made.streams(seed)
        assert list(stream) == ["target"], "beside the source's stream `measured`"
        return [batch.positions for batch in stream["target"]]

    first, again, other = positions(0), positions(0), positions(1)
    assert len(first) == 4 and all(batch.shape == (6, 2) for batch in first)
    assert all(tuple(row.tolist()) in known for batch in first for row in batch)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(first, other, strict=True))
    own = [batch.positions for batch in module(root, seed=1).train_dataloader()["target"]]
    assert all(torch.equal(a, b) for a, b in zip(other, own, strict=True))


def test_validation_holds_every_validating_interval_once_in_order(root: Path) -> None:
    made = module(root)
    found = torch.cat([batch.positions for batch in made.val_dataloader()])
    expected = np.concatenate([one.repaired_m for one in made.recordings("validate")])
    heard = np.concatenate([one.heard.any(axis=1) for one in made.recordings("validate")])
    np.testing.assert_allclose(found, expected[heard & np.isfinite(expected).all(axis=1)], rtol=1e-6)


def test_parts_are_cut_by_repaired_labels_whatever_is_learned(root: Path) -> None:
    published, repaired = module(root, labels="published"), module(root)
    for part in ("train", "validate"):
        for one, other in zip(published.recordings(part), repaired.recordings(part), strict=True):
            np.testing.assert_array_equal(one.t_s, other.t_s)
