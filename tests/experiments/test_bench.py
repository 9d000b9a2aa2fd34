from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import fploc.experiments.bench as benching
from fploc.errors import FplocError, MissingArtifactError, UnknownNameError
from fploc.experiments.bench import KALMAN, Timing, bench


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, pack: Callable[..., None]) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    pack(folder, "office", seed=3, laps=5, duration_s=20.0)
    pack(folder, "made-up-4", seed=4, laps=1, duration_s=15.0)
    return folder


def timed(methods: list[str] | None, root: Path, *, fixes: int = 1000) -> list[Timing]:
    return bench(
        "made-up-4", methods, fixes=fixes, preset="smoke", seed=0, data_root=root, runs=root / "runs"
    )


def test_every_method_is_timed_alone_and_in_a_batch_with_one_thread_and_with_all(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benching.os, "cpu_count", lambda: 2)
    timings = timed(["lls"], root)
    kinds = {(one.method, one.threads, one.batch) for one in timings}
    assert kinds == {
        (name, threads, batch)
        for name in ("lls", KALMAN)
        for threads in (1, 2)
        for batch in (1, benching.BATCH)
    }
    assert all(one.fixes >= 1000 and 0 < one.median_ms <= one.p90_ms for one in timings)
    alone, together = (next(one for one in timings if one.batch == size) for size in (1, benching.BATCH))
    assert together.median_ms < alone.median_ms
    assert timings[0].as_json()["site"] == "made-up-4"


def test_the_batch_can_be_chosen(root: Path) -> None:
    sizes = {"fixes": 1000, "preset": "smoke", "seed": 0, "data_root": root, "runs": root / "runs"}
    assert {one.batch for one in bench("made-up-4", ["lls"], batch=200, **sizes)} == {1, 200}
    with pytest.raises(FplocError, match="--batch: found 1, expected 2 or more"):
        bench("made-up-4", ["lls"], batch=1, **sizes)


def test_what_knows_only_the_source_is_timed_there(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benching, "FEWEST_FIXES", 20)
    assert {one.site for one in timed(["knn"], root, fixes=20)} == {"office"}


def test_a_method_without_artifact_is_left_out_unless_it_is_named(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(benching, "METHODS", ("trilateration", "gnn"))
    monkeypatch.setattr(benching, "FEWEST_FIXES", 20)
    assert {one.method for one in timed(None, root, fixes=20)} == {"trilateration", KALMAN}
    assert "left out gnn" in capsys.readouterr().err
    with pytest.raises(MissingArtifactError):
        timed(["gnn"], root, fixes=20)


def test_what_cannot_be_timed_is_said(root: Path) -> None:
    with pytest.raises(FplocError, match="--fixes"):
        timed(["lls"], root, fixes=10)
    with pytest.raises(UnknownNameError, match="magic"):
        timed(["magic"], root)
