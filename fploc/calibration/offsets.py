"""Range offsets: what the phones and access points add to every range, estimated on a source site.

The estimators are those of design §6. An offset is fitted on recordings of the source only, after the split;
a target recording can never reach ``fit_offsets``, which takes the source's recordings and nothing else.

Axes: T intervals, A access points.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fploc.datasets.recordings import Recording
from fploc.errors import BadFileError, FplocError, MissingFileError
from fploc.files import whole
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.walls import line_of_sight
from fploc.sites.site import Site

Floats = NDArray[np.float64]

NONE, SOURCE_LOS, SOURCE_MEDIAN, SOURCE_MAC = "none", "source-los", "source-median", "source-mac"
ESTIMATORS = (NONE, SOURCE_LOS, SOURCE_MEDIAN, SOURCE_MAC)
LABELS = "repaired"
FEWEST_READINGS_PER_MAC = 30
"""An access point with fewer line-of-sight readings takes the offset of all together (``source-mac``)."""


@dataclass(frozen=True)
class RangeOffsets:
    """Offsets to subtract from slant ranges.

    Args:
        estimator: One of ``ESTIMATORS``, or the number of metres as it was given.
        offset_m: Offset of every access point that ``by_mac_m`` does not name, metres.
        by_mac_m: Offset of single access points by MAC, metres.
        recordings: What it was fitted on, as ``site/device/recording``; empty where nothing was fitted.
    """

    estimator: str
    offset_m: float
    by_mac_m: Mapping[str, float] = field(default_factory=dict)
    recordings: tuple[str, ...] = ()

    def per_access_point_m(self, macs: Sequence[str]) -> Floats:
        """Return the offset of each access point, shape (A,), metres."""
        return np.array([self.by_mac_m.get(mac, self.offset_m) for mac in macs], dtype=np.float64)

    def apply(self, slant_m: Floats, macs: Sequence[str]) -> Floats:
        """Return slant ranges without their offset, never below 0.

        Args:
            slant_m: Shape (…, A), metres; 0 where not heard.
            macs: Of the axis A.

        Returns:
            Shape (…, A), metres.
        """
        calibrated: Floats = np.maximum(0.0, slant_m - self.per_access_point_m(macs))
        return calibrated

    def save(self, path: Path) -> None:
        """Write the offsets as JSON, in one move."""
        with whole(path) as part:
            part.write_text(json.dumps({"unit": "m", **asdict(self)}, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> RangeOffsets:
        """Read what ``save`` wrote.

        Raises:
            MissingFileError: If there is no such file.
            BadFileError: If it does not hold offsets in metres.
        """
        if not path.is_file():
            raise MissingFileError(path, expected="range offsets", way_out="fit them anew")
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            if stored["unit"] != "m":
                raise ValueError(f"unit {stored['unit']!r}")
            return cls(
                estimator=str(stored["estimator"]),
                offset_m=_finite(stored["offset_m"]),
                by_mac_m={str(mac): _finite(value) for mac, value in stored["by_mac_m"].items()},
                recordings=tuple(str(name) for name in stored["recordings"]),
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise BadFileError(
                path,
                "whole file",
                value=f"{type(error).__name__} {error}",
                expected="JSON with unit m, estimator, offset_m, by_mac_m and recordings",
                way_out="delete it and fit the offsets anew",
            ) from error


@dataclass(frozen=True)
class SourceRecordings:
    """Recordings of one source site, to learn from.

    Args:
        recordings: The recordings.
        site: The site.
        plan: Its floor plan; only estimators that look for walls need it.
    """

    recordings: Sequence[Recording]
    site: Site
    plan: FloorPlan | None


def constant_offset(text: str) -> float | None:
    """Return the metres that a calibration gives as a number, 0 for ``none``, and None for an estimator.

    Args:
        text: The option's text: one of ``ESTIMATORS``, or a number of metres.

    Raises:
        FplocError: If it is neither.
    """
    if text == NONE:
        return 0.0
    if text in ESTIMATORS:
        return None
    try:
        return _finite(text)
    except ValueError as error:
        raise FplocError(
            "--calibration",
            value=repr(text),
            expected=f"one of {', '.join(ESTIMATORS)}, or a finite number of metres",
            way_out="write for example `--calibration source-los` or `--calibration 1.0`",
        ) from error


def fit_offsets(
    estimator: str, recordings: Sequence[Recording], site: Site, plan: FloorPlan | None
) -> RangeOffsets:
    """Fit range offsets on one source site; see ``fit_pooled_offsets``."""
    return fit_pooled_offsets(estimator, [SourceRecordings(recordings, site, plan)])


def fit_pooled_offsets(estimator: str, sources: Sequence[SourceRecordings]) -> RangeOffsets:
    """Fit range offsets on source sites, their readings together.

    The error of a reading is its slant range minus the slant distance from the repaired label. The offset is
    the median error over the readings whose straight line crosses no wall (``source-los``), over all readings
    (``source-median``), or the first for each access point (``source-mac``).

    Args:
        estimator: One of ``ESTIMATORS``, or a number of metres, for which nothing is fitted.
        sources: What to learn from.

    Raises:
        FplocError: If the estimator is unknown, the plan it needs is missing, or no reading can be used.
    """
    constant = constant_offset(estimator)
    if constant is not None:
        return RangeOffsets(estimator, constant)
    parts = [_usable_errors(estimator, one) for one in sources]
    errors_m = np.concatenate([errors for errors, _ in parts])
    if errors_m.size == 0:
        raise FplocError(
            f"readings of {', '.join(one.site.name for one in sources)} for --calibration {estimator}",
            value="none",
            expected="ranges with a label, and for line of sight a link that crosses no wall",
            way_out="check the recordings and the plan with `fploc data describe`",
        )
    macs = np.concatenate([macs for _, macs in parts])
    return RangeOffsets(
        estimator=estimator,
        offset_m=float(np.median(errors_m)),
        by_mac_m=_medians_by_mac(errors_m, macs) if estimator == SOURCE_MAC else {},
        recordings=tuple(one.key for source in sources for one in source.recordings),
    )


def _usable_errors(estimator: str, source: SourceRecordings) -> tuple[Floats, NDArray[np.str_]]:
    """Return error (L,) in metres and MAC (L,) of every reading that an estimator looks at."""
    errors_m, columns, positions_m = _range_errors(source.recordings, source.site)
    if estimator != SOURCE_MEDIAN:
        clear = _crosses_no_wall(estimator, source.plan, source.site, positions_m, columns)
        errors_m, columns = errors_m[clear], columns[clear]
    return errors_m, np.array(source.site.macs)[columns]


def _range_errors(recordings: Sequence[Recording], site: Site) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return error (L,), column of A (L,) and position (L, 2) of every reading with a range and a label."""
    positions = np.concatenate([one.labels_m(LABELS) for one in recordings])
    slant = np.concatenate([one.slant_m for one in recordings])
    heard = np.concatenate([one.heard for one in recordings])
    rows, columns = np.nonzero(heard & np.isfinite(positions).all(axis=1)[:, None])
    across = np.linalg.norm(positions[rows] - site.positions_m[columns], axis=1)
    true_slant = np.hypot(across, site.height_differences_m[columns])
    return slant[rows, columns] - true_slant, columns, positions[rows]


def _crosses_no_wall(
    estimator: str, plan: FloorPlan | None, site: Site, positions_m: Floats, columns: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return where the straight line from the access point to the device crosses no wall, shape (L,)."""
    if plan is None:
        raise FplocError(
            f"floor plan of {site.name}",
            value="none",
            expected=f"a plan with walls, which --calibration {estimator} looks for",
            way_out="build the site with its plan, or choose `--calibration source-median`",
        )
    return line_of_sight(plan, site.positions_m[columns], positions_m)


def _medians_by_mac(errors_m: Floats, macs: NDArray[np.str_]) -> dict[str, float]:
    """Return the median error of each access point with enough readings, metres."""
    order = np.argsort(macs, kind="stable")
    present, starts, counts = np.unique(macs[order], return_index=True, return_counts=True)
    groups = np.split(errors_m[order], starts[1:])
    return {
        str(mac): float(np.median(group))
        for mac, group, count in zip(present, groups, counts, strict=True)
        if count >= FEWEST_READINGS_PER_MAC
    }


def _finite(value: object) -> float:
    number = float(str(value))
    if not math.isfinite(number):
        raise ValueError(f"{value} is not finite")
    return number
