"""Logs of the link between the two devices."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from fploc.raw.tables import numbers, read_table, require_columns

_KIND = "log of the link between devices"
_COLUMNS = {
    "t_ms": re.compile(r"Time Stamp \(ms\)", re.IGNORECASE),
    "range_m": re.compile(r"M1-M2 RTT Distance \(m\)", re.IGNORECASE),
    "std_m": re.compile(r"RTT std \(m\)", re.IGNORECASE),
    "rss_dbm": re.compile(r"RSS \(dBm\)", re.IGNORECASE),
}
_NAMES = ("Time Stamp (ms)", "M1-M2 RTT Distance (m)", "RTT std (m)", "RSS (dBm)")


def read_device_link(path: Path) -> pd.DataFrame:
    """Return ``line``, ``t_ms``, ``range_m``, ``std_m``, ``rss_dbm`` as in the file, one row per range.

    Time is the log's own clock. The columns ``real_distance`` (made from labels) and ``rtt_kalman``
    (filtered) of some files are left out on purpose.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: Naming line or column of what cannot be read.
    """
    table = read_table(path, kind=_KIND)
    found = {
        key: next((name for name in table.columns if pattern.fullmatch(name)), None)
        for key, pattern in _COLUMNS.items()
    }
    for key, name in zip(_COLUMNS, _NAMES, strict=True):
        if found[key] is None:
            require_columns(table, [name], path, kind=_KIND)
    return pd.DataFrame(
        {
            "line": table.index.to_numpy(dtype=np.int64),
            **{key: numbers(table, name, path) for key, name in found.items() if name is not None},
        }
    )
