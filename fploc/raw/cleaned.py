"""Cleaned laps: one wide row per time stamp, four columns per access point, ground truth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from fploc.errors import BadFileError
from fploc.raw.lap import IMU_COLUMNS, Lap
from fploc.raw.tables import Floats, numbers, read_table, require_columns
from fploc.sites.site import Site

_KIND = "cleaned lap"
_AP_COLUMN = re.compile(r"AP\s*(\d+)\s+(True Distance|RTT Distance|RTT std|RSS)\b.*", re.IGNORECASE)
_QUANTITIES = {
    "true distance": "true_distance_m",
    "rtt distance": "range_m",
    "rtt std": "std_m",
    "rss": "rss_dbm",
}
_PUBLIC_NAMES = {
    "true distance": "True Distance (m)",
    "rtt distance": "RTT Distance (m)",
    "rtt std": "RTT std (m)",
    "rss": "RSS (dBm)",
}
_TIME = re.compile(r"(M\d\s+)?Time Stamp \(ms\)", re.IGNORECASE)
_LABEL = re.compile(r"(M\d\s+)?Ground Truth", re.IGNORECASE)
_LABEL_X = re.compile(r"(M\d\s+)?Ground Truth[ _]x", re.IGNORECASE)
_LABEL_Y = re.compile(r"(M\d\s+)?Ground Truth[ _]y", re.IGNORECASE)
_POINT = r"^\s*[\[(]\s*([^,\s]+)\s*,\s*([^,\s\])]+)\s*[\])]\s*$"


def read_cleaned(path: Path, site: Site, *, numbering: str = "auto") -> Lap:
    """Read a cleaned lap. Ranges are in the plan; missing is 0, as in the file.

    Ground truth is one column "[x, y]" or two columns; ``user`` and ``circle`` may follow. Columns of access
    points that are not set up may stand between the others where they hold nothing but 0.

    Args:
        path: The file.
        site: Its access points.
        numbering: ``names``: the columns AP5 belong to the access point of that name. ``compact``: the
            columns APk belong to the k-th of the site. ``auto``: ``names`` where the file has columns for
            every name and all others are empty, else ``compact`` under the same condition.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: Naming line or column of what cannot be read, or an access point the site lacks.
    """
    table = read_table(path, kind=_KIND)
    columns = _ap_columns(table, path)
    values = {
        number: {key: numbers(table, name, path) for key, name in names.items()}
        for number, names in columns.items()
    }
    empty = {
        number for number, of_ap in values.items() if not (of_ap["range_m"].any() or of_ap["rss_dbm"].any())
    }
    macs = _macs(list(columns), empty, site, numbering, path)
    used = list(macs.items())
    rows = len(table)
    readings = pd.DataFrame(
        {
            "set": np.repeat(np.arange(rows), len(used)),
            "mac": np.tile(np.array([mac for _, mac in used], dtype=object), rows),
            **{
                key: np.stack([values[number][key] for number, _ in used], axis=1).ravel()
                for key in _QUANTITIES.values()
            },
        }
    )
    t_ms = numbers(table, _column(table, _TIME, path, "Time Stamp (ms)"), path)
    labels = _labels(table, path)
    lower = {name.lower(): name for name in table.columns}
    sets = pd.DataFrame(
        {
            "line": table.index.to_numpy(),
            "t_ms": t_ms - t_ms[0],
            "x_m": labels[:, 0],
            "y_m": labels[:, 1],
            **{
                key: numbers(table, lower[name], path, nullable=True)
                for key, name in IMU_COLUMNS.items()
                if name in lower
            },
        }
    )
    return Lap(path=path, sets=sets, readings=readings, is_slant=False)


def _ap_columns(table: pd.DataFrame, path: Path) -> dict[int, dict[str, str]]:
    """Return the column names of each AP number: {1: {"range_m": "AP1 RTT Distance (m)", …}, …}."""
    columns: dict[int, dict[str, str]] = {}
    for name in table.columns:
        if match := _AP_COLUMN.fullmatch(name):
            columns.setdefault(int(match[1]), {})[_QUANTITIES[match[2].lower()]] = name
    if not columns:
        require_columns(table, ["AP1 RTT Distance (m)"], path, kind=_KIND)
    for number, names in columns.items():
        for quantity, key in _QUANTITIES.items():
            if key not in names:
                require_columns(table, [f"AP{number} {_PUBLIC_NAMES[quantity]}"], path, kind=_KIND)
    return dict(sorted(columns.items()))


def _macs(columns: list[int], empty: set[int], site: Site, numbering: str, path: Path) -> dict[int, str]:
    """Return the MAC of each AP number of the file; numbers without one have no readings."""
    by_name = {ap.name.upper(): ap.mac for ap in site.access_points}
    candidates = {
        "names": {number: by_name[f"AP{number}"] for number in columns if f"AP{number}" in by_name},
        "compact": dict(zip(range(1, len(site.macs) + 1), site.macs, strict=True)),
    }
    for name, macs in candidates.items():
        complete = len(macs) == len(site.macs) and set(macs) <= set(columns)
        if numbering in (name, "auto") and complete and set(columns) - set(macs) <= empty:
            return macs
    used = ", ".join(f"AP{number}" for number in columns if number not in empty)
    raise BadFileError(
        path,
        "header",
        value=f"columns {', '.join(f'AP{number}' for number in columns)}, with readings in {used or 'none'}",
        expected={
            "names": f"{', '.join(by_name)}",
            "compact": f"AP1 to AP{len(site.macs)}",
            "auto": f"{', '.join(by_name)}, or AP1 to AP{len(site.macs)}",
        }[numbering],
        way_out="check that the file belongs to this site, or correct `numbering` in the site file",
    )


def _column(table: pd.DataFrame, pattern: re.Pattern[str], path: Path, name: str) -> str:
    found = [column for column in table.columns if pattern.fullmatch(column)]
    if not found:
        require_columns(table, [name], path, kind=_KIND)
    return found[0]


def _labels(table: pd.DataFrame, path: Path) -> Floats:
    """Return the ground truth, shape (rows, 2), metres."""
    single = [name for name in table.columns if _LABEL.fullmatch(name)]
    if not single:
        x = numbers(table, _column(table, _LABEL_X, path, "Ground Truth_x"), path)
        y = numbers(table, _column(table, _LABEL_Y, path, "Ground Truth_y"), path)
        return np.stack([x, y], axis=1)
    texts = table[single[0]].astype("string")
    parts = texts.str.extract(_POINT).apply(pd.to_numeric, errors="coerce")
    bad = parts.isna().any(axis=1).to_numpy()
    if bad.any():
        first = int(np.argmax(bad))
        raise BadFileError(
            path,
            f"line {table.index[first]}, column {single[0]}",
            value=repr(table[single[0]].iloc[first]),
            expected='two numbers like "[31.0, 13.75]"',
            way_out="fetch the file again, or correct it",
        )
    positions: Floats = parts.to_numpy(dtype=np.float64)
    return positions
