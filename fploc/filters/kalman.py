"""Kalman filter on position fixes whose velocity forgets itself, one for every method.

State [x, y, vx, vy] in metres and metres per second, site frame. Each velocity component is an
Ornstein–Uhlenbeck process: it decays with a time constant τ and is driven by white noise of density q, so that a
person walks at the prior speed on average, turns within τ, and is not carried away through a gap without fixes.
For steps far shorter than τ this is the constant-velocity model, Q = q [[dt³/3, dt²/2], [dt²/2, dt]] per axis.
The paper gives no parameters; these are stated in ``KalmanSettings``, with how they were chosen. An interval
without a fix only predicts and stays without a fix: what to show meanwhile is the reader's choice, and scoring
holds the last fix.

``TrackFilter`` follows one device with filterpy; ``BatchedFilter`` is its twin for a batch in torch and equals
it within 1e-9.

Axes: B devices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import torch
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from torch import Tensor

from fploc.intervals import Estimate, estimate
from fploc.solvers.planar import symmetric_inverse

HEADLINE_SPEED_MPS = 0.5
SHORTEST_STEP_S = 1e-3
"""Time stamps are whole milliseconds."""


@dataclass(frozen=True)
class KalmanSettings:
    """Parameters of the filter, the same for every method.

    The speed is the prior of the headline tables. ``turning_s`` and ``correlation_s`` are the pair with the least
    error out of {5, 10, 20} × {0, 1, 2} s, mean logarithm of the RMSE of ``nls``, ``nls-robust``,
    ``nls-onesided`` and ``trilateration`` on the office of 2022 (laps 1 to 4, repaired labels), each as recorded
    and with every tenth interval, with all access points and with each silent half of the time. Every tenth
    interval stands for people: the office's robot, like those of the other sites, goes at 0.06 m/s. Against
    constant velocity with q 0.3 m²/s³, R 1 m² and a gate, it is 23 % lower. ``fix_variance_m2`` and ``gate`` are
    principles, not fitted: what walls add to all ranges alike shows in no residual, and a fix beyond three
    standard deviations is believed the less the farther it is (the rule of ``rtt-rss``), never thrown away.

    Args:
        speed_mps: Root mean square speed of a person in the plane, and of each track at its start.
        turning_s: τ, time in which the velocity forgets itself.
        fix_variance_m2: Variance per axis that every fix has beside its own covariance.
        gate: Normalised innovation squared, νᵀS⁻¹ν, from which R grows in proportion to it.
        correlation_s: For so long the errors of successive fixes are one error: R grows by this over the time
            since the last fix, where that is shorter.
    """

    speed_mps: float = HEADLINE_SPEED_MPS
    turning_s: float = 5.0
    fix_variance_m2: float = 1.0
    gate: float = 9.0
    correlation_s: float = 1.0

    @classmethod
    def for_speed(cls, speed_prior_mps: float) -> KalmanSettings:
        """Return the settings for people who walk at about ``speed_prior_mps``."""
        return cls(speed_mps=speed_prior_mps)

    @property
    def velocity_variance_m2_per_s2(self) -> float:
        """Variance of each velocity component, (m/s)²: two of them make the speed."""
        return self.speed_mps**2 / 2

    @property
    def noise_m2_per_s3(self) -> float:
        """q, the density that keeps the velocity's variance where it is."""
        return 2 * self.velocity_variance_m2_per_s2 / self.turning_s


# Made once: the filter is stepped thousands of times, and small tensors cost more to make than to use.
_IDENTITY = torch.eye(4, dtype=torch.float64)
_POSITION = torch.diag(torch.tensor([1.0, 1.0, 0.0, 0.0], dtype=torch.float64))
_VELOCITY = torch.diag(torch.tensor([0.0, 0.0, 1.0, 1.0], dtype=torch.float64))
_VELOCITY_TO_POSITION = torch.diag(torch.ones(2, dtype=torch.float64), 2)
_NOISE_BLOCKS = torch.stack([_POSITION, _VELOCITY_TO_POSITION + _VELOCITY_TO_POSITION.T, _VELOCITY])
"""Where position's, shared and velocity's variances stand in Q, shape (3, 4, 4)."""


def transition(dt_s: Tensor, turning_s: float) -> Tensor:
    """Return F, shape (B, 4, 4), for time steps of shape (B,), seconds, float64."""
    kept = torch.exp(-dt_s / turning_s)[:, None, None]
    moved = -turning_s * torch.expm1(-dt_s / turning_s)[:, None, None]
    blocks = _POSITION.to(dt_s.device), _VELOCITY.to(dt_s.device), _VELOCITY_TO_POSITION.to(dt_s.device)
    return blocks[0] + kept * blocks[1] + moved * blocks[2]


def process_noise(dt_s: Tensor, settings: KalmanSettings) -> Tensor:
    """Return Q, shape (B, 4, 4), for time steps of shape (B,), seconds, float64."""
    turning_s = settings.turning_s
    lost = -torch.expm1(-dt_s / turning_s)
    twice = -torch.expm1(-2 * dt_s / turning_s)
    position = turning_s**2 * (dt_s - 2 * turning_s * lost + turning_s / 2 * twice)
    shared = turning_s**2 / 2 * lost.square()
    velocity = turning_s / 2 * twice
    variances = torch.stack([position, shared, velocity], -1) * settings.noise_m2_per_s3
    return (variances @ _NOISE_BLOCKS.to(dt_s.device).reshape(3, 16)).reshape(-1, 4, 4)


@dataclass(frozen=True)
class KalmanState:
    """Tracks of a batch of devices.

    Args:
        means: Shape (B, 4), metres and metres per second, site frame.
        covariances: Shape (B, 4, 4).
        t_s: Time of each track, shape (B,), seconds.
        fixed_t_s: Time of each track's last fix, shape (B,), seconds.
        started: True once a device had a fix, shape (B,).
    """

    means: Tensor
    covariances: Tensor
    t_s: Tensor
    fixed_t_s: Tensor
    started: Tensor


@dataclass(frozen=True)
class _Moves:
    """What intervals do to tracks, wherever these are.

    Args:
        now: Time after the interval, shape (B,), seconds.
        flow: F, shape (B, 4, 4).
        drift: Q, shape (B, 4, 4).
        measured: The fix, shape (B, 2), metres; 0 where there is none.
        alone: R of a fix that stands alone, shape (B, 2, 2), square metres.
        noise: R among the fixes before it, shape (B, 2, 2), square metres.
        starts: True where a track starts, shape (B,).
        updates: True where a fix enters a track that has started, shape (B,).
        advances: True where a track is after the interval what it was not before, shape (B,).
    """

    now: Tensor
    flow: Tensor
    drift: Tensor
    measured: Tensor
    alone: Tensor
    noise: Tensor
    starts: Tensor
    updates: Tensor
    advances: Tensor

    def by_step(self, steps: int, devices: int) -> Iterator[_Moves]:
        """Yield those of every step, out of T · B of them."""
        columns = [getattr(self, one.name).unflatten(0, (steps, devices)).unbind() for one in fields(self)]
        return (_Moves(*row) for row in zip(*columns, strict=True))


class BatchedFilter:
    """The filter over a batch of devices, float64, no loop over them."""

    def __init__(self, settings: KalmanSettings) -> None:
        self.settings = settings
        self._first_velocity_covariance = settings.velocity_variance_m2_per_s2 * _VELOCITY

    def init(self, devices: int, *, device: torch.device | str = "cpu") -> KalmanState:
        """Return the state of ``devices`` tracks before their first fix."""
        return KalmanState(
            means=torch.zeros(devices, 4, dtype=torch.float64, device=device),
            covariances=torch.eye(4, dtype=torch.float64, device=device).repeat(devices, 1, 1),
            t_s=torch.zeros(devices, dtype=torch.float64, device=device),
            fixed_t_s=torch.zeros(devices, dtype=torch.float64, device=device),
            started=torch.zeros(devices, dtype=torch.bool, device=device),
        )

    def step(
        self, state: KalmanState, t_s: Tensor, present: Tensor, fixes: Estimate
    ) -> tuple[KalmanState, Estimate]:
        """Advance every device that is present by one interval.

        Args:
            state: Of the tracks.
            t_s: Time of the interval, shape (B,), seconds; a time before the track's own counts as equal.
            present: True where the device has an interval, shape (B,); others keep their state.
            fixes: What the method found.

        Returns:
            The new state and the filtered estimate, whose reasons are those of ``fixes``.
        """
        moves = self._moves(t_s, present, fixes, (state.t_s, state.fixed_t_s, state.started))
        means, covariances = self._moved(state.means, state.covariances, moves, bool(moves.updates.all()))
        new = KalmanState(
            means=means,
            covariances=covariances,
            t_s=torch.where(moves.advances, moves.now, state.t_s),
            fixed_t_s=torch.where(moves.updates | moves.starts, moves.now, state.fixed_t_s),
            started=state.started | moves.starts,
        )
        return new, estimate(new.means[:, :2], new.covariances[:, :2, :2], fixes.reasons)

    def run(self, t_s: Tensor, present: Tensor, fixes: Estimate) -> Estimate:
        """Filter whole recordings from a fresh state, as ``step`` does one interval after the other.

        When a track moves depends on no position, so that all but the update itself is made for all steps at once.

        Args:
            t_s: Times of the intervals, shape (T, B), seconds.
            present: True where a device has an interval, shape (T, B).
            fixes: What the method found, shape (T, B, …).

        Returns:
            The filtered estimates, shape (T, B, …).
        """
        steps, devices = t_s.shape
        state = self.init(devices, device=t_s.device)
        fixed = fixes.fixed & present
        started = torch.cat([state.started[None], fixed]).int().cummax(0).values.bool()
        advancing = torch.where(present & started[1:], t_s.double(), 0.0)
        times = torch.cat([state.t_s[None], advancing]).cummax(0).values
        now = torch.maximum(t_s.double(), times[:-1])
        fixed_times = torch.cat([state.fixed_t_s[None], torch.where(fixed, now, 0.0)]).cummax(0).values
        before = (times[:-1].flatten(), fixed_times[:-1].flatten(), started[:-1].flatten())
        rows = Estimate(
            fixes.positions.flatten(0, 1), fixes.covariances.flatten(0, 1), fixes.reasons.flatten()
        )
        moves = self._moves(t_s.flatten(), present.flatten(), rows, before)
        all_update = moves.updates.reshape(steps, devices).all(-1).tolist()
        means, covariances, found = state.means, state.covariances, []
        for one, updates in zip(moves.by_step(steps, devices), all_update, strict=True):
            means, covariances = self._moved(means, covariances, one, updates)
            found.append((means[:, :2], covariances[:, :2, :2]))
        filtered = estimate(
            torch.cat([positions for positions, _ in found]),
            torch.cat([spreads for _, spreads in found]),
            rows.reasons,
        )
        return Estimate(
            filtered.positions.reshape(steps, devices, 2),
            filtered.covariances.reshape(steps, devices, 2, 2),
            filtered.reasons.reshape(steps, devices),
        )

    def _moves(
        self, t_s: Tensor, present: Tensor, fixes: Estimate, before: tuple[Tensor, Tensor, Tensor]
    ) -> _Moves:
        """Return what intervals (B,) do to tracks, from ``t_s``, ``fixed_t_s`` and ``started`` before them."""
        track_t_s, fixed_t_s, started = before
        now = torch.maximum(t_s.double(), track_t_s)
        dt = now - track_t_s
        fixed = fixes.fixed & present
        alone = self._fix_covariances(fixes, fixed)
        starts = fixed & ~started
        return _Moves(
            now=now,
            flow=transition(dt, self.settings.turning_s),
            drift=process_noise(dt, self.settings),
            measured=torch.where(fixed[:, None], fixes.positions.double(), 0.0),
            alone=alone,
            noise=alone * _correlated(now - fixed_t_s, self.settings.correlation_s)[:, None, None],
            starts=starts,
            updates=fixed & started,
            advances=present & (started | starts),
        )

    def _moved(
        self, means: Tensor, covariances: Tensor, moves: _Moves, all_update: bool
    ) -> tuple[Tensor, Tensor]:
        """Return means and covariances after one interval; there is nothing to choose where all update."""
        predicted_means = (moves.flow @ means[..., None])[..., 0]
        predicted = moves.flow @ covariances @ moves.flow.mT + moves.drift
        innovation = moves.measured - predicted_means[:, :2]
        spread_inverse = symmetric_inverse(predicted[:, :2, :2] + moves.noise)
        distance = (innovation[:, None, :] @ spread_inverse @ innovation[..., None])[:, 0, 0]
        noise = moves.noise * (distance / self.settings.gate).clamp(min=1.0)[:, None, None]

        gain = predicted[:, :, :2] @ symmetric_inverse(predicted[:, :2, :2] + noise)
        kept = _IDENTITY.to(gain.device) - torch.nn.functional.pad(gain, (0, 2))
        updated_means = predicted_means + (gain @ innovation[..., None])[..., 0]
        updated = kept @ predicted @ kept.mT + gain @ noise @ gain.mT
        if all_update:
            return updated_means, updated

        first_means = torch.nn.functional.pad(moves.measured, (0, 2))
        first = torch.nn.functional.pad(moves.alone, (0, 2, 0, 2))
        first = first + self._first_velocity_covariance.to(first.device)
        new_means = _choose(moves.starts, first_means, _choose(moves.updates, updated_means, predicted_means))
        new = _choose(moves.starts, first, _choose(moves.updates, updated, predicted))
        return _choose(moves.advances, new_means, means), _choose(moves.advances, new, covariances)

    def _fix_covariances(self, fixes: Estimate, fixed: Tensor) -> Tensor:
        """Return R of fixes that stand alone, shape (B, 2, 2), square metres."""
        own = torch.where(fixed[:, None, None], fixes.covariances.double(), 0.0)
        return own + self.settings.fix_variance_m2 * _IDENTITY[:2, :2].to(own.device)


def _correlated(since_s: Tensor, correlation_s: float) -> Tensor:
    """Return by what R grows for fixes so many seconds after the last one; two at one time count once."""
    return (correlation_s / since_s.clamp(min=SHORTEST_STEP_S)).clamp(min=1.0)


def _choose(where: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """Return ``one`` where the device is chosen, shape (B,), else ``other``, shapes (B, …)."""
    return torch.where(where.reshape(-1, *[1] * (one.dim() - 1)), one, other)


class TrackFilter:
    """The filter of one device, by filterpy: the reference that ``BatchedFilter`` is held to."""

    def __init__(self, settings: KalmanSettings) -> None:
        self.settings = settings
        self.t_s = 0.0
        self.fixed_t_s = 0.0
        self._filter: KalmanFilter | None = None

    def step(
        self, t_s: float, position_m: NDArray[np.float64] | None, covariance_m2: NDArray[np.float64] | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Advance by one interval.

        Args:
            t_s: Time of the interval, seconds.
            position_m: The fix, shape (2,), metres, site frame, or None.
            covariance_m2: Its covariance, shape (2, 2), square metres, or None without a fix.

        Returns:
            Position (2,) and covariance (2, 2) after the interval; None before the first fix.
        """
        if self._filter is not None:
            self._predict(max(0.0, t_s - self.t_s))
        self.t_s = max(self.t_s, t_s)
        if position_m is not None and covariance_m2 is not None:
            alone = covariance_m2 + self.settings.fix_variance_m2 * np.eye(2)
            self._take(np.asarray(position_m, dtype=np.float64).reshape(2, 1), alone)
            self.fixed_t_s = self.t_s
        if self._filter is None:
            return None
        return self._filter.x[:2, 0].copy(), self._filter.P[:2, :2].copy()

    def _predict(self, dt_s: float) -> None:
        dt = torch.tensor([dt_s], dtype=torch.float64)
        noise = process_noise(dt, self.settings)[0].numpy()
        assert self._filter is not None
        self._filter.predict(F=transition(dt, self.settings.turning_s)[0].numpy(), Q=noise)

    def _take(self, measured: NDArray[np.float64], alone: NDArray[np.float64]) -> None:
        """Start at a fix of shape (2, 1) or update with it."""
        if self._filter is None:
            self._start(measured, alone)
            return
        noise = alone * max(
            1.0, self.settings.correlation_s / max(self.t_s - self.fixed_t_s, SHORTEST_STEP_S)
        )
        innovation = measured - self._filter.x[:2]
        distance = (innovation.T @ np.linalg.solve(self._filter.P[:2, :2] + noise, innovation)).item()
        self._filter.update(measured, R=noise * max(1.0, distance / self.settings.gate))

    def _start(self, measured: NDArray[np.float64], alone: NDArray[np.float64]) -> None:
        track = KalmanFilter(dim_x=4, dim_z=2)
        track.H = np.eye(2, 4)
        track.x = np.vstack([measured, np.zeros((2, 1))])
        track.P = np.diag([0.0, 0.0, 1.0, 1.0]) * self.settings.velocity_variance_m2_per_s2
        track.P[:2, :2] = alone
        self._filter = track
