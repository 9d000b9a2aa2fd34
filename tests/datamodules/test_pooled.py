from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from datamodules.pooled import PooledDataModule
from fploc.calibration.offsets import RangeOffsets, SourceRecordings, fit_pooled_offsets
from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.datasets.samples import LabelledIntervals
from fploc.errors import FplocError
from fploc.sites.made_up import made_up_site

NAMES = ("made-up-1", "made-up-2", "made-up-3", "made-up-4")
VALIDATES = "made-up-2"
FLOOR = ("made-up-3", "made-up-4")
"""Sites that stand for one floor: together they are one place, made-up-1 another."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for seed, duration_s in ((1, 20.0), (2, 12.0), (3, 12.0), (4, 30.0)):
        site = made_up_site(seed, folder / "files", laps=1, duration_s=duration_s)
        name = f"made-up-{seed}"
        if name in FLOOR:
            text = site.read_text(encoding="utf-8")
            site.write_text(text.replace(f"\nplace: {name}\n", "\nplace: floor\n"), encoding="utf-8")
        build_sites(None, folder, [site])
    return folder


def module(root: Path, names: Sequence[str] = NAMES, **changes: Any) -> PooledDataModule:
    sizes = {"batch_size": 5, "batches": 8} | changes
    made = PooledDataModule(names, VALIDATES, data_root=root, **sizes)
    made.setup()
    return made


def batches(made: PooledDataModule, seed: int) -> list[LabelledIntervals]:
    stream = made.streams(seed)
    assert list(stream) == ["measured"]
    return list(stream["measured"])


def labels_by_device(made: PooledDataModule) -> dict[tuple[str, int], set[tuple[float, ...]]]:
    """Return the labels of every device of every site."""
    known: dict[tuple[str, int], set[tuple[float, ...]]] = {}
    for one in (recording for part in ("train", "validate") for recording in made.recordings(part)):
        known.setdefault((one.site, one.device), set()).update(map(tuple, one.repaired_m.astype(np.float32)))
    return known


def test_places_are_drawn_alike_then_sites_then_devices(root: Path) -> None:
    made = module(root, batches=900)
    assert {name: packed.site.place for name, packed in made.packed.items()}["made-up-3"] == "floor"
    drawn = Counter(tuple(batch.access_points[0].tolist()) for batch in batches(made, 0))
    by_site = {
        name: drawn[tuple(torch.tensor(one.site.positions_m[0], dtype=torch.float32).tolist())] / 900
        for name, one in made.packed.items()
    }
    # Four standard deviations of a share of a half.
    expected = {"made-up-1": 0.5, "made-up-2": 0.0, "made-up-3": 0.25, "made-up-4": 0.25}
    assert by_site == pytest.approx(expected, abs=4 * np.sqrt(0.25 / 900))
    assert by_site[VALIDATES] == 0.0


def test_every_batch_is_of_one_device_of_one_site(root: Path) -> None:
    made = module(root, batches=60)
    known = labels_by_device(made)
    drawn = set()
    for batch in batches(made, 0):
        positions = set(map(tuple, batch.positions.numpy()))
        ((site, device),) = [key for key, labels in known.items() if positions <= labels]
        np.testing.assert_allclose(batch.access_points, made.packed[site].site.positions_m, rtol=1e-6)
        drawn.add((site, device))
    assert drawn == {(name, device) for name in NAMES if name != VALIDATES for device in (1, 2)}


def test_one_seed_repeats_its_batches_and_another_draws_others(root: Path) -> None:
    made = module(root)
    first, again, other = (batches(made, seed) for seed in (0, 0, 1))
    assert len(first) == 8
    assert all(torch.equal(a.positions, b.positions) for a, b in zip(first, again, strict=True))
    assert any(
        a.positions.shape != b.positions.shape or not torch.equal(a.positions, b.positions)
        for a, b in zip(first, other, strict=True)
    )
    own = list(module(root, seed=1).train_dataloader()["measured"])
    assert all(torch.equal(a.positions, b.positions) for a, b in zip(other, own, strict=True))


def test_the_validation_site_validates_and_nothing_else_does(root: Path) -> None:
    made = module(root)
    assert {one.site for one in made.recordings("validate")} == {VALIDATES}
    assert {one.site for one in made.recordings("train")} == set(NAMES) - {VALIDATES}
    labels = np.concatenate([one.repaired_m for one in made.recordings("validate")])
    found = torch.cat([batch.positions for batch in made.val_dataloader()])
    usable = np.concatenate([one.heard.any(axis=1) for one in made.recordings("validate")])
    usable &= np.isfinite(labels).all(axis=1)
    np.testing.assert_allclose(found, labels[usable], rtol=1e-6)


def test_offsets_are_those_of_the_training_sites_together(root: Path) -> None:
    made = module(root, calibration="source-median")
    learned = [made.packed[name] for name in NAMES if name != VALIDATES]
    sources = [SourceRecordings(one.recordings(), one.site, one.plan) for one in learned]
    expected = fit_pooled_offsets("source-median", sources)
    assert made.offsets == expected
    assert {name.split("/")[0] for name in expected.recordings} == set(NAMES) - {VALIDATES}
    everything = [read_packed(root, name) for name in NAMES]
    of_all = fit_pooled_offsets(
        "source-median", [SourceRecordings(one.recordings(), one.site, one.plan) for one in everything]
    )
    assert of_all.offset_m != expected.offset_m


def test_offsets_are_removed_before_anything_is_learned(root: Path, tmp_path: Path) -> None:
    file = tmp_path / "offsets.json"
    RangeOffsets("1.5", 1.5).save(file)
    given, none = module(root, offsets_file=file), module(root, calibration="none")
    assert given.offsets == RangeOffsets("1.5", 1.5)
    for shifted, plain in zip(batches(given, 0), batches(none, 0), strict=True):
        heard = plain.intervals.heard
        assert torch.equal(shifted.intervals.heard, heard)
        assert (shifted.intervals.ranges <= plain.intervals.ranges)[heard].all()
        assert (shifted.intervals.ranges < plain.intervals.ranges - 1.0)[heard].any()


@pytest.mark.parametrize("names", [(), ("made-up-1",), (VALIDATES,), (VALIDATES, VALIDATES), FLOOR])
def test_sites_without_one_that_validates_and_one_to_learn_from_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(FplocError, match=f"validation_site: found {VALIDATES}, expected one of at least two"):
        PooledDataModule(names, VALIDATES)


@pytest.mark.parametrize("labels", ["published", "repaired"])
def test_labels_are_those_asked_for(labels: str, root: Path) -> None:
    made = module(root, labels=labels)
    known = {
        tuple(row) for one in made.recordings("train") for row in one.labels_m(labels).astype(np.float32)
    }
    assert {tuple(row) for batch in batches(made, 0) for row in batch.positions.numpy()} <= known
