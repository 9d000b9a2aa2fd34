from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import datamodules.measured
from datamodules.measured import MeasuredDataModule
from fploc.calibration.offsets import RangeOffsets, fit_offsets
from fploc.datasets.build import build_sites
from fploc.datasets.packed import packed_sites
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError, MissingFileError
from fploc.sites.made_up import made_up_site

NAME = "made-up-6"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    build_sites(None, folder, [made_up_site(6, folder / "files", laps=5, duration_s=20.0)])
    return folder


def module(root: Path, **changes: Any) -> MeasuredDataModule:
    made = MeasuredDataModule(data_root=root, site=NAME, **{"batch_size": 6, "batches": 4, **changes})
    made.prepare_data()
    made.setup()
    return made


def test_a_missing_site_is_built_from_the_source(source: Path, tmp_path: Path) -> None:
    made = MeasuredDataModule(data_root=tmp_path, site="conference-room", source=source)
    made.prepare_data()
    assert packed_sites(tmp_path) == ["conference-room"]
    manifest = tmp_path / "packed" / "conference-room" / "manifest.json"
    before = manifest.stat().st_mtime_ns
    made.prepare_data()
    assert manifest.stat().st_mtime_ns == before


def test_a_packed_site_needs_no_source(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FPLOC_SOURCE", "/nonexistent")
    MeasuredDataModule(data_root=root, site=NAME).prepare_data()


def test_an_unusable_source_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="empty"):
        MeasuredDataModule(data_root=tmp_path, source=tmp_path / "empty").prepare_data()
    assert not list(tmp_path.iterdir())


def test_offsets_are_fitted_on_training_recordings_alone(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[Recording]] = []

    def spy(estimator: str, recordings: list[Recording], *rest: Any) -> RangeOffsets:
        seen.append(recordings)
        return fit_offsets(estimator, recordings, *rest)

    monkeypatch.setattr(datamodules.measured, "fit_offsets", spy)
    made = module(root)
    (fitted_on,) = seen
    assert [(one.device, one.name[0]) for one in fitted_on] == [(d, lap) for d in (1, 2) for lap in "123"]
    assert made.packed is not None and made.offsets is not None
    assert made.offsets.recordings == tuple(f"{NAME}/{one.device}/{one.name}" for one in fitted_on)
    everything = fit_offsets("source-los", made.packed.recordings(), made.packed.site, made.packed.plan)
    assert made.offsets.offset_m != everything.offset_m


def test_parts_share_no_recording_and_leave_none_out(root: Path) -> None:
    made = module(root)
    parts = [
        {(one.device, one.name) for one in made.recordings(part)} for part in ("train", "validate", "test")
    ]
    assert made.packed is not None
    assert sum(len(part) for part in parts) == len(set.union(*parts)) == len(made.packed.recordings())
    assert all(parts)


@pytest.mark.parametrize("calibration", ["none", "0.7", "source-los", "source-mac"])
def test_intervals_are_calibrated_and_in_the_plan(calibration: str, root: Path) -> None:
    made = module(root, calibration=calibration)
    assert made.packed is not None and made.offsets is not None
    site = made.packed.site
    offset = np.array([made.offsets.by_mac_m.get(mac, made.offsets.offset_m) for mac in site.macs])
    expected = []
    for one in made.recordings("validate"):
        heard = one.heard & (one.slant_m <= 60.0)
        slant = np.maximum(one.slant_m - offset, 0.0)
        plan = np.sqrt(np.maximum(slant**2 - site.height_differences_m**2, 0.0))
        expected.append(np.where(heard, plan, 0.0)[heard.any(axis=1)])
    found = made.intervals("validate")
    np.testing.assert_allclose(found.ranges.numpy(), np.concatenate(expected), atol=1e-4)
    assert calibration != "0.7" or made.offsets.offset_m == 0.7


@pytest.mark.parametrize("labels", ["published", "repaired"])
def test_labels_are_those_asked_for(labels: str, root: Path) -> None:
    made = module(root, labels=labels)
    expected = np.concatenate([one.labels_m(labels) for one in made.recordings("validate")])
    found = made.intervals("validate").positions.numpy()
    assert {tuple(row) for row in found} <= {tuple(row) for row in expected.astype(np.float32)}


def test_training_batches_are_drawn_at_random_and_seeded(root: Path) -> None:
    def batches(seed: int) -> list[torch.Tensor]:
        stream = module(root, seed=seed).train_dataloader()
        assert list(stream) == ["measured"]
        return [batch.positions for batch in stream["measured"]]

    first, again, other = batches(0), batches(0), batches(1)
    assert len(first) == 4 and all(batch.shape == (6, 2) for batch in first)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_validation_batches_hold_every_interval_once_in_order(root: Path) -> None:
    made = module(root)
    found = torch.cat([batch.positions for batch in made.val_dataloader()])
    assert torch.equal(found, made.intervals("validate").positions)


def test_an_unknown_calibration_is_named(root: Path) -> None:
    with pytest.raises(FplocError, match="--calibration: found 'lots'"):
        module(root, calibration="lots")
