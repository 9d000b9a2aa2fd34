"""One recording on its way from the rows of its file to the rows of the packed tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fploc.datasets.manifest import LinkCounts, RecordingCounts
from fploc.datasets.published import join_published
from fploc.errors import BadFileError, FplocError
from fploc.plausible import NEVER_HEARD_FROM_M, has_rss
from fploc.raw.cleaned import read_cleaned
from fploc.raw.device_link import read_device_link
from fploc.raw.lap import IMU_COLUMNS, Lap
from fploc.raw.phone_log import read_duration_ms, read_phone_log
from fploc.repair.clocks import in_order, is_row_grid, rescale
from fploc.repair.labels import Labels, repair_labels
from fploc.repair.readings import drop_repeats, keep_sets, mend_readings
from fploc.schema import DEVICE_LINKS, INTERVALS, READINGS, Table
from fploc.sites.registry import LinkSpec, RecordingSpec, SiteSpec

Floats = NDArray[np.float64]

_MS_PER_S = 1e3
# Published true distances farther than this (median) from those to the label are wrong; where they come this
# close to another access point, they are of that one.
_OTHER_AP_M = 1.0
_SAME_AP_M = 0.3


@dataclass(frozen=True, eq=False)
class LapRows:
    """Rows of one recording for the packed tables, and their counts."""

    readings: pd.DataFrame
    intervals: pd.DataFrame
    counts: RecordingCounts


def lap_rows(
    spec: SiteSpec, recording: RecordingSpec, *, main: Path, raw: Path | None, long_table: pd.DataFrame | None
) -> LapRows:
    """Read and mend one recording.

    Order: rescale a row grid's clock; repair labels on all rows in file order; drop rows outside the lap,
    repeated sets and rows whose time steps back; project ranges; turn 0 to null and drop outliers.

    Args:
        spec: The site file.
        recording: Its entry for this recording.
        main: The cleaned lap, or the raw log where there is none.
        raw: The raw log, where it is present.
        long_table: Published labels of a site without cleaned laps, where present.

    Raises:
        BadFileError: If a file cannot be read, or its AP columns contradict its true distances.
        FplocError: If a repair cannot be applied.
    """
    from_cleaned = recording.cleaned is not None
    lap = (
        read_cleaned(main, spec.site, numbering=spec.numbering)
        if from_cleaned
        else read_phone_log(main, spec.site)
    )
    heard_in_file = int(((lap.readings["range_m"] != 0) | (lap.readings["rss_dbm"] != 0)).sum())
    rows_in_file = len(lap.sets)
    true_distance = _check_true_distances(lap, spec) if from_cleaned else {}
    lap, clock = _rescaled(lap, raw)
    if not from_cleaned and long_table is not None:
        lap = join_published(lap, long_table, spec.site, recording.lap)
    lap, kept_of_lap, label_note = _labelled(lap, spec, recording)

    dropped_sets: dict[str, int] = {}
    dropped_readings: dict[str, int] = {}
    lap = _dropped(lap, kept_of_lap, "outside_lap", dropped_sets, dropped_readings)
    lap, repeats = drop_repeats(lap)
    dropped_sets |= {"repeated": repeats["repeated_sets"]}
    dropped_readings |= {"in_repeated_set": repeats["repeated_readings"]}
    lap = _dropped(
        lap, in_order(lap.sets["t_ms"].to_numpy()), "time_stepped_back", dropped_sets, dropped_readings
    )

    readings, mended = mend_readings(_projected(lap, spec))
    dropped_readings |= {"range_from_100m": mended.pop("range_from_100m")}
    masked = mended | {"empty_sets_dropped_as_repeated": repeats["repeated_empty_sets"]}
    intervals = _interval_table(lap, recording)
    number = pd.Series(intervals["interval"].to_numpy(), index=lap.sets.index)
    time = pd.Series(intervals["t_ms"].to_numpy(), index=lap.sets.index)
    readings = readings.assign(
        device=recording.device,
        recording=recording.name,
        interval=readings["set"].map(number),
        t_ms=readings["set"].map(time),
    )
    counts = RecordingCounts(
        device=recording.device,
        recording=recording.name,
        rows=rows_in_file,
        readings_in_file=heard_in_file,
        intervals=len(intervals),
        readings_kept=len(readings),
        dropped_sets=dropped_sets,
        dropped_readings=dropped_readings,
        masked=masked,
        clock=clock,
        labels=label_note,
        true_distance_m=true_distance,
    )
    return LapRows(readings=as_table(readings, READINGS), intervals=intervals, counts=counts)


def link_rows(link: LinkSpec, path: Path) -> tuple[pd.DataFrame, LinkCounts]:
    """Read and mend one log of the link between the devices.

    Raises:
        BadFileError: If it cannot be read.
    """
    log = read_device_link(path)
    range_m, rss = log["range_m"].to_numpy(), log["rss_dbm"].to_numpy()
    far = range_m >= NEVER_HEARD_FROM_M
    back = ~in_order(log["t_ms"].to_numpy()) | (np.diff(log["t_ms"], prepend=-np.inf) == 0)
    kept = ~far & ~back
    rows = pd.DataFrame(
        {
            "lap": link.lap,
            "t_ms": log["t_ms"],
            "range_m": np.where(range_m > 0, range_m, np.nan),
            "range_std_m": np.where(range_m > 0, log["std_m"], np.nan),
            "rss_dbm": np.where(has_rss(rss), rss, np.nan),
        }
    )[kept]
    counts = LinkCounts(
        lap=link.lap,
        rows=len(log),
        kept=len(rows),
        dropped={"range_from_100m": int(far.sum()), "time_stepped_back": int((back & ~far).sum())},
        masked={"range_not_positive": int((kept & (range_m <= 0)).sum())},
        clock=link.clock,
    )
    return as_table(rows, DEVICE_LINKS), counts


def as_table(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Return the columns of ``table`` in order, with its types, rows numbered anew."""
    dtypes = {column.name: column.dtype for column in table.columns}
    return frame[list(dtypes)].astype(dtypes).reset_index(drop=True)


def _rescaled(lap: Lap, raw: Path | None) -> tuple[Lap, str]:
    t_ms = lap.sets["t_ms"].to_numpy()
    if lap.is_slant or not is_row_grid(t_ms):
        return lap, "as in the file"
    if raw is None:
        return lap, "rows of 200 ms; no raw log to rescale them by"
    duration_ms = read_duration_ms(raw)
    if duration_ms is None:
        return lap, "rows of 200 ms; the raw log's time is too coarse to rescale them by"
    rescaled = replace(lap, sets=lap.sets.assign(t_ms=rescale(t_ms, duration_ms)))
    return (
        rescaled,
        f"rows of 200 ms, rescaled by {duration_ms / (t_ms[-1] - t_ms[0]):.5f} to the raw log's duration",
    )


def _labelled(lap: Lap, spec: SiteSpec, recording: RecordingSpec) -> tuple[Lap, NDArray[np.bool_], str]:
    """Add ``x_repaired_m`` and ``y_repaired_m`` to the sets; return also which sets belong to the lap."""
    published = lap.sets[["x_m", "y_m"]].to_numpy()
    labels = Labels(
        recording=recording.name,
        t_s=lap.sets["t_ms"].to_numpy() / _MS_PER_S,
        positions_m=published,
        keep=np.ones(len(lap.sets), dtype=bool),
    )
    for name in recording.repairs:
        try:
            labels = repair_labels(labels, spec.repairs[name])
        except FplocError as error:
            raise BadFileError(
                spec.path,
                f"key repairs.{name}",
                value=error.value,
                expected=f"{error.thing}: {error.expected}",
                way_out=error.way_out,
            ) from error
    note = "no published labels" if np.isnan(published).all() else "published"
    note += f"; repaired by {', '.join(recording.repairs)}" if recording.repairs else "; repaired = published"
    sets = lap.sets.assign(x_repaired_m=labels.positions_m[:, 0], y_repaired_m=labels.positions_m[:, 1])
    return replace(lap, sets=sets), labels.keep, note


def _dropped(
    lap: Lap,
    keep: NDArray[np.bool_],
    reason: str,
    dropped_sets: dict[str, int],
    dropped_readings: dict[str, int],
) -> Lap:
    """Return the lap without the sets where ``keep`` is False, and count them under ``reason``."""
    gone = lap.readings["set"].isin(lap.sets.index[~keep])
    heard = (lap.readings["range_m"] != 0) | (lap.readings["rss_dbm"] != 0)
    dropped_sets[reason] = int((~keep).sum())
    dropped_readings[f"in_set_{reason}"] = int((gone & heard).sum())
    return keep_sets(lap, keep)


def _projected(lap: Lap, spec: SiteSpec) -> pd.DataFrame:
    """Return the readings with slant and plan ranges: slant² = plan² + h²."""
    heights = dict(zip(spec.site.macs, spec.site.height_differences_m, strict=True))
    h = lap.readings["mac"].map(heights).to_numpy(dtype=np.float64)
    given = lap.readings["range_m"].to_numpy()
    if lap.is_slant:
        slant, plan = given, np.sqrt(np.maximum(given**2 - h**2, 0.0))
    else:
        slant, plan = np.where(given > 0, np.sqrt(given**2 + h**2), given), given
    return lap.readings.assign(range_slant_m=slant, range_plan_m=plan).rename(
        columns={"std_m": "range_std_m"}
    )


def _interval_table(lap: Lap, recording: RecordingSpec) -> pd.DataFrame:
    t_ms = lap.sets["t_ms"].to_numpy()
    columns = {"x_m": "x_published_m", "y_m": "y_published_m"}
    frame = lap.sets.rename(columns=columns).assign(
        device=recording.device,
        recording=recording.name,
        interval=np.arange(len(t_ms)),
        t_ms=t_ms - t_ms[0] if len(t_ms) else t_ms,
    )
    absent = {name: np.nan for name in IMU_COLUMNS if name not in frame.columns}
    return as_table(frame.assign(**absent), INTERVALS)


def _check_true_distances(lap: Lap, spec: SiteSpec) -> dict[str, float]:
    """Return by AP how far the published true distance is from the one to the label (median).

    A check of the file, not of the measurements: columns that belong to another access point show here.

    Raises:
        BadFileError: If the true distances of an access point are those to another one.
    """
    site = spec.site
    names = [ap.name for ap in site.access_points]
    rows = lap.readings[lap.readings["true_distance_m"] > 0]
    labels = lap.sets.loc[rows["set"], ["x_m", "y_m"]].to_numpy()
    distances = np.linalg.norm(labels[:, None] - site.positions_m, axis=2)
    off = pd.DataFrame(np.abs(distances - rows[["true_distance_m"]].to_numpy()), columns=names)
    medians = off.groupby(rows["mac"].map(dict(zip(site.macs, names, strict=True))).to_numpy()).median()
    own = pd.Series({name: medians.loc[name, name] for name in medians.index}, dtype=np.float64)
    suspects = medians[own > _OTHER_AP_M].drop(list(spec.true_distance_faults), errors="ignore")
    others = suspects[suspects.min(axis=1) < _SAME_AP_M].idxmin(axis=1)
    if len(others):
        name, other = str(others.index[0]), str(others.iloc[0])
        raise BadFileError(
            lap.path,
            f"column True Distance of {name}",
            value=f"distances to {other} (to {name} they are {own[name]:.1f} m off)",
            expected=f"distances to {name} of {site.name}",
            way_out="check `numbering` and the coordinates in the site file",
        )
    return {str(name): round(float(value), 4) for name, value in own.items()}
