"""A belief that knows of ranges only that walls lengthen them, and what it expects of every range.

It needs neither training nor a plan, and so carries no fault of a source or of a drawing to the features. What it
says of a link, given all other links, is the best that can be known of its error before anything is learned.

Axes: B devices, G gaits, A access points, X and Y cells, x and y those of a window, C = x · y, Q errors of a table.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fploc.intervals import Intervals
from fploc.methods.belief_grid import BeliefGrid, Window, posterior, tempered
from fploc.methods.link_evidence import LinkEvidence, RangeExpectation
from fploc.methods.walk import Transition, Walk, WalkSettings
from fploc.sites.site import Site

LOWEST_ERROR_M, ERROR_STEP_M, ERRORS = -12.0, 0.2, 260
"""Errors are looked up in steps; those beyond the ends of the table, up to 40 m, count as its ends."""
SILENT = ERRORS
"""Row behind the table: of access points that were not heard."""
LONGEST_GAP_S = 60.0
"""A walker who was away for so long may be anywhere."""
SMALLEST_SPREAD_M = 0.01


@dataclass(frozen=True)
class CoarseSettings:
    """Settings of the grid, of the walk and of the coarse belief.

    Args:
        cell_m: Side of a cell, metres.
        margin_m: Of the grid around the access points' bounding box, metres.
        walk: How people move.
        short_m: Decay of the density of errors below 0, metres.
        long_m: Decay of the density of errors above 0, metres.
        floor: Density of ranges that neither explains, beside that of the mode.
        coarse_correlation_s: For so long the coarse belief takes errors of ranges for one error.
    """

    cell_m: float
    margin_m: float
    walk: WalkSettings
    short_m: float
    long_m: float
    floor: float
    coarse_correlation_s: float


@dataclass(frozen=True)
class CoarseState:
    """Coarse beliefs of a batch of devices.

    Args:
        grid: Cells of the site.
        beliefs: Probability of each gait and cell of a window, shape (B, G, x, y), float32; 0 on all other cells.
        first_x: Index of the window's first cell along x, shape (B,).
        first_y: Index of the window's first cell along y, shape (B,).
        links: Past of every link.
        t_s: Time of each belief, shape (B,), seconds.
        heard_t_s: Time of the last interval of each that heard something, shape (B,), seconds.
        started: True once a device heard something, shape (B,).
    """

    grid: BeliefGrid
    beliefs: Tensor
    first_x: Tensor
    first_y: Tensor
    links: LinkEvidence
    t_s: Tensor
    heard_t_s: Tensor
    started: Tensor

    @classmethod
    def before(cls, grid: BeliefGrid, walk: Walk, devices: int) -> CoarseState:
        """Return the state before the first interval."""
        times = torch.zeros(devices, dtype=torch.float64)
        first = torch.zeros(devices, dtype=torch.int64)
        links = LinkEvidence.before(devices, len(grid.distances_m))
        nowhere = torch.zeros(devices, dtype=torch.bool)
        return cls(grid, walk.begun(grid.uniform(devices)), first, first, links, times, times, nowhere)

    @property
    def window(self) -> Window:
        """Cells that beliefs are held on."""
        return Window(self.grid, self.first_x, self.first_y, (self.beliefs.shape[2], self.beliefs.shape[3]))


@dataclass(frozen=True)
class Moved:
    """What a belief is by the time of an interval.

    Args:
        window: Cells that anybody can be on by now.
        transition: Where the time since the interval before took everybody.
        before: The belief at the interval before, shape (B, G, x, y).
        now: The belief, but for what the interval says, shape (B, G, x, y).
    """

    window: Window
    transition: Transition
    before: Tensor
    now: Tensor

    def settled(self, updated: Tensor, present: Tensor) -> Tensor:
        """Return ``updated`` (B, G, x, y) of devices that are present (B,), of others the belief before."""
        return torch.where(present[:, None, None, None], updated, self.before)


@dataclass(frozen=True)
class Heard:
    """What an interval brings to a belief behind the coarse one.

    Args:
        moved: The belief behind the coarse one, or the coarse one where there is none.
        features: Of every link, shape (B, A, F).
        error_bins: Row of the tables of errors that each cell would mean, shape (B, A, C), int32; ``SILENT`` where
            the device is absent or did not hear the access point.
        heard: True where a device that is present heard an access point, shape (B, A).
        since_s: Time since something was heard, shape (B,), seconds; infinite before the first time.
    """

    moved: Moved
    features: Tensor
    error_bins: Tensor
    heard: Tensor
    since_s: Tensor


def table_errors_m() -> Tensor:
    """Return the errors that tables are made for, shape (Q,), metres."""
    return LOWEST_ERROR_M + ERROR_STEP_M * (torch.arange(ERRORS, dtype=torch.float64) + 0.5)


def forgiving(errors_m: Tensor, *, short_m: float, long_m: float | Tensor, floor: float) -> Tensor:
    """Return a density of errors, beside that of its mode 0: walls lengthen ranges, nothing shortens them.

    Args:
        errors_m: Range minus distance, metres.
        short_m: Decay below 0, metres.
        long_m: Decay above 0, metres; one number, or a shape that broadcasts against errors.
        floor: What neither explains.
    """
    return torch.exp(-torch.maximum(errors_m / long_m, -errors_m / short_m)) + floor


class CoarseBelief:
    """Moves the coarse belief, and updates it.

    Args:
        settings: Of grid, walk and belief.
    """

    def __init__(self, settings: CoarseSettings) -> None:
        self.settings = settings
        self.walk = Walk(settings.walk)
        explained = forgiving(
            table_errors_m(), short_m=settings.short_m, long_m=settings.long_m, floor=settings.floor
        )
        self._likelihoods = torch.cat([explained, torch.ones(1, dtype=torch.float64)])

    def grid(self, site: Site) -> BeliefGrid:
        """Return the cells of a site."""
        return BeliefGrid.over(site, cell_m=self.settings.cell_m, margin_m=self.settings.margin_m)

    def step(
        self, state: CoarseState, intervals: Intervals, behind: Tensor | None = None
    ) -> tuple[CoarseState, Heard]:
        """Advance every device that is present by one interval.

        Args:
            state: Before the interval.
            intervals: Of every device.
            behind: Beliefs of the same devices on the same cells that move along, shape (B, G, x, y); None for
                the coarse ones.
        """
        heard = intervals.heard & intervals.present[:, None]
        hears = heard.any(-1)
        now = intervals.t_s.double()
        t_s = torch.where(state.started, torch.maximum(now, state.t_s), now)
        away_s = torch.where(state.started & intervals.present, t_s - state.t_s, 0.0)
        since_s = torch.where(state.started, t_s - state.heard_t_s, torch.inf)
        coarse, moved = self._moved(state, away_s.clamp(max=LONGEST_GAP_S), behind)

        distances_m = coarse.window.distances_m
        bins = _error_bins(distances_m, intervals, heard)
        likelihoods = self._likelihoods.index_select(0, bins.flatten()).view(bins.shape)
        coarse_log = likelihoods.log().sum(1)
        anyhow = posterior(coarse.now.sum(1, keepdim=True), coarse_log)[:, 0]
        expected = self._expected(distances_m, anyhow.double(), likelihoods)
        links, features = state.links.after(intervals, away_s, expected)
        powers = tempered(since_s, self.settings.coarse_correlation_s)
        updated = posterior(coarse.now, torch.where(hears, powers, 0.0)[:, None] * coarse_log)
        new = CoarseState(
            grid=state.grid,
            beliefs=coarse.settled(updated, intervals.present),
            first_x=coarse.window.first_x,
            first_y=coarse.window.first_y,
            links=links,
            t_s=torch.where(intervals.present, t_s, state.t_s),
            heard_t_s=torch.where(hears, t_s, state.heard_t_s),
            started=state.started | hears,
        )
        return new, Heard(moved, features, bins, heard, since_s)

    def _moved(self, state: CoarseState, dt_s: Tensor, behind: Tensor | None) -> tuple[Moved, Moved]:
        """Return what the coarse beliefs and those behind them are ``dt_s`` (B,) later."""
        beliefs = [state.beliefs] if behind is None else [state.beliefs, behind]
        grid, held = state.grid, state.window
        strides = self.walk.strides(dt_s, grid.cell_m, farthest=max(len(grid.xs_m), len(grid.ys_m)))
        window = held.around(beliefs, strides.reach)
        transition = strides.on(window.shape)
        cut = [window.cut(one, held) for one in beliefs]
        moved = [Moved(window, transition, one, transition.onwards(one)) for one in cut]
        return moved[0], moved[-1]

    @staticmethod
    def _expected(distances_m: Tensor, beliefs: Tensor, likelihoods: Tensor) -> RangeExpectation:
        """Return what beliefs (B, x, y) expect of ranges, with and without the likelihoods (B, A, C) of each."""
        weights = beliefs.flatten(1)
        by_all = (distances_m @ weights[..., None])[..., 0]
        # Dividing a range's own likelihood out again leaves what the other ranges say.
        others = weights[:, None, :] / likelihoods
        total, first = others.sum(-1), torch.linalg.vecdot(others, distances_m)
        mean, square = first / total, torch.linalg.vecdot(others * distances_m, distances_m) / total
        spread = (square - mean.square()).clamp(min=SMALLEST_SPREAD_M**2).sqrt()
        return RangeExpectation(by_others=mean, spread=spread, by_all=by_all)


def _error_bins(distances_m: Tensor, intervals: Intervals, heard: Tensor) -> Tensor:
    """Return the row of the tables for the error that each cell would mean, shape (B, A, C), int32."""
    # Narrow types: this is the largest tensor of a step.
    steps = (intervals.ranges.double() - LOWEST_ERROR_M) / ERROR_STEP_M
    bins = (steps.float()[..., None] - (distances_m / ERROR_STEP_M).float()).clamp_(0, ERRORS - 1).int()
    return bins.masked_fill_(~heard[..., None], SILENT)
