"""One method at one site with fewer access points, and with ones that stand elsewhere than the site says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Recording
from fploc.evaluation.conditions import ACCESS_POINTS, AS_IS, SURVEY_ERROR, condition
from fploc.evaluation.evaluate import EvaluationRequest, paced, records_of
from fploc.evaluation.records import Record
from fploc.filters.kalman import KalmanSettings
from fploc.localizer import Track, localize
from fploc.methods.interface import Method
from fploc.sites.site import Site

DRAWS = 5
"""Choices of access points, and of their errors, that are scored together."""


@dataclass(frozen=True)
class Equipment:
    """A method ready at a site, and recordings to vary the site's equipment on.

    Args:
        name: Of the method, as it is to stand in records.
        method: The method.
        offsets: Range offsets that it takes.
        site: The site.
        recordings: Of it.
        artifact: What the method was trained as; None without training.
    """

    name: str
    method: Method
    offsets: RangeOffsets
    site: Site
    recordings: Sequence[Recording]
    artifact: str | None

    def with_fewer(self, request: EvaluationRequest, counts: Sequence[int]) -> list[Record]:
        """Return records with so many of the access points alone, those of ``DRAWS`` choices together.

        A device that never hears so many access points in a recording has no record of that number.
        """
        records = []
        for count in counts:
            chosen = [
                fewer for one in self.recordings for draw in range(DRAWS) for fewer in few(one, count, draw)
            ]
            if chosen:
                records += self._records(request, ACCESS_POINTS, str(count), self._tracks(request, chosen))
        return records

    def resurveyed(self, request: EvaluationRequest, errors_m: Sequence[float]) -> list[Record]:
        """Return records behind access points that stand elsewhere than the site says, ``DRAWS`` times each."""
        records = []
        for error_m in errors_m:
            tracks = [
                track
                for draw in range(DRAWS)
                for track in self._tracks(request, self.recordings, misplaced(self.site, error_m, draw))
            ]
            records += self._records(request, SURVEY_ERROR, f"{error_m:g} m", tracks)
        return records

    def as_is(self, request: EvaluationRequest) -> list[Record]:
        """Return records of the same intervals with nothing varied, to compare with."""
        return self._records(request, ACCESS_POINTS, AS_IS, self._tracks(request, self.recordings))

    def _tracks(
        self, request: EvaluationRequest, recordings: Sequence[Recording], site: Site | None = None
    ) -> list[Track]:
        settings = KalmanSettings.for_speed(request.speed_prior)
        return localize(
            paced(self.method, request.speed_prior), site or self.site, recordings, self.offsets, settings
        )

    def _records(
        self, request: EvaluationRequest, study: str, value: str, tracks: Sequence[Track]
    ) -> list[Record]:
        found = records_of(self.name, request, tracks, artifact=self.artifact)
        return [replace(one, condition=condition(study, value)) for one in found]


def few(recording: Recording, count: int, draw: int) -> list[Recording]:
    """Return a recording with ``count`` of the access points that it ever hears; nothing where it hears fewer.

    Args:
        recording: The recording.
        count: How many are left.
        draw: Number of the choice.
    """
    heard = np.flatnonzero(recording.heard.any(axis=0))
    if len(heard) < count:
        return []
    kept = np.zeros(recording.heard.shape[1], dtype=np.bool_)
    kept[np.random.default_rng(draw).choice(heard, count, replace=False)] = True
    return [recording.hearing(kept)]


def misplaced(site: Site, error_m: float, draw: int) -> Site:
    """Return a site whose access points are up to ``error_m`` off in x and in y, evenly distributed.

    Args:
        site: The site.
        error_m: Greatest error of a coordinate, metres.
        draw: Number of the choice.
    """
    errors = np.random.default_rng(draw).uniform(-error_m, error_m, (len(site.access_points), 2))
    moved = tuple(
        replace(one, x_m=one.x_m + float(dx), y_m=one.y_m + float(dy))
        for one, (dx, dy) in zip(site.access_points, errors, strict=True)
    )
    return replace(site, access_points=moved)
