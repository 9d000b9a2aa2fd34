from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.recordings import Recording
from fploc.errors import BadFileError, MissingFileError
from fploc.evaluation.error_series import (
    ErrorSeries,
    error_series,
    pooled_errors_m,
    read_error_series,
    write_error_series,
)
from fploc.intervals import NoFix
from fploc.localizer import Path as DevicePath
from fploc.localizer import Track

LABELS = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [np.nan, np.nan]])


def recording(length: int = 4) -> Recording:
    none = np.zeros((length, 1))
    return Recording(
        site="hall",
        device=2,
        name="lap",
        t_s=np.arange(length) / 2,
        slant_m=none,
        std_m=none,
        rss_dbm=none,
        heard=none > 0,
        published_m=np.full((length, 2), np.nan),
        repaired_m=LABELS[:length],
    )


def path(positions: list[list[float]]) -> DevicePath:
    array = np.array(positions)
    reasons = np.where(np.isfinite(array[:, 0]), int(NoFix.FIXED), int(NoFix.NO_READING))
    return DevicePath(array, np.tile(np.eye(2), (len(array), 1, 1)), reasons, ms_per_fix=1.0)


NAN = [np.nan, np.nan]
FIXES = path([NAN, [3.0, 1.0], NAN, [0.0, 0.0]])


def test_errors_are_held_from_the_first_fix_on_and_unlabelled_intervals_have_none() -> None:
    made = error_series(Track(recording(), FIXES, path([[1.0, 0.0]] * 4), own_filter=False), "repaired")
    np.testing.assert_array_equal(made.unfiltered_m, [np.nan, 1.0, 3.0, np.nan])
    np.testing.assert_allclose(made.filtered_m, [1.0, 2.0, np.sqrt(20.0), np.nan])
    assert (made.device, made.recording, made.arc_length_m) == (2, "lap", 7.0)
    np.testing.assert_array_equal(made.t_s, [0.0, 0.5, 1.0, 1.5])


def test_a_method_with_a_filter_of_its_own_has_one_series() -> None:
    made = error_series(Track(recording(), FIXES, None, own_filter=True), "repaired")
    np.testing.assert_array_equal(made.filtered_m, made.unfiltered_m)


def series(device: int, name: str, errors: list[float]) -> ErrorSeries:
    array = np.array(errors)
    return ErrorSeries(
        device, name, 2.0 * len(errors), np.arange(len(errors)) * 1.0, array, array / 2, array > 1.0
    )


def test_pooling_keeps_one_device_and_what_is_scored() -> None:
    given = [series(1, "a", [1.0, np.nan]), series(2, "b", [5.0]), series(1, "c", [3.0])]
    np.testing.assert_array_equal(pooled_errors_m(given, 1, filtered=False), [1.0, 3.0])
    np.testing.assert_array_equal(pooled_errors_m(given, 2, filtered=True), [2.5])
    assert pooled_errors_m(given, 3, filtered=True).shape == (0,)


def test_series_survive_the_disk(tmp_path: Path) -> None:
    given = [series(1, "a", [1.0, np.nan]), series(1, "b", []), series(2, "713", [5.0, 6.0, 7.0])]
    file = tmp_path / "errors.npz"
    write_error_series(given, file)
    read = read_error_series(file)
    assert [one.name for one in tmp_path.iterdir()] == ["errors.npz"]
    for one, other in zip(read, given, strict=True):
        assert (one.device, one.recording, one.arc_length_m) == (
            other.device, other.recording, other.arc_length_m,
        )  # fmt: skip
        for name in ("t_s", "unfiltered_m", "filtered_m"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04cut"])
def test_a_broken_file_is_named(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "errors.npz"
    file.write_bytes(content)
    with pytest.raises(BadFileError, match=r"errors\.npz, whole file.*make it again"):
        read_error_series(file)


def test_a_file_of_other_arrays_or_none_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", device1=np.ones(3))
    with pytest.raises(BadFileError, match="KeyError"):
        read_error_series(tmp_path / "other.npz")
    with pytest.raises(MissingFileError, match=r"none\.npz"):
        read_error_series(tmp_path / "none.npz")
