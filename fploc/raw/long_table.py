"""Long tables: one row per AP reading, with labels, without time stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from fploc.errors import BadFileError
from fploc.raw.tables import numbers, read_table, require_columns

_KIND = "long table"
_COLUMNS = {
    "real_dis": "true_distance_m",
    "RTT": "range_m",
    "RTT std": "std_m",
    "RSS": "rss_dbm",
    "AP_idx": "ap_number",
    "class_idx": "epoch",
    "AP_x": "ap_x_m",
    "AP_y": "ap_y_m",
    "circle": "lap",
    "user": "device",
    "true_x": "x_m",
    "true_y": "y_m",
}
_WHOLE = ("ap_number", "epoch", "lap", "device")


def read_long_table(path: Path) -> pd.DataFrame:
    """Return the readings of a long table in file order.

    Columns: ``true_distance_m``, ``range_m`` (in the plan), ``std_m``, ``rss_dbm``, ``ap_number``, ``epoch``
    (the public ``class_idx``), ``ap_x_m``, ``ap_y_m``, ``lap`` (``circle``), ``device`` (``user``), ``x_m``,
    ``y_m``. There is no time, so no filter can run on it. Six-AP sites number their access points 1 to 6.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: Naming line or column of what cannot be read.
    """
    table = read_table(path, kind=_KIND)
    require_columns(table, list(_COLUMNS), path, kind=_KIND)
    rows = pd.DataFrame({key: numbers(table, name, path) for name, key in _COLUMNS.items()})
    for key in _WHOLE:
        broken = (rows[key] % 1 != 0).to_numpy()
        if broken.any():
            first = int(np.argmax(broken))
            name = next(public for public, ours in _COLUMNS.items() if ours == key)
            raise BadFileError(
                path,
                f"line {table.index[first]}, column {name}",
                value=rows[key].iloc[first],
                expected="a whole number",
                way_out="fetch the file again, or correct it",
            )
    return rows.astype(dict.fromkeys(_WHOLE, "int64"))
