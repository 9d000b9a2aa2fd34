"""A network that says how wrong a range may be: a distribution for each link, not one number.

Axes: n links, F features, S kinds of sight, Q errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

DEGREES_OF_FREEDOM = 4.0
"""Of the Student t on either side of the mode: tails that forgive, and a variance that exists."""
SMALLEST_SCALE_M = 0.1
OUTLIERS = (0.005, 0.905)
"""Least and largest probability of an outlier."""
OUTLIERS_FROM_M, OUTLIER_DENSITY, IMPOSSIBLE_DENSITY = -3.0, 1 / 25, 1 / 250
"""Outliers are alike from -3 m on (per metre); ranges much too short are rarer still."""
LARGEST_FEATURE = 3.0
SMALLEST_DEVIATION = 1e-2
_PEAK = math.gamma((DEGREES_OF_FREEDOM + 1) / 2) / (
    math.sqrt(DEGREES_OF_FREEDOM * math.pi) * math.gamma(DEGREES_OF_FREEDOM / 2)
)


class RangeErrorNetwork(nn.Module):
    """Two hidden layers from a link's features to the parameters of its error.

    The error is range minus distance. Its density is a Student t with a scale on either side of the mode, and
    a broad floor of outliers; the four parameters are mode (bias), both scales and the outliers' probability.
    They are given for every kind of sight at once: which one holds hangs on where somebody is, and features do not.

    Args:
        view: Features that it looks at, as indices of the axis F.
        sights: Kinds of sight that it tells apart; 1 where all are one to it.
        hidden: Width of both hidden layers.
        dropout: Share of the first layer's outputs dropped in training.
    """

    view: Tensor
    means: Tensor
    deviations: Tensor
    shares: Tensor

    def __init__(self, view: Sequence[int], sights: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.sights = sights
        self.register_buffer("view", torch.tensor(view))
        self.register_buffer("means", torch.zeros(len(view)))
        self.register_buffer("deviations", torch.ones(len(view)))
        self.register_buffer("shares", torch.full((sights,), 1 / sights))
        self.layers = nn.Sequential(
            nn.Linear(len(view), hidden),
            nn.SiLU(),
            nn.Dropout(dropout),
            nn.Linear(hidden, hidden),
            nn.SiLU(),
            nn.Linear(hidden, 4 * sights),
        )
        self.double()

    def scale_by(self, features: Tensor, weights: Tensor) -> None:
        """Centre and scale inputs by the mean and standard deviation of features (n, F), weighted by (n,)."""
        seen = features[:, self.view]
        shares = (weights / weights.sum())[:, None]
        self.means = (shares * seen).sum(0)
        variances = (shares * (seen - self.means).square()).sum(0)
        self.deviations = variances.sqrt().clamp(min=SMALLEST_DEVIATION)

    def expect(self, sights: Tensor, weights: Tensor) -> None:
        """Take the share of each kind of sight (n,), weighted by (n,), for what holds where nobody knows."""
        counts = torch.zeros(self.sights, dtype=weights.dtype).index_add(0, self.told_apart(sights), weights)
        self.shares = counts / weights.sum()

    def told_apart(self, sights: Tensor) -> Tensor:
        """Return kinds of sight as this network sees them, shape (n,)."""
        return sights.clamp(max=self.sights - 1)

    def forward(self, features: Tensor) -> Tensor:
        """Return raw parameters, shape (n, S, 4), of links with ``features``, shape (n, F)."""
        scaled = (features[:, self.view] - self.means) / self.deviations
        raw: Tensor = self.layers(scaled.clamp(-LARGEST_FEATURE, LARGEST_FEATURE))
        return raw.unflatten(1, (self.sights, 4))

    def wherever(self, log_densities: Tensor) -> Tensor:
        """Return the logarithm of densities, shape (n, 1, Q), but for a constant, where nobody knows the sight.

        Kinds of sight are mixed as often as they were met in training, evenly by a network that has met one alone.

        Args:
            log_densities: Of each kind of sight, shape (n, S, Q).
        """
        return (log_densities + self.shares.log()[:, None]).logsumexp(1, keepdim=True)


def modes_m(raw: Tensor) -> Tensor:
    """Return the likeliest error, shape (…, 1), metres, under raw parameters (…, 4) of ``RangeErrorNetwork``."""
    return raw[..., :1]


def log_density(raw: Tensor, errors_m: Tensor) -> Tensor:
    """Return the logarithm of the density of errors under raw parameters.

    Args:
        raw: Of ``RangeErrorNetwork``, shape (…, 4).
        errors_m: Range minus distance, shape (…, Q), metres.

    Returns:
        Shape (…, Q), density per metre.
    """
    mode, short, long, outlier = raw[..., None].unbind(-2)
    short, long = (nn.functional.softplus(one) + SMALLEST_SCALE_M for one in (short, long))
    low, high = OUTLIERS
    probability = low + (high - low) * torch.sigmoid(outlier - 2)
    away = errors_m - mode
    squared = (away / torch.where(away < 0, short, long)).square() / DEGREES_OF_FREEDOM
    # A product of roots: five times as fast as the power 5/2.
    root = (1 + squared).rsqrt()
    explained = 2 * _PEAK / (short + long) * (root.square().square() * root)
    floor = torch.where(errors_m > OUTLIERS_FROM_M, OUTLIER_DENSITY, IMPOSSIBLE_DENSITY)
    return ((1 - probability) * explained + probability * floor).log()
