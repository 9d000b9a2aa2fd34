"""Constant-velocity Kalman filter on position fixes, one for every method.

State [x, y, vx, vy] in metres and metres per second, site frame. Between intervals dt apart the velocity
takes a random walk: Q = q [[dt³/3, dt²/2], [dt²/2, dt]] per axis. The paper gives no parameters; these are
stated in ``KalmanSettings``. An interval without a fix only predicts and stays without a fix: what to show
meanwhile is the reader's choice, and scoring holds the last fix.

``TrackFilter`` follows one device with filterpy; ``BatchedFilter`` is its twin for a batch in torch and equals
it within 1e-9.

Axes: B devices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from torch import Tensor

from fploc.intervals import Estimate, estimate
from fploc.solvers.planar import symmetric_inverse

HEADLINE_SPEED_MPS = 0.5
HEADLINE_NOISE_M2_PER_S3 = 0.3


@dataclass(frozen=True)
class KalmanSettings:
    """Parameters of the filter, the same for every method.

    Args:
        noise_m2_per_s3: Spectral density q of the acceleration.
        speed_sd_mps: Standard deviation of each velocity component at a track's start.
        measurement_variance_m2: Variance of a fix per axis; None takes the fix's own covariance.
        gate: Largest normalised innovation squared, νᵀS⁻¹ν, that updates; 13.8 is passed by 99.9 % of honest
            fixes (χ² with two degrees of freedom).
        rejects_to_restart: After as many rejected fixes in a row the track starts anew at the last of them:
            so many fixes agree with each other more likely than with the track.
    """

    noise_m2_per_s3: float = HEADLINE_NOISE_M2_PER_S3
    speed_sd_mps: float = HEADLINE_SPEED_MPS
    measurement_variance_m2: float | None = 1.0
    gate: float = 13.8
    rejects_to_restart: int = 5

    @classmethod
    def for_speed(cls, speed_prior_mps: float) -> KalmanSettings:
        """Return the settings for people who walk at about ``speed_prior_mps``.

        The prior is the start's standard deviation of the velocity, and q grows with its square from 0.3 m²/s³
        at 0.5 m/s, so that the velocity changes by its own size in the same time.
        """
        return cls(
            noise_m2_per_s3=HEADLINE_NOISE_M2_PER_S3 * (speed_prior_mps / HEADLINE_SPEED_MPS) ** 2,
            speed_sd_mps=speed_prior_mps,
        )


# Made once: the filter is stepped thousands of times, and small tensors cost more to make than to use.
_IDENTITY = torch.eye(4, dtype=torch.float64)
_VELOCITY_TO_POSITION = torch.diag(torch.ones(2, dtype=torch.float64), 2)
_NOISE_BLOCKS = torch.stack(
    [
        torch.diag(torch.tensor([1 / 3, 1 / 3, 0.0, 0.0], dtype=torch.float64)),
        (_VELOCITY_TO_POSITION + _VELOCITY_TO_POSITION.T) / 2,
        torch.diag(torch.tensor([0.0, 0.0, 1.0, 1.0], dtype=torch.float64)),
    ]
)
"""What dt³, dt² and dt multiply in Q/q, shape (3, 4, 4)."""


def transition(dt_s: Tensor) -> Tensor:
    """Return F, shape (B, 4, 4), for time steps of shape (B,), seconds, float64."""
    moved = _VELOCITY_TO_POSITION.to(dt_s.device)
    return _IDENTITY.to(dt_s.device) + dt_s[:, None, None] * moved


def process_noise(dt_s: Tensor, noise_m2_per_s3: float) -> Tensor:
    """Return Q, shape (B, 4, 4), for time steps of shape (B,), seconds, float64."""
    powers = torch.stack([dt_s**3, dt_s**2, dt_s], -1) * noise_m2_per_s3
    blocks = _NOISE_BLOCKS.to(dt_s.device).reshape(3, 16)
    return (powers @ blocks).reshape(-1, 4, 4)


@dataclass(frozen=True)
class KalmanState:
    """Tracks of a batch of devices.

    Args:
        means: Shape (B, 4), metres and metres per second, site frame.
        covariances: Shape (B, 4, 4).
        t_s: Time of each track, shape (B,), seconds.
        started: True once a device had a fix, shape (B,).
        rejects: Rejected fixes in a row, shape (B,), int64.
    """

    means: Tensor
    covariances: Tensor
    t_s: Tensor
    started: Tensor
    rejects: Tensor


class BatchedFilter:
    """The filter over a batch of devices, float64, no loop over them."""

    def __init__(self, settings: KalmanSettings) -> None:
        self.settings = settings
        self._first_speed_covariance = settings.speed_sd_mps**2 * _NOISE_BLOCKS[2]

    def init(self, devices: int, *, device: torch.device | str = "cpu") -> KalmanState:
        """Return the state of ``devices`` tracks before their first fix."""
        return KalmanState(
            means=torch.zeros(devices, 4, dtype=torch.float64, device=device),
            covariances=torch.eye(4, dtype=torch.float64, device=device).repeat(devices, 1, 1),
            t_s=torch.zeros(devices, dtype=torch.float64, device=device),
            started=torch.zeros(devices, dtype=torch.bool, device=device),
            rejects=torch.zeros(devices, dtype=torch.int64, device=device),
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
            The new state and the filtered estimate. Its reasons are those of ``fixes``: a rejected fix
            counts as a fix, at the predicted position.
        """
        dt = (t_s.double() - state.t_s).clamp(min=0.0)
        flow = transition(dt)
        means = (flow @ state.means[..., None])[..., 0]
        covariances = flow @ state.covariances @ flow.mT + process_noise(dt, self.settings.noise_m2_per_s3)

        fixed = fixes.fixed & present
        measured = torch.where(fixed[:, None], fixes.positions.double(), 0.0)
        noise = self._measurement_noise(fixes, fixed)
        innovation = measured - means[:, :2]
        spread_inverse = symmetric_inverse(covariances[:, :2, :2] + noise)
        distance = (innovation[:, None, :] @ spread_inverse @ innovation[..., None])[:, 0, 0]
        passes = distance <= self.settings.gate
        rejects = torch.where(passes, 0, state.rejects + 1)
        starts = fixed & (~state.started | (rejects >= self.settings.rejects_to_restart))
        updates = fixed & ~starts & passes

        gain = covariances[:, :, :2] @ spread_inverse
        kept = _IDENTITY.to(gain.device) - torch.nn.functional.pad(gain, (0, 2))
        updated_means = means + (gain @ innovation[..., None])[..., 0]
        updated_covariances = kept @ covariances @ kept.mT + gain @ noise @ gain.mT

        first_means = torch.nn.functional.pad(measured, (0, 2))
        first_covariances = torch.nn.functional.pad(noise, (0, 2, 0, 2))
        first_covariances = first_covariances + self._first_speed_covariance.to(noise.device)

        means = _choose(starts, first_means, _choose(updates, updated_means, means))
        covariances = _choose(starts, first_covariances, _choose(updates, updated_covariances, covariances))
        advances = present & (state.started | starts)
        new = KalmanState(
            means=_choose(advances, means, state.means),
            covariances=_choose(advances, covariances, state.covariances),
            t_s=torch.where(advances, torch.maximum(t_s.double(), state.t_s), state.t_s),
            started=state.started | starts,
            rejects=torch.where(starts, 0, torch.where(fixed, rejects, state.rejects)),
        )
        return new, estimate(new.means[:, :2], new.covariances[:, :2, :2], fixes.reasons)

    def _measurement_noise(self, fixes: Estimate, fixed: Tensor) -> Tensor:
        """Return R, shape (B, 2, 2), square metres."""
        variance = self.settings.measurement_variance_m2
        identity = _IDENTITY[:2, :2].to(fixed.device)
        if variance is None:
            return torch.where(fixed[:, None, None], fixes.covariances.double(), identity)
        return (variance * identity).expand(len(fixed), 2, 2)


def _choose(where: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """Return ``one`` where the device is chosen, shape (B,), else ``other``, shapes (B, …)."""
    return torch.where(where.reshape(-1, *[1] * (one.dim() - 1)), one, other)


class TrackFilter:
    """The filter of one device, by filterpy: the reference that ``BatchedFilter`` is held to."""

    def __init__(self, settings: KalmanSettings) -> None:
        self.settings = settings
        self.rejects = 0
        self.t_s = 0.0
        self._filter: KalmanFilter | None = None

    def step(
        self, t_s: float, position_m: NDArray[np.float64] | None, covariance_m2: NDArray[np.float64] | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Advance by one interval.

        Args:
            t_s: Time of the interval, seconds.
            position_m: The fix, shape (2,), metres, site frame, or None.
            covariance_m2: Its covariance, shape (2, 2); used where the settings ask for it.

        Returns:
            Position (2,) and covariance (2, 2) after the interval; None before the first fix.
        """
        if self._filter is not None:
            self._predict(max(0.0, t_s - self.t_s))
        self.t_s = max(self.t_s, t_s)
        if position_m is not None:
            self._take(np.asarray(position_m, dtype=np.float64).reshape(2, 1), self._noise(covariance_m2))
        if self._filter is None:
            return None
        return self._filter.x[:2, 0].copy(), self._filter.P[:2, :2].copy()

    def _predict(self, dt_s: float) -> None:
        dt = torch.tensor([dt_s], dtype=torch.float64)
        noise = process_noise(dt, self.settings.noise_m2_per_s3)[0].numpy()
        assert self._filter is not None
        self._filter.predict(F=transition(dt)[0].numpy(), Q=noise)

    def _take(self, measured: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
        """Update with a fix of shape (2, 1), reject it, or start anew at it."""
        if self._filter is None:
            self._start(measured, noise)
            return
        innovation = measured - self._filter.x[:2]
        spread = self._filter.P[:2, :2] + noise
        if (innovation.T @ np.linalg.solve(spread, innovation)).item() <= self.settings.gate:
            self.rejects = 0
            self._filter.update(measured, R=noise)
            return
        self.rejects += 1
        if self.rejects >= self.settings.rejects_to_restart:
            self._start(measured, noise)

    def _start(self, measured: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
        track = KalmanFilter(dim_x=4, dim_z=2)
        track.H = np.eye(2, 4)
        track.x = np.vstack([measured, np.zeros((2, 1))])
        track.P = np.diag([0.0, 0.0, 1.0, 1.0]) * self.settings.speed_sd_mps**2
        track.P[:2, :2] = noise
        self.rejects = 0
        self._filter = track

    def _noise(self, covariance_m2: NDArray[np.float64] | None) -> NDArray[np.float64]:
        variance = self.settings.measurement_variance_m2
        if variance is not None:
            return variance * np.eye(2)
        assert covariance_m2 is not None, "settings without a measurement variance need the fix's own"
        return covariance_m2
