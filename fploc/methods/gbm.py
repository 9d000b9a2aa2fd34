"""``gbm``: gradient-boosted trees correct every range, then least squares (rivals.md; not in the paper).

What a good practitioner would try without a plan. One model says from a link's range, spread, signal strength and
recent past how much the range is too long (median), one how far off that is; they are trees of scikit-learn's
HistGradientBoosting. The corrected ranges go to least squares with their own standard deviations. The second model
learns from corrections of recordings that the first had not seen.

Axes: T intervals, B devices, A access points, F features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.errors import FplocError
from fploc.intervals import Estimate, Intervals
from fploc.methods.interface import Examples, Method
from fploc.methods.link_history import LinkHistory
from fploc.plausible import FARTHEST_RANGE_M
from fploc.sites.site import Site
from fploc.solvers.losses import Loss
from fploc.solvers.nonlinear import NonlinearSettings, solve_nonlinear

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingRegressor

NAME = "gbm"
SEED = 0
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GbmSettings:
    """Settings of trees and solver: conf/method/gbm.yaml.

    Args:
        windows_s: Time constants of a link's past, seconds.
        learn_every: Of so many intervals of a recording one is learned from: neighbours are nearly the same.
        learning_rate: Of the boosting.
        trees: How many, of each model.
        leaves: At most, of each tree.
        samples_per_leaf: At least.
        l2: Penalty on leaf values.
        loss: Of residuals over their standard deviations.
        smallest_sigma_m: No corrected range is better than this, metres.
        advantage: As in ``NonlinearSettings``.
        calibration: That it runs with unless asked.
    """

    windows_s: tuple[float, ...]
    learn_every: int
    learning_rate: float
    trees: int
    leaves: int
    samples_per_leaf: int
    l2: float
    loss: Loss
    smallest_sigma_m: float
    advantage: float
    calibration: str

    @classmethod
    def read(cls) -> GbmSettings:
        """Return the settings in conf/method/gbm.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")

    def model(self) -> HistGradientBoostingRegressor:
        """Return an untrained model of a median."""
        # Every method is registered with this module; a server has no use for what only this one needs.
        from sklearn.ensemble import HistGradientBoostingRegressor

        return HistGradientBoostingRegressor(
            loss="absolute_error",
            learning_rate=self.learning_rate,
            max_iter=self.trees,
            max_leaf_nodes=self.leaves,
            min_samples_leaf=self.samples_per_leaf,
            l2_regularization=self.l2,
            early_stopping=False,
            random_state=SEED,
        )


class Gbm:
    """Learns what ranges of source sites have too much.

    Args:
        settings: Of trees and solver; None for those of conf/method/gbm.yaml.
    """

    name = NAME
    learns_places = False

    def __init__(self, settings: GbmSettings | None = None) -> None:
        self.settings = GbmSettings.read() if settings is None else settings

    @property
    def default_calibration(self) -> str:
        """Chosen with the other settings."""
        return self.settings.calibration

    def fitted(self, sources: Sequence[Examples]) -> Method:
        """Return the method that has learned from the readings of all sources.

        Raises:
            FplocError: If fewer than two recordings have ground truth.
        """
        recordings = [rows for one in sources for rows in _readings(one, self.settings) if len(rows.excess)]
        if len(recordings) < 2:
            raise FplocError(
                f"--method {NAME}",
                value=f"{len(recordings)} labelled recordings to learn from",
                expected="two or more",
                way_out="choose another method",
            )
        model = _trained(self.settings, recordings)
        spreads = []
        for left_out, rows in enumerate(recordings):
            others = [one for index, one in enumerate(recordings) if index != left_out]
            errors = rows.excess - _trained(self.settings, others).predict(rows.features)
            spreads.append(_Readings(rows.features, np.abs(errors)))
        return CorrectedRanges(self.settings, excess=model, spread=_trained(self.settings, spreads))


@dataclass(frozen=True)
class _Readings:
    """Features (n, F) of readings, and what is to be learned of each, (n,), metres."""

    features: Floats
    excess: Floats


def _readings(examples: Examples, settings: GbmSettings) -> list[_Readings]:
    """Return the labelled readings of every recording, with their links' past."""
    intervals = examples.intervals
    steps, devices, access_points = intervals.ranges.shape
    learned = slice(None, None, settings.learn_every)
    history = LinkHistory.before(devices, access_points, len(settings.windows_s))
    windows_s = torch.tensor(settings.windows_s, dtype=torch.float64)
    collected = []
    for step in range(steps):
        history, features = history.after(examples.intervals.at(step), windows_s)
        collected.append(features)
    every = torch.stack(collected)[learned]
    away = examples.labels[:, :, None, :] - torch.from_numpy(examples.site.positions_m)
    excess = intervals.ranges - away.norm(dim=-1)
    usable = intervals.heard & excess.isfinite() & (intervals.ranges <= FARTHEST_RANGE_M)
    excess, usable = excess[learned], usable[learned]
    return [
        _Readings(every[:, index][usable[:, index]].numpy(), excess[:, index][usable[:, index]].numpy())
        for index in range(devices)
    ]


def _trained(settings: GbmSettings, recordings: Sequence[_Readings]) -> HistGradientBoostingRegressor:
    """Return a model trained on recordings, every one with the same weight."""
    sizes = [len(one.excess) for one in recordings]
    weights = np.repeat([np.mean(sizes) / size for size in sizes], sizes)
    features = np.concatenate([one.features for one in recordings])
    return settings.model().fit(features, np.concatenate([one.excess for one in recordings]), weights)


MEDIAN_TO_SD = 1.4826
"""The standard deviation of normal errors whose absolute values have the median 1."""


@dataclass(frozen=True)
class GbmState:
    """Positions of the access points, shape (A, 2), metres, site frame, and every link's past."""

    access_points: Tensor
    history: LinkHistory


@dataclass(frozen=True)
class LinkFeatures:
    """Ranges to correct, and what they are corrected by.

    Args:
        ranges: Shape (B, A), metres.
        features: ``LinkHistory.after``, shape (B, A, F).
        heard: True where there is a range, shape (B, A).
    """

    ranges: Tensor
    features: Tensor
    heard: Tensor


class CorrectedRanges:
    """The method that has learned.

    Args:
        settings: Of the solver.
        excess: Predicts what a range has too much, metres.
        spread: Predicts the median error of that, metres.
    """

    name = NAME

    def __init__(
        self,
        settings: GbmSettings,
        excess: HistGradientBoostingRegressor,
        spread: HistGradientBoostingRegressor,
    ) -> None:
        self.settings = settings
        self._windows_s = torch.tensor(settings.windows_s, dtype=torch.float64)
        self._excess = excess
        self._spread = spread
        self._iteration = NonlinearSettings(advantage=settings.advantage)

    def init(self, site: Site, devices: int) -> GbmState:
        """Return the state of ``devices`` devices before their first interval."""
        access_points = torch.from_numpy(site.positions_m)
        past = LinkHistory.before(devices, len(access_points), len(self._windows_s))
        return GbmState(access_points, past)

    def step(self, state: GbmState, intervals: Intervals) -> tuple[GbmState, Estimate]:
        """Correct every range heard, and solve for the positions."""
        state, rows = self.follow(state, intervals)
        return state, self.solve(state.access_points, rows)

    def follow(self, state: GbmState, intervals: Intervals) -> tuple[GbmState, LinkFeatures]:
        """Take an interval into the past of every link."""
        history, features = state.history.after(intervals, self._windows_s)
        heard = intervals.heard & intervals.present[:, None]
        return GbmState(state.access_points, history), LinkFeatures(
            intervals.ranges.double(), features, heard
        )

    def solve(self, access_points: Tensor, rows: LinkFeatures) -> Estimate:
        """Correct every range heard, and solve for the positions."""
        ranges, heard = rows.ranges, rows.heard
        sigmas = torch.ones_like(ranges)
        if heard.any():
            of_links = rows.features[heard].numpy()
            excess = torch.from_numpy(self._excess.predict(of_links))
            spread = MEDIAN_TO_SD * torch.from_numpy(self._spread.predict(of_links))
            ranges = ranges.masked_scatter(heard, (ranges[heard] - excess).clamp(min=0.0))
            sigmas = sigmas.masked_scatter(heard, spread.clamp(min=self.settings.smallest_sigma_m))
        return solve_nonlinear(
            ranges, access_points, sigmas, heard, loss=self.settings.loss, settings=self._iteration
        )
