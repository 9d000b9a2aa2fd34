"""``knn``: the mean of the places whose fingerprints are the most alike (rivals.md; not in the paper).

A fingerprint is the range and the signal strength of every access point, each over its own spread; one that does
not answer counts as far and faint. What a practitioner would try first, and all of it is memory: it knows no place
that it was not taken to, and so it runs in the protocol ``seen`` alone.

Axes: B intervals, A access points, N fingerprints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.errors import FplocError
from fploc.intervals import Estimate, Intervals, NoFix, estimate
from fploc.methods.interface import Examples, Method
from fploc.sites.site import Site

NAME = "knn"
SMALLEST_SQUARE = 1e-12
"""Added to squared distances between fingerprints: an equal one takes all the weight."""


@dataclass(frozen=True)
class KnnSettings:
    """Settings of the fingerprints: conf/method/knn.yaml.

    Args:
        neighbours: How many fingerprints a position is the mean of.
        range_sd_m: Difference of ranges that counts 1, metres.
        rss_sd_db: Difference of signal strengths that counts 1, dB.
        silent_range_m: Range of an access point that does not answer, metres.
        silent_rss_dbm: Signal strength of an access point that does not answer, dBm.
        calibration: That it runs with unless asked.
    """

    neighbours: int
    range_sd_m: float
    rss_sd_db: float
    silent_range_m: float
    silent_rss_dbm: float
    calibration: str

    @classmethod
    def read(cls) -> KnnSettings:
        """Return the settings in conf/method/knn.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")

    def fingerprints(self, intervals: Intervals) -> Tensor:
        """Return the fingerprint of each interval, shape (…, 2 A)."""
        ranges = torch.where(intervals.heard, intervals.ranges, self.silent_range_m) / self.range_sd_m
        rss = torch.where(intervals.heard, intervals.rss, self.silent_rss_dbm) / self.rss_sd_db
        return torch.cat([ranges, rss], -1).double()


class Knn:
    """Learns the fingerprints of one site.

    Args:
        settings: Of the fingerprints; None for those of conf/method/knn.yaml.
    """

    name = NAME
    learns_places = True

    def __init__(self, settings: KnnSettings | None = None) -> None:
        self.settings = KnnSettings.read() if settings is None else settings

    @property
    def default_calibration(self) -> str:
        """Chosen with the other settings."""
        return self.settings.calibration

    def fitted(self, sources: Sequence[Examples]) -> Method:
        """Return the method with the fingerprints of one site.

        The variance of a position is the mean squared error of each recording from the others' fingerprints.

        Raises:
            FplocError: If there are several sites, or fewer than two recordings with ground truth.
        """
        labelled = [one.labels.isfinite().all(-1) & one.intervals.heard.any(-1) for one in sources]
        recordings = [index for at in labelled for index in at.any(0).nonzero()[:, 0].tolist()]
        if len(sources) != 1 or len(recordings) < 2:
            raise FplocError(
                f"--method {NAME}",
                value=f"{len(recordings)} labelled recordings of {len(sources)} sites to learn from",
                expected="two or more of one site",
                way_out="choose the protocol `seen`, or another method",
            )
        (examples,), (at,) = sources, labelled
        prints = self.settings.fingerprints(examples.intervals)
        rows = [(prints[at[:, index], index], examples.labels[at[:, index], index]) for index in recordings]
        squares = []
        for left_out, (queries, truth) in enumerate(rows):
            others = [row for index, row in enumerate(rows) if index != left_out]
            known = FingerprintMap(self.settings, examples.site, *_joined(others), variance_m2=0.0)
            squares.append((known.positions_of(queries) - truth).square().flatten())
        variance = float(torch.cat(squares).mean())
        return FingerprintMap(self.settings, examples.site, *_joined(rows), variance_m2=variance)


class FingerprintMap:
    """The method at the site that it has learned. It has no state.

    Args:
        settings: Of the fingerprints.
        site: Where they were taken.
        prints: Shape (N, 2 A).
        places: Shape (N, 2), metres, site frame.
        variance_m2: Of a position, per axis.
    """

    name = NAME
    memoryless = True

    def __init__(
        self, settings: KnnSettings, site: Site, prints: Tensor, places: Tensor, *, variance_m2: float
    ) -> None:
        self.settings = settings
        self.site = site
        self.places = places
        self._tree = cKDTree(prints.numpy())
        self.variance_m2 = variance_m2

    def init(self, site: Site, devices: int) -> None:
        """Return nothing, which is its state.

        Raises:
            FplocError: If ``site`` is not where the fingerprints were taken.
        """
        if site.macs != self.site.macs:
            raise FplocError(
                f"--method {NAME} at {site.name}",
                value=f"fingerprints of the access points of {self.site.name}",
                expected="those of the site itself",
                way_out="choose the protocol `seen`, or another method",
            )

    def step(self, state: None, intervals: Intervals) -> tuple[None, Estimate]:
        """Locate every device that hears an access point."""
        positions = self.positions_of(self.settings.fingerprints(intervals))
        covariances = self.variance_m2 * torch.eye(2, dtype=positions.dtype).expand(len(positions), 2, 2)
        reasons = torch.where(intervals.heard.any(-1), int(NoFix.FIXED), int(NoFix.NO_READING))
        return state, estimate(positions, covariances, reasons)

    def positions_of(self, queries: Tensor) -> Tensor:
        """Return the mean place of the nearest fingerprints, weighted by 1/distance², shape (B, 2), metres."""
        count = min(self.settings.neighbours, len(self.places))
        found = self._tree.query(queries.numpy(), k=range(1, count + 1))
        distances, nearest = (torch.from_numpy(one) for one in found)
        weights = 1 / (distances.square() + SMALLEST_SQUARE)
        shares = weights / weights.sum(-1, keepdim=True)
        return (shares[..., None] * self.places[nearest]).sum(1)


def _joined(rows: Sequence[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    return torch.cat([prints for prints, _ in rows]), torch.cat([places for _, places in rows])
