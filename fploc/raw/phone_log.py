"""Raw phone logs: one row per inertial sample, the last reading set repeated on each until the next."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from fploc.errors import BadFileError, UnknownNameError
from fploc.raw.lap import IMU_COLUMNS, Lap
from fploc.raw.tables import Floats, numbers, read_table, require_columns
from fploc.sites.site import Site

_KIND = "raw phone log"
_NUMBER = r"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?"
_READING = (
    rf"([0-9a-fA-F]{{2}}(?::[0-9a-fA-F]{{2}}){{5}})\s*,\s*({_NUMBER})\s*,\s*({_NUMBER})\s*,\s*({_NUMBER})"
)
_BARE = _READING.replace("([0", "(?:[0").replace(f"({_NUMBER})", _NUMBER)
_RESULT = re.compile(rf"\s*(?:{_BARE}(?:\s*,\s*{_BARE})*)?\s*")
# The office logs of 2022 wrap the list in a second one: ['[b0:e4:…, -45]'].
_WRAPPING = "[]'\" "
_NS_PER_MS = 1e6
_MM_PER_M = 1e3


def read_phone_log(path: Path, site: Site) -> Lap:
    """Read a raw phone log. Ranges are in space; a range may be negative, as the phone gave it.

    Rows of one reading set (same RTT_TIMESTAMP and RTT_RESULT, one after the other) become one; the first
    gives the inertial sample. Time is that of RTT_TIMESTAMP (nanoseconds); some files round it, then several
    sets share a time. Two columns of numbers after ``Points`` are ground truth.

    Args:
        path: The file.
        site: Its access points.

    Raises:
        MissingFileError: If there is no such file.
        UnknownNameError: If a reading is of a MAC that the site does not have.
        BadFileError: Naming line and column of what cannot be read.
    """
    table = read_table(path, kind=_KIND)
    require_columns(table, ["RTT_TIMESTAMP", "RTT_RESULT"], path, kind=_KIND)
    time_ns = numbers(table, "RTT_TIMESTAMP", path)
    lower = {name.lower(): name for name in table.columns}
    require_columns(table.rename(columns=str.lower), list(IMU_COLUMNS.values()), path, kind=_KIND)
    results = table["RTT_RESULT"].astype("string").fillna("")
    texts = results.to_numpy(dtype=object)
    changes = np.r_[True, (texts[1:] != texts[:-1]) | (np.diff(time_ns) != 0)]
    chosen = np.flatnonzero(changes)
    labels = _labels(table, path)[chosen]
    sets = pd.DataFrame(
        {
            "line": table.index.to_numpy()[chosen],
            "t_ms": (time_ns[chosen] - time_ns[0]) / _NS_PER_MS,
            "x_m": labels[:, 0],
            "y_m": labels[:, 1],
            **{
                key: numbers(table, lower[name], path, nullable=True)[chosen]
                for key, name in IMU_COLUMNS.items()
            },
        }
    )
    readings = _readings(results.iloc[chosen], path)
    _check_macs(readings, sets, site, path)
    return Lap(path=path, sets=sets, readings=readings, is_slant=True)


def read_duration_ms(path: Path) -> float | None:
    """Return how long a phone log lasts, from the first of its rows to the last, milliseconds.

    Measured on IMU_TIMESTAMP, which advances on every row. Some files round it to as little as 100 s: the
    duration is then taken from the rows where the rounded value changes, which lie whole steps apart, at the
    even pace of the rows between them. None where the time changes less than twice: it cannot be told.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If the time cannot be read.
    """
    table = read_table(path, kind=_KIND)
    require_columns(table, ["IMU_TIMESTAMP"], path, kind=_KIND)
    time_ns = numbers(table, "IMU_TIMESTAMP", path)
    changed = np.flatnonzero(np.diff(time_ns) != 0) + 1
    if len(changed) < 2:
        return None
    first, last = int(changed[0]), int(changed[-1])
    per_row_ms = (time_ns[last] - time_ns[first]) / (last - first) / _NS_PER_MS
    return float(per_row_ms * (len(table) - 1))


def _readings(results: pd.Series, path: Path) -> pd.DataFrame:
    """Return one row per access point of each RTT_RESULT; the index of ``results`` is lines of the file."""
    texts = results.str.strip(_WRAPPING)
    wrong = ~texts.str.fullmatch(_RESULT).to_numpy(dtype=bool)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise BadFileError(
            path,
            f"line {results.index[first]}, column RTT_RESULT",
            value=repr(str(results.iloc[first])[:80]),
            expected='readings like "[b0:e4:d5:39:26:89, 1270, 56, -45, …]" (MAC, mm, mm, dBm)',
            way_out="fetch the file again, or correct it",
        )
    counts = (texts.str.count(":") // 5).to_numpy(dtype=np.int64)
    cells = pd.DataFrame(re.findall(_READING, "\n".join(texts)), columns=["mac", "mm", "std_mm", "rss"])
    assert len(cells) == counts.sum(), "every reading of a checked text is found"
    return pd.DataFrame(
        {
            "set": np.repeat(np.arange(len(texts)), counts),
            "mac": cells["mac"].str.lower().astype(object),
            "range_m": cells["mm"].astype(np.float64) / _MM_PER_M,
            "std_m": cells["std_mm"].astype(np.float64) / _MM_PER_M,
            "rss_dbm": cells["rss"].astype(np.float64),
        }
    )


def _check_macs(readings: pd.DataFrame, sets: pd.DataFrame, site: Site, path: Path) -> None:
    unknown = ~readings["mac"].isin(site.macs).to_numpy()
    if unknown.any():
        first = readings.iloc[int(np.argmax(unknown))]
        line = sets["line"].iloc[int(first["set"])]
        raise UnknownNameError(
            f"{path}, line {line}, MAC in RTT_RESULT",
            first["mac"],
            known=list(site.macs),
            way_out="add that access point to the site file, or check that the log belongs to this site",
        )


def _labels(table: pd.DataFrame, path: Path) -> Floats:
    """Return the ground truth after the column ``Points``, shape (rows, 2), metres; NaN where there is none."""
    none = np.full((len(table), 2), np.nan)
    columns = list(table.columns)
    if "Points" not in columns:
        return none
    names = columns[columns.index("Points") + 1 :][:2]
    if len(names) < 2 or table[names].isna().all(axis=None):
        return none
    return np.stack([numbers(table, name, path) for name in names], axis=1)
