from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

import fploc.experiments.tune as tuning
from fploc.conf import read_conf
from fploc.datasets.packed import read_packed
from fploc.errors import FplocError, UnknownNameError
from fploc.experiments.search_spaces import SPACES
from fploc.experiments.tune import method_file, tune, with_silences, write_tuned
from fploc.methods.registry import RIVAL_PARTS


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, pack: Callable[..., None]) -> Path:
    folder = tmp_path_factory.mktemp("tune")
    pack(folder, "office", seed=3, laps=5, duration_s=20.0)
    return folder


def test_every_dimension_of_a_method_stands_once_in_its_file() -> None:
    assert SPACES.keys() <= RIVAL_PARTS.keys()
    for name, space in SPACES.items():
        text = method_file(name).read_text(encoding="utf-8")
        found = tuning._settings_in(text, space)
        assert found.keys() == {dimension.key for dimension in space}
        assert yaml.safe_load(tuning._with_settings(text, found)) == read_conf("method", name)


def test_no_settings_are_worse_than_those_in_the_file(root: Path) -> None:
    tuned = tune("trilateration", trials=4, seed=1, data_root=root)
    assert tuned.after <= tuned.before
    assert tuned == tune("trilateration", trials=4, seed=1, data_root=root)
    described = yaml.safe_load(tuned.text)["init_args"]
    assert {key: described[key] for key in tuned.settings} == tuned.settings


def test_one_trial_keeps_the_file_but_for_its_origin(root: Path) -> None:
    before = method_file("lls").read_text(encoding="utf-8")
    tuned = tune("lls", trials=1, seed=0, data_root=root)
    lines = tuned.text.splitlines()
    assert lines[0].startswith("# Tuned: `fploc tune --method lls --trials 1 --seed 0` on office/")
    kept = [line for line in before.splitlines() if not line.startswith("# Tuned: ")]
    assert lines[1].startswith("# Tuned: RMSE ") and lines[2:] == kept


def test_what_learns_is_tuned_as_well(root: Path) -> None:
    assert np.isfinite(tune("knn", trials=2, seed=0, data_root=root).after)


def test_small_numbers_are_written_as_yaml_reads_them() -> None:
    for value in (1e-06, 2.5e-07, 0.25, 3.0, 8, "none"):
        assert yaml.safe_load(tuning._written(value)) == value


def test_files_are_written_in_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tuning, "conf_folder", lambda: tmp_path)
    (tmp_path / "method").mkdir()
    file = write_tuned("nls", tuning.Tuned({}, 2.0, 1.0, "text\n"))
    assert file == tmp_path / "method" / "nls.yaml" and file.read_text(encoding="utf-8") == "text\n"
    monkeypatch.setattr(tuning, "conf_folder", lambda: tmp_path / "_conf")
    with pytest.raises(FplocError, match="expected a checkout"):
        method_file("nls")


def test_access_points_are_silent_half_of_the_time_and_no_reading_is_new(root: Path) -> None:
    (recording, *_) = read_packed(root, "office").recordings()
    shares = []
    for seed in range(40):
        sparse = with_silences(recording, seed)
        assert not (sparse.heard & ~recording.heard).any()
        np.testing.assert_array_equal(sparse.slant_m[sparse.heard], recording.slant_m[sparse.heard])
        assert not sparse.rss_dbm[~sparse.heard].any()
        shares.append(sparse.heard.sum() / recording.heard.sum())
    assert np.mean(shares) == pytest.approx(0.5, abs=0.05)
    np.testing.assert_array_equal(with_silences(recording, 3).heard, with_silences(recording, 3).heard)


def test_what_cannot_be_tuned_is_said(root: Path) -> None:
    with pytest.raises(UnknownNameError, match="gnn-fpdnn"):
        tune("gnn-fpdnn", trials=1, seed=0, data_root=root)
    with pytest.raises(FplocError, match="--trials"):
        tune("lls", trials=0, seed=0, data_root=root)
