"""``bayes-grid``: a belief over grid cells, moved and updated at every interval (Horn, Sensors 2020, 20:4027;
Horn, Sensors 2022, 22:3091).

From the sources: probabilities on a grid, a random walk between intervals, and an observation model on the ratio
of measured to true range, a double exponential with a flat top. Reconstructed here: the belief covers the access
points' bounding box and a margin; walls do not stop the walk; each interval blurs the belief by v·dt and multiplies
it by Π (p(m|r) + floor), where with ρ = (m − b₀)/r

    p(m|r) = exp(−max(0, (L − ρ)/s_L, (ρ − U)/s_R)) / (r (s_L + U − L + s_R));

the estimate is the belief's mean. Sums stand in for logarithms: the belief is scaled to sum 1 at every interval and
the floor keeps every factor above 0. Departure: the likelihood is tempered, since walls err alike in intervals that
follow each other (``correlation_s``).

Axes: B devices, A access points, X and Y cells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.intervals import Estimate, Intervals, NoFix, estimate
from fploc.methods.belief_grid import BeliefGrid, moved, tempered
from fploc.sites.site import Site

NAME = "bayes-grid"


@dataclass(frozen=True)
class BayesGridSettings:
    """Settings of the grid filter: conf/method/bayes-grid.yaml.

    Args:
        cell_m: Side of a cell, metres.
        margin_m: Of the grid around the access points' bounding box, metres.
        speed_prior_mps: v: the belief spreads by v·dt per axis between intervals.
        bias_m: b₀, subtracted from every range, metres.
        ratio_low: L, lower end of the flat top.
        ratio_high: U, upper end of the flat top.
        scale_low: s_L, decay of the density below L.
        scale_high: s_R, decay of the density above U.
        floor_per_m: Density of ranges that the model does not explain, per metre.
        correlation_s: For so long the errors of ranges are one error: the likelihood of an interval that comes
            sooner after the last gets the share of it as its power. 0 takes every interval at its word.
        calibration: Range offsets that the parameters above were fitted behind.
    """

    cell_m: float
    margin_m: float
    speed_prior_mps: float
    bias_m: float
    ratio_low: float
    ratio_high: float
    scale_low: float
    scale_high: float
    floor_per_m: float
    correlation_s: float
    calibration: str

    @classmethod
    def read(cls) -> BayesGridSettings:
        """Return the settings in conf/method/bayes-grid.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")


@dataclass(frozen=True)
class BeliefState:
    """Beliefs of a batch of devices.

    Args:
        grid: Cells of the site.
        nearness: 1/r from each access point to each cell, shape (A, X · Y), 1/m, float32.
        beliefs: Probability of each cell, shape (B, X, Y).
        t_s: Time of each belief, shape (B,), seconds.
        heard_t_s: Time of the last interval of each that heard something, shape (B,), seconds.
        started: True once a device heard something, shape (B,).
    """

    grid: BeliefGrid
    nearness: Tensor
    beliefs: Tensor
    t_s: Tensor
    heard_t_s: Tensor
    started: Tensor


class BayesGrid:
    """The grid filter as a method. The belief is its own filter: it needs none behind it.

    A device has a fix from its first reading on, be it of one access point: the covariance says how little
    that is. An interval without a reading spreads the belief and stays without a fix.

    Args:
        settings: Of the filter; None for those of conf/method/bayes-grid.yaml.
    """

    name = NAME

    def __init__(self, settings: BayesGridSettings | None = None) -> None:
        self.settings = BayesGridSettings.read() if settings is None else settings

    @property
    def default_calibration(self) -> str:
        """What the observation model was fitted behind."""
        return self.settings.calibration

    def for_speed(self, speed_prior_mps: float) -> BayesGrid:
        """Return the method for people who walk at about ``speed_prior_mps``."""
        return BayesGrid(replace(self.settings, speed_prior_mps=speed_prior_mps))

    def init(self, site: Site, devices: int) -> BeliefState:
        """Return uniform beliefs of ``devices`` devices."""
        grid = BeliefGrid.over(site, cell_m=self.settings.cell_m, margin_m=self.settings.margin_m)
        return BeliefState(
            grid=grid,
            nearness=grid.distances_m.clamp(min=self.settings.cell_m / 2).reciprocal().float(),
            beliefs=grid.uniform(devices),
            t_s=torch.zeros(devices, dtype=torch.float64),
            heard_t_s=torch.zeros(devices, dtype=torch.float64),
            started=torch.zeros(devices, dtype=torch.bool),
        )

    def step(self, state: BeliefState, intervals: Intervals) -> tuple[BeliefState, Estimate]:
        """Blur the belief of every device that is present, and multiply it by what was heard."""
        hears = intervals.heard.any(-1) & intervals.present
        t_s = torch.where(state.started, torch.maximum(intervals.t_s.double(), state.t_s), intervals.t_s)
        dt_s = torch.where(state.started & intervals.present, t_s - state.t_s, 0.0)
        walked = self._walked(state.beliefs, self.settings.speed_prior_mps * dt_s)
        powers = self._powers(state, t_s.double())
        weighted = walked * self._likelihoods(state, intervals, powers).reshape(walked.shape)
        beliefs = weighted / weighted.sum((1, 2), keepdim=True)
        present = intervals.present[:, None, None]
        new = replace(
            state,
            beliefs=torch.where(present, beliefs, state.beliefs),
            t_s=torch.where(intervals.present, t_s.double(), state.t_s),
            heard_t_s=torch.where(hears, t_s.double(), state.heard_t_s),
            started=state.started | hears,
        )
        reasons = torch.where(hears, int(NoFix.FIXED), int(NoFix.NO_READING))
        return new, estimate(*new.grid.moments(new.beliefs), reasons)

    def _walked(self, beliefs: Tensor, spreads_m: Tensor) -> Tensor:
        """Return beliefs (B, X, Y) blurred by standard deviations (B,), metres."""
        variances = (spreads_m / self.settings.cell_m).square()[:, None]
        return moved(beliefs[:, None], torch.zeros(len(beliefs), 1, 2, dtype=beliefs.dtype), variances)[:, 0]

    def _powers(self, state: BeliefState, t_s: Tensor) -> Tensor:
        """Return how much of the likelihood of an interval counts, shape (B,)."""
        since_s = torch.where(state.started, t_s - state.heard_t_s, torch.inf)
        return tempered(since_s, self.settings.correlation_s)

    def _likelihoods(self, state: BeliefState, intervals: Intervals, powers: Tensor) -> Tensor:
        """Return Π (p(m|r) + floor)^power over the access points heard, shape (B, X · Y)."""
        model = self.settings
        density = 1 / (model.scale_low + model.ratio_high - model.ratio_low + model.scale_high)
        ratios = (intervals.ranges.float() - model.bias_m)[..., None] * state.nearness
        below = (model.ratio_low - ratios) / model.scale_low
        above = (ratios - model.ratio_high) / model.scale_high
        explained = torch.exp(-torch.maximum(below, above).clamp_(min=0.0)) * (density * state.nearness)
        factors = torch.where(intervals.heard[..., None], explained + model.floor_per_m, 1.0)
        return factors.double().prod(1) ** powers[:, None]
