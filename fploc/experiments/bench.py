"""`fploc bench`: what one fix of every method costs here, single and in a batch, with one thread and with all."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from fploc.datasets.packed import read_packed
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError, MissingArtifactError
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.protocols import PUBLIC_SOURCE, protocol_of
from fploc.experiments.scoring import METHODS, ReadyMethod, check_method, ready_method
from fploc.filters.kalman import KalmanSettings
from fploc.intervals import Intervals
from fploc.localizer import Localizer, LocalizerState
from fploc.methods.registry import SOURCE_FITTED_METHODS
from fploc.progress import track
from fploc.sites.site import Site

BATCH = 64
FEWEST_FIXES = 1000
WARM_UP = 3
KALMAN = "kalman filter"
"""Name of the rows for the filter behind a method, whose time the method's own rows leave out."""


@dataclass(frozen=True)
class Timing:
    """Time of one fix.

    Args:
        method: Name of the method, or ``KALMAN``.
        site: Where its readings come from.
        access_points: That the site has.
        threads: That it was allowed.
        batch: Devices that one call localizes.
        fixes: That were timed.
        median_ms: Half of the fixes took at most so long, milliseconds; in a batch its share of the call.
        p90_ms: 90 % of the fixes took at most so long, milliseconds.
    """

    method: str
    site: str
    access_points: int
    threads: int
    batch: int
    fixes: int
    median_ms: float
    p90_ms: float

    def as_json(self) -> dict[str, Any]:
        """Return the timing as plain JSON values."""
        return asdict(self)


def bench(
    site: str,
    methods: Sequence[str] | None,
    *,
    fixes: int,
    preset: str,
    seed: int,
    data_root: Path,
    runs: Path,
    batch: int = BATCH,
) -> list[Timing]:
    """Time methods at a site, those that know only the source there.

    Args:
        site: Packed site, no source.
        methods: Names; None for all, of which learned ones without an artifact are left out, and said to be.
        fixes: How many to time at least.
        preset: Of the artifacts.
        seed: Of the artifacts.
        data_root: Folder of packed sites.
        runs: Folder of runs.
        batch: Devices that one call localizes, beside single ones.

    Raises:
        UnknownNameError: If there is no such method.
        MissingArtifactError: If a method was named whose artifact is not there.
        FplocError: If ``fixes`` is too few for a 90 % quantile to mean something.
    """
    for name in methods or ():
        check_method(name)
    if fixes < FEWEST_FIXES:
        raise FplocError(
            "--fixes", value=fixes, expected=f"{FEWEST_FIXES} or more", way_out="leave it out for the fewest"
        )
    if batch < 2:
        raise FplocError(
            "--batch", value=batch, expected="2 or more", way_out="single fixes are timed all the same"
        )
    timings: list[Timing] = []
    for name in track(list(METHODS if methods is None else methods), "bench"):
        request = _request(name, site, preset, seed)
        try:
            ready = ready_method(name, request, None, data_root, runs)
        except MissingArtifactError as error:
            if methods is not None:
                raise
            print(f"fploc: left out {name}: {error}", file=sys.stderr)  # noqa: T201
            continue
        target = read_packed(data_root, request.site)
        recordings = protocol_of(request.protocol).testing(target, request.device)
        timings += _timings(name, ready, target.site, max(recordings, key=len), fixes, batch)
    return timings


def _request(name: str, site: str, preset: str, seed: int) -> EvaluationRequest:
    """Return what a method can run: at the source where it knows nothing else."""
    learner = SOURCE_FITTED_METHODS[name]() if name in SOURCE_FITTED_METHODS else None
    at_source = learner is not None and learner.learns_places
    protocol, target = ("seen", PUBLIC_SOURCE) if at_source else ("zero-shot", site)
    return EvaluationRequest(protocol, target, device="1", preset=preset, seed=seed)


def _timings(
    name: str, ready: ReadyMethod, site: Site, recording: Recording, fixes: int, devices: int
) -> Iterator[Timing]:
    """Yield the timings of one method, and those of the filter with the first method that has none."""
    for threads in sorted({1, os.cpu_count() or 1}):
        with _threads(threads):
            for batch in (1, devices):
                localizer = Localizer(ready.method, site, ready.offsets, KalmanSettings())
                steps = _steps(localizer, recording, batch, fixes)
                located, filtered = _milliseconds(localizer, steps, batch)
                rows = [(name, located), (KALMAN, filtered)] if name == METHODS[0] else [(name, located)]
                for row, taken in rows:
                    yield Timing(
                        method=row,
                        site=site.name,
                        access_points=len(site.access_points),
                        threads=threads,
                        batch=batch,
                        fixes=batch * len(taken),
                        median_ms=float(np.median(taken)),
                        p90_ms=float(np.quantile(taken, 0.9)),
                    )


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Allow so many threads to torch and to everything else that computes."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(limits=count):
            yield
    finally:
        torch.set_num_threads(before)


def _steps(localizer: Localizer, recording: Recording, batch: int, fixes: int) -> list[Intervals]:
    """Return intervals of a recording as one of ``batch`` devices each, every device at another part of it.

    Where the recording is too short for so many fixes, it is gone through again, its time going on.
    """
    count = WARM_UP + -(-fixes // batch)
    length = len(recording)
    parts = np.arange(batch) * (length // batch)
    rows = (np.arange(count)[:, None] + parts) % length
    rounds = (np.arange(count)[:, None] + parts) // length
    t_s = recording.t_s[rows] + rounds * (np.ptp(recording.t_s) + 1.0)
    reported = (t_s, recording.slant_m[rows], recording.std_m[rows], recording.rss_dbm[rows])
    return [localizer.calibrated(*map(torch.from_numpy, step)) for step in zip(*reported, strict=True)]


def _milliseconds(
    localizer: Localizer, steps: Sequence[Intervals], batch: int
) -> tuple[list[float], list[float]]:
    """Return milliseconds per fix of the method and of the filter for every step after the warm-up."""
    state: LocalizerState = localizer.init(batch)
    located, filtered = [], []
    with torch.inference_mode():
        for intervals in steps:
            started = time.perf_counter()
            state, found = localizer.locate(state, intervals)
            between = time.perf_counter()
            state, _ = localizer.filtered(state, intervals, found)
            ended = time.perf_counter()
            located.append(1000 * (between - started) / batch)
            filtered.append(1000 * (ended - between) / batch)
    return located[WARM_UP:], filtered[WARM_UP:]
