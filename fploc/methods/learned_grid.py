"""``learned-grid``: a belief over the plan's free space, whose likelihood of every range is learned.

The paper's chain passes one coarse point, then one corrected number per access point. Here nothing is passed on
but distributions. At every interval

1. a coarse belief (``fploc.methods.coarse_belief``) says what it expects of every range by all the others;
2. small networks (``fploc.models.range_error``) make distributions of the range's error: bias, a spread on either
   side, probability of an outlier. Each is shown something else of the link
   (``fploc.methods.link_evidence.VIEWS``), and all but the last one say it twice: for a clear line, and for walls
   between;
3. the belief is moved as people move (``fploc.methods.walk``), and multiplied by the product over links of a density
   ∝ p_learned^share · p_left^(1 − share), of which there are two, and the plan says for every cell which it is.
   p_learned pools the networks; p_left is of what the last one's bias leaves of the error, and takes all that is
   still too long with a shrug. On clear lines errors are much alike everywhere; walls differ, and behind them little
   of what was learned elsewhere is believed.

Likelihoods are tempered, since errors of a place repeat as long as one is there: the faster somebody walks, the
more an interval says that is new. The plan weighs cells, too: nobody stands in a wall. The networks learn from
recordings of source sites in which access points fall silent and offsets drift by the minute, so that they do not
learn the source's geometry by heart.

Axes: B devices, A access points, C cells, S kinds of sight, Q errors of a table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from fploc.conf import instantiate, read_conf
from fploc.errors import FplocError
from fploc.floorplan.plan import FloorPlan
from fploc.intervals import Estimate, Intervals, NoFix, estimate, stacked
from fploc.methods.belief_grid import LEAST_WEIGHT, BeliefGrid, Window, likelihood_ratios, posterior
from fploc.methods.coarse_belief import (
    SILENT,
    CoarseBelief,
    CoarseSettings,
    CoarseState,
    Heard,
    forgiving,
    table_errors_m,
)
from fploc.methods.interface import Examples
from fploc.methods.link_evidence import SIGHTS, VIEWS
from fploc.methods.range_lessons import LessonSettings, range_lessons, taught
from fploc.methods.walk import Transition
from fploc.models.range_error import RangeErrorNetwork, log_density, modes_m
from fploc.progress import track
from fploc.sites.site import Site

NAME = "learned-grid"


@dataclass(frozen=True)
class Trust:
    """How far ranges of a kind of sight are believed to be wrong as they were elsewhere.

    Args:
        learned_share: Power of the learned density beside that of what a bias leaves, 0 to 1.
        left_long_m: Decay of the density of what a bias leaves above 0, metres.
    """

    learned_share: float
    left_long_m: float


@dataclass(frozen=True)
class LearnedGridSettings:
    """Settings of the method: conf/method/learned-grid.yaml.

    Args:
        coarse: Of the grid, of the walk and of the coarse belief.
        lessons: Of the network and its training.
        blocked: How likely a cell is that nobody can stand on, beside a free one: drawings lie.
        clear: How far the networks are trusted on clear lines.
        walled: How far they are behind walls.
        left_short_m: Decay of the density of what a bias leaves below 0, metres.
        correlation_s: For so long errors of ranges are taken for one error on the spot.
        correlation_m: Over so many metres of a walk they are, too.
        survey_m: Standard deviation per axis of what no belief can know, metres: the frame of access points
            and plan.
        calibration: That it runs with unless asked.
    """

    coarse: CoarseSettings
    lessons: LessonSettings
    blocked: float
    clear: Trust
    walled: Trust
    left_short_m: float
    correlation_s: float
    correlation_m: float
    survey_m: float
    calibration: str

    @classmethod
    def read(cls) -> LearnedGridSettings:
        """Return the settings in conf/method/learned-grid.yaml."""
        return instantiate(cls, read_conf("method", NAME), source=f"conf/method/{NAME}.yaml")

    def sharing(self, learned_share: float) -> LearnedGridSettings:
        """Return the same with this share of what was learned, whatever the sight."""
        clear, walled = (replace(one, learned_share=learned_share) for one in (self.clear, self.walled))
        return replace(self, clear=clear, walled=walled)


class LearnedGrid:
    """Learns how wrong ranges of source sites are.

    Args:
        settings: Of the method; None for those of conf/method/learned-grid.yaml.
    """

    name = NAME
    learns_places = False

    def __init__(self, settings: LearnedGridSettings | None = None) -> None:
        self.settings = LearnedGridSettings.read() if settings is None else settings

    @property
    def default_calibration(self) -> str:
        """Chosen with the other settings."""
        return self.settings.calibration

    def fitted(self, sources: Sequence[Examples]) -> LearnedGridFilter:
        """Return the method that has learned from the readings of all sources.

        Raises:
            FplocError: If no reading has ground truth, or a source no plan.
        """
        coarse = CoarseBelief(self.settings.coarse)
        lessons = [range_lessons(one, coarse, self.settings.lessons) for one in sources]
        known = [one for one in lessons if len(one.errors_m)]
        if not known:
            raise FplocError(
                f"--method {NAME}",
                value="no labelled reading to learn from",
                expected="recordings with ground truth",
                way_out="choose another method",
            )
        networks = [taught(known, view, self.settings.lessons) for view in VIEWS]
        return LearnedGridFilter(self.settings, networks)


@dataclass(frozen=True)
class LearnedGridState:
    """Beliefs of a batch of devices.

    Args:
        coarse: The coarse ones.
        beliefs: Those that estimates are made from, on the same cells, shape (B, G, x, y).
    """

    coarse: CoarseState
    beliefs: Tensor


@dataclass(frozen=True)
class _Passed:
    """What became of beliefs in an interval.

    Args:
        window: Cells that anybody could be on.
        transition: Where the time since the interval before took everybody.
        log_likelihoods: What was heard says, tempered, shape (B, C).
        hears: True where a device heard something, shape (B,).
        beliefs: Behind the interval, shape (B, G, x, y).
    """

    window: Window
    transition: Transition
    log_likelihoods: Tensor
    hears: Tensor
    beliefs: Tensor


class LearnedGridFilter:
    """The method that has learned. It is its own filter.

    A device has a fix from its first reading on, be it of one access point: the covariance says how little
    that is. An interval without a reading spreads the belief and stays without a fix.

    Args:
        settings: Of the method.
        networks: Each says how wrong a range may be; their likelihoods are pooled evenly. The last one's bias is
            taken off ranges.
        plan: Of the target; None where it has none.
    """

    name = NAME

    def __init__(
        self,
        settings: LearnedGridSettings,
        networks: Sequence[RangeErrorNetwork],
        plan: FloorPlan | None = None,
    ) -> None:
        self.settings = settings
        self.networks = tuple(networks)
        self._plan = plan
        self._coarse = CoarseBelief(settings.coarse)
        self._errors_m = table_errors_m().float()
        trusts = (settings.clear, settings.walled)
        self._learned_shares = torch.tensor([one.learned_share for one in trusts])
        self._left_long_m = torch.tensor([one.left_long_m for one in trusts])
        self._grids: dict[Site, BeliefGrid] = {}

    def for_speed(self, speed_prior_mps: float) -> LearnedGridFilter:
        """Return the method for people who walk at about ``speed_prior_mps``."""
        walk = replace(self.settings.coarse.walk, speed_prior_mps=speed_prior_mps)
        coarse = replace(self.settings.coarse, walk=walk)
        return LearnedGridFilter(replace(self.settings, coarse=coarse), self.networks, self._plan)

    def for_plan(self, plan: FloorPlan) -> LearnedGridFilter:
        """Return the method for a site with this plan."""
        return LearnedGridFilter(self.settings, self.networks, plan)

    def init(self, site: Site, devices: int) -> LearnedGridState:
        """Return uniform beliefs of ``devices`` devices."""
        grid, walk = self._grid(site), self._coarse.walk
        return LearnedGridState(CoarseState.before(grid, walk, devices), walk.begun(grid.uniform(devices)))

    def _grid(self, site: Site) -> BeliefGrid:
        """Return the cells of a site with what the plan says of them, which takes a second the first time."""
        if site not in self._grids:
            grid = self._coarse.grid(site)
            if self._plan is not None:
                grid = grid.on(self._plan, site, blocked=self.settings.blocked)
            self._grids[site] = grid
        return self._grids[site]

    @torch.no_grad()
    def step(self, state: LearnedGridState, intervals: Intervals) -> tuple[LearnedGridState, Estimate]:
        """Move the belief of every device that is present, and multiply it by what was heard."""
        new, passed = self._advanced(state, intervals)
        return new, self._estimated(passed)

    @torch.no_grad()
    def both_ways(self, site: Site, intervals: Intervals) -> tuple[Estimate, Estimate]:
        """Return what ``step`` makes of every interval, and what the belief there is when all later ones are known.

        Beliefs of all intervals are held at once, but only where they are not 0.
        """
        state, passed, smoothed = self.init(site, intervals.t_s.shape[1]), [], []
        for step in track(range(len(intervals.t_s)), self.name):
            state, one = self._advanced(state, intervals.at(step))
            passed.append(one)
        everywhere = Window.whole(state.coarse.grid, len(state.beliefs))
        messages = torch.ones(*state.beliefs.shape[:2], *everywhere.shape, dtype=torch.float64)
        for one, present in zip(reversed(passed), intervals.present.flip(0), strict=True):
            later = one.window.cut(messages, everywhere)
            both = one.beliefs * later
            smoothed.append(self._estimated(replace(one, beliefs=both / both.sum((1, 2, 3), keepdim=True))))
            weights = likelihood_ratios(one.log_likelihoods).unflatten(1, one.window.shape)
            earlier = one.transition.looked_back(later * weights[:, None])
            earlier = earlier / earlier.amax((1, 2, 3), keepdim=True)
            earlier = everywhere.cut(earlier, one.window).clamp(min=LEAST_WEIGHT)
            messages = torch.where(present[:, None, None, None], earlier, messages)
        return stacked([self._estimated(one) for one in passed]), stacked(smoothed[::-1])

    def _advanced(self, state: LearnedGridState, intervals: Intervals) -> tuple[LearnedGridState, _Passed]:
        """Return the state after an interval, and how it came about."""
        coarse, heard = self._coarse.step(state.coarse, intervals, state.beliefs)
        moved, hears = heard.moved, heard.heard.any(-1)
        powers = torch.where(hears, self._powers(moved.now, heard.since_s), 0.0)
        log_likelihoods = powers[:, None] * (moved.window.plan_log + self._log_likelihoods(heard))
        beliefs = moved.settled(posterior(moved.now, log_likelihoods), intervals.present)
        passed = _Passed(moved.window, moved.transition, log_likelihoods, hears, beliefs)
        return LearnedGridState(coarse, beliefs), passed

    def _estimated(self, passed: _Passed) -> Estimate:
        """Return mean and covariance of beliefs, where something was heard."""
        positions, covariances = passed.window.moments(passed.beliefs.sum(1).double())
        unknowable = torch.eye(2, dtype=torch.float64) * self.settings.survey_m**2
        reasons = torch.where(passed.hears, int(NoFix.FIXED), int(NoFix.NO_READING))
        return estimate(positions, covariances + unknowable, reasons)

    def _powers(self, beliefs: Tensor, since_s: Tensor) -> Tensor:
        """Return how much of the likelihood of an interval is new, shape (B,), so long after the last one."""
        by_walking = self._coarse.walk.mean_speeds_mps(beliefs) / self.settings.correlation_m
        per_second = 1 / self.settings.correlation_s + by_walking
        return (since_s * per_second).clamp(max=1.0)

    def _log_likelihoods(self, heard: Heard) -> Tensor:
        """Return the pooled log-likelihood of the interval, shape (B, C)."""
        links = heard.features.flatten(0, 1)
        # Tables are no finer than the beliefs that they weigh.
        tables = self._densities([network(links).float() for network in self.networks])
        if self._plan is None:
            tables = self.networks[0].wherever(tables)
        tables = nn.functional.pad(tables, (0, 1)).expand(-1, SIGHTS, -1)
        bins = heard.error_bins
        rows = SIGHTS * torch.arange(len(tables), dtype=torch.int32).view(*bins.shape[:2], 1)
        at = bins + (rows + heard.moved.window.walled) * (SILENT + 1)
        return tables.flatten().index_select(0, at.flatten()).view(bins.shape).sum(1)

    def _densities(self, raw: Sequence[Tensor]) -> Tensor:
        """Return the logarithm of the density of errors for each kind of sight, shape (n, S, Q), scaled to sum 1.

        Args:
            raw: Parameters that each network gives, shape (n, S, 4) or (n, 1, 4).
        """
        learned = sum(log_density(one, self._errors_m) for one in raw) / len(raw)
        left = self._left(self._errors_m - modes_m(raw[-1])).log()
        shares = self._learned_shares[:, None]
        return (shares * learned + (1 - shares) * left).log_softmax(-1)

    def _left(self, errors_m: Tensor) -> Tensor:
        """Return the density of what a bias leaves of errors, beside that of its mode, shape (n, S, Q)."""
        settings = self.settings
        return forgiving(
            errors_m,
            short_m=settings.left_short_m,
            long_m=self._left_long_m[:, None],
            floor=settings.coarse.floor,
        )
