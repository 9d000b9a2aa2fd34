"""``rtt-rss``: ranges and signal strengths in one filter for each access point, then least squares
(Guo, Chen, Ye, Peng, Liu, Pan, IEEE Access 2019).

From the source: the offset of each access point is removed (here by the calibration), ranges from round-trip time
and from signal strength are integrated by a Kalman filter whose noise is scaled by its innovations. Reconstructed
here: the filter is scalar on the range, a random walk, with two updates in an interval; a measurement whose
normalised innovation squared v²/S exceeds the gate has its R multiplied by v²/(gate · S); the signal strength's
range is 10^((A − RSS)/(10 n)), its R follows from the spread of RSS in dB; least squares takes the filtered ranges
of the access points that answered in this interval, weighted by the filter's variances.

Axes: B devices, A access points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fploc.conf import instantiate, read_conf
from fploc.intervals import Estimate, Intervals
from fploc.sites.site import Site
from fploc.solvers.nonlinear import solve_nonlinear

NAME = "rtt-rss"


@dataclass(frozen=True)
class RttRssSettings:
    """Settings of the filters: conf/method/rtt-rss.yaml.

    Args:
        noise_m2_per_s: q, growth of a range's variance with time.
        rtt_variance_m2: R of a range from round-trip time.
        rss_sd_db: Spread of signal strength around the path loss.
        gate: v²/S beyond which R grows with the innovation.
        rss_at_1_m_dbm: A of the path loss.
        path_loss_exponent: n of the path loss.
        calibration: That it runs with unless asked.
    """

    noise_m2_per_s: float
    rtt_variance_m2: float
    rss_sd_db: float
    gate: float
    rss_at_1_m_dbm: float
    path_loss_exponent: float
    calibration: str

    @classmethod
    def read(cls) -> RttRssSettings:
        """Return the settings in conf/method/rtt-rss.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")

    def distances(self, rss: Tensor) -> Tensor:
        """Return the distance of each signal strength, dBm, by the path loss, metres."""
        return 10 ** ((self.rss_at_1_m_dbm - rss) / (10 * self.path_loss_exponent))

    def rss_variances(self, distances: Tensor) -> Tensor:
        """Return R of distances from signal strength, square metres: their slope times ``rss_sd_db``, squared."""
        return (distances * (math.log(10) / (10 * self.path_loss_exponent) * self.rss_sd_db)).square()


@dataclass(frozen=True)
class LinkState:
    """Filters of the links of a batch of devices.

    Args:
        access_points: Positions, shape (A, 2), metres, site frame.
        ranges: Filtered range, shape (B, A), metres.
        variances: Of each, shape (B, A), square metres.
        t_s: Time of each link's last measurement, shape (B, A), seconds.
        started: True once a link was heard, shape (B, A).
    """

    access_points: Tensor
    ranges: Tensor
    variances: Tensor
    t_s: Tensor
    started: Tensor


@dataclass(frozen=True)
class LinkRanges:
    """Filtered ranges to solve for positions.

    Args:
        ranges: Shape (B, A), metres.
        sigmas: Their standard deviations, shape (B, A), metres.
        heard: True where there is one in this interval, shape (B, A).
    """

    ranges: Tensor
    sigmas: Tensor
    heard: Tensor


class RttRss:
    """The method. It filters ranges, not positions: the Kalman filter on positions comes after it.

    Args:
        settings: Of the filters; None for those of conf/method/rtt-rss.yaml.
    """

    name = NAME

    def __init__(self, settings: RttRssSettings | None = None) -> None:
        self.settings = RttRssSettings.read() if settings is None else settings

    @property
    def default_calibration(self) -> str:
        """Chosen with the other settings."""
        return self.settings.calibration

    def init(self, site: Site, devices: int) -> LinkState:
        """Return the state of ``devices`` devices before their first interval."""
        links = torch.zeros(devices, len(site.access_points), dtype=torch.float64)
        return LinkState(
            access_points=torch.from_numpy(site.positions_m),
            ranges=links,
            variances=torch.ones_like(links),
            t_s=links,
            started=torch.zeros_like(links, dtype=torch.bool),
        )

    def step(self, state: LinkState, intervals: Intervals) -> tuple[LinkState, Estimate]:
        """Filter the range of every access point heard, and solve for the position."""
        state, rows = self.follow(state, intervals)
        return state, self.solve(state.access_points, rows)

    def solve(self, access_points: Tensor, rows: LinkRanges) -> Estimate:
        """Return the positions that filtered ranges give."""
        return solve_nonlinear(rows.ranges, access_points, rows.sigmas, rows.heard)

    def follow(self, state: LinkState, intervals: Intervals) -> tuple[LinkState, LinkRanges]:
        """Filter the range of every access point heard."""
        heard = intervals.heard & intervals.present[:, None]
        measured, rtt_variance = intervals.ranges.double(), self.settings.rtt_variance_m2
        now = torch.maximum(intervals.t_s.double()[:, None], state.t_s)
        predicted = state.variances + self.settings.noise_m2_per_s * (now - state.t_s)
        after_rtt = self._updated(state.ranges, predicted, measured, torch.full_like(measured, rtt_variance))
        ranges = torch.where(state.started, after_rtt[0], measured)
        variances = torch.where(state.started, after_rtt[1], rtt_variance)
        from_rss = self.settings.distances(intervals.rss.double())
        ranges, variances = self._updated(ranges, variances, from_rss, self.settings.rss_variances(from_rss))
        new = replace(
            state,
            ranges=torch.where(heard, ranges, state.ranges),
            variances=torch.where(heard, variances, state.variances),
            t_s=torch.where(heard, now, state.t_s),
            started=state.started | heard,
        )
        return new, LinkRanges(new.ranges, new.variances.sqrt(), heard)

    def _updated(
        self, ranges: Tensor, variances: Tensor, measured: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return ranges and variances after a scalar Kalman update, shape (B, A) all."""
        innovation = measured - ranges
        excess = innovation.square() / (self.settings.gate * (variances + noise))
        gain = variances / (variances + noise * excess.clamp(min=1.0))
        return ranges + gain * innovation, (1 - gain) * variances
