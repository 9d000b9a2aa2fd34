"""Reading CSV files as tables of checked columns: what every parser here shares."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fploc.errors import BadFileError, MissingFileError

Floats = NDArray[np.float64]

_FETCH_AGAIN = "fetch the file again, or correct it"
# Line 1 of a file is its header.
_FIRST_LINE = 2


def read_table(path: Path, *, kind: str) -> pd.DataFrame:
    """Return a CSV file of the public data set or of a phone, its header stripped of blanks and BOM.

    Rows that are empty throughout (spreadsheets leave them at the end) are left out; the index is the line
    of the file.

    Args:
        path: The file.
        kind: What it should be, for messages.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If it is no text, empty, or has a row with too many cells or an open quote.
    """
    if not path.is_file():
        raise MissingFileError(path, expected=f"a {kind}", way_out="check the path or fetch the file again")
    try:
        table = pd.read_csv(
            path, encoding="utf-8-sig", index_col=False, low_memory=False, skip_blank_lines=False
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise BadFileError(
            path,
            "whole file",
            value=" ".join(str(error).split()),
            expected=f"a {kind} (CSV, UTF-8)",
            way_out=_FETCH_AGAIN,
        ) from error
    table.columns = pd.Index([str(name).strip() for name in table.columns])
    table.index = pd.RangeIndex(_FIRST_LINE, _FIRST_LINE + len(table))
    table = table.dropna(how="all")
    if table.empty:
        raise BadFileError(path, "whole file", value="no rows", expected=f"a {kind}", way_out=_FETCH_AGAIN)
    return table


def require_columns(table: pd.DataFrame, names: list[str], path: Path, *, kind: str) -> None:
    """Check that all columns are there.

    Raises:
        BadFileError: Naming the first that is missing.
    """
    missing = [name for name in names if name not in table.columns]
    if missing:
        raise BadFileError(
            path,
            f"column {missing[0]}",
            value=f"the columns {', '.join(table.columns[:6])}, …",
            expected=f"that column of a {kind}",
            way_out="check that the file is of this kind, or fetch it again",
        )


def numbers(table: pd.DataFrame, column: str, path: Path, *, nullable: bool = False) -> Floats:
    """Return a column as floats, shape (rows,).

    Args:
        table: From ``read_table``.
        column: Its name.
        path: The file, for messages.
        nullable: True where a cell may be empty (then NaN).

    Raises:
        BadFileError: Naming line and column of the first text, infinity or (unless nullable) empty cell.
    """
    cells = table[column]
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64)
    empty = cells.isna().to_numpy()
    bad = (np.isnan(values) & ~empty) | np.isinf(values)
    if not nullable:
        bad |= np.isnan(values)
    if bad.any():
        first = int(np.argmax(bad))
        after = table.iloc[first, list(table.columns).index(column) :]
        found = repr(str(cells.iloc[first]))
        if empty[first]:
            found = "nothing (the row is cut off)" if after.isna().all() else "nothing (empty or NaN)"
        raise BadFileError(
            path,
            f"line {table.index[first]}, column {column}",
            value=found,
            expected="a number",
            way_out=_FETCH_AGAIN,
        )
    return values
