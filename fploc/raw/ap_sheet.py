"""AP lists: coordinates (xlsx or csv), and in some xlsx the MACs and corner points of the laps."""

from __future__ import annotations

import re
import unicodedata
import zipfile
from dataclasses import dataclass
from pathlib import Path

import openpyxl
from openpyxl.utils.exceptions import InvalidFileException

from fploc.errors import BadFileError, MissingFileError
from fploc.raw.tables import numbers, read_table, require_columns

_KIND = "list of access points"
_LOCK_PREFIX = "~$"
_AP = re.compile(r"AP\d+", re.IGNORECASE)
_POINT = re.compile(r"\(\s*(-?[\d.]+)\s*,\s*(-?[\d.]+)\s*\)")
_MAC = re.compile(r"(AP\d+)_Mac\s*=\s*[\"']?([0-9a-f]{2}(?::[0-9a-f]{2}){5})[\"']?", re.IGNORECASE)
_WAY_OUT = "export the list again with the columns name, x, y"

Point = tuple[float, float]


@dataclass(frozen=True)
class ApSheet:
    """What an AP list holds. Placeholders for access points that were not set up are left in.

    Args:
        access_points: Position of each name, metres.
        macs: MAC of each name; empty where the list has none.
        corners: Position of each corner point of the laps, metres; empty where the list has none.
    """

    access_points: dict[str, Point]
    macs: dict[str, str]
    corners: dict[str, Point]


def read_ap_sheet(path: Path) -> ApSheet:
    """Read an AP list: a table of name, x, y (csv with or without BOM, xlsx), or names over "(x, y)" (xlsx).

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If it is the lock file of an office program, or cannot be read as a list.
    """
    if not path.is_file():
        raise MissingFileError(path, expected=f"a {_KIND}", way_out="check the path or fetch the file again")
    if path.name.startswith(_LOCK_PREFIX):
        raise BadFileError(
            path,
            "whole file",
            value="the lock file of an office program",
            expected=f"a {_KIND}",
            way_out=f"name the file without {_LOCK_PREFIX}",
        )
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    return _read_workbook(path)


def _read_csv(path: Path) -> ApSheet:
    table = read_table(path, kind=_KIND)
    require_columns(table, ["x", "y"], path, kind=_KIND)
    names = [_normal(name) for name in table.iloc[:, 0]]
    x, y = numbers(table, "x", path), numbers(table, "y", path)
    points = dict(zip(names, zip(x.tolist(), y.tolist(), strict=True), strict=True))
    return ApSheet(access_points=_checked(points, path), macs={}, corners={})


def _read_workbook(path: Path) -> ApSheet:
    try:
        book = openpyxl.load_workbook(path, data_only=True, read_only=True)
        rows: list[list[object]] = [list(row) for row in book.worksheets[0].iter_rows(values_only=True)]
        book.close()
    except (zipfile.BadZipFile, KeyError, ValueError, OSError, InvalidFileException) as error:
        raise BadFileError(
            path, "whole file", value=str(error), expected=f"a {_KIND} (xlsx)", way_out=_WAY_OUT
        ) from error
    rows = [row for row in rows if any(cell is not None for cell in row)]
    if not rows:
        raise BadFileError(path, "whole file", value="no cells", expected=f"a {_KIND}", way_out=_WAY_OUT)
    header = [_normal(cell) for cell in rows[0]]
    if "x" in header and "y" in header:
        return _table_form(header, rows[1:], path)
    return _wide_form(header, rows[1:], path)


def _table_form(header: list[str], rows: list[list[object]], path: Path) -> ApSheet:
    x, y = header.index("x"), header.index("y")
    points: dict[str, Point] = {}
    for number, row in enumerate(rows, start=2):
        points[_normal(row[0])] = (_number(row[x], path, number, "x"), _number(row[y], path, number, "y"))
    return ApSheet(access_points=_checked(points, path), macs={}, corners={})


def _wide_form(header: list[str], rows: list[list[object]], path: Path) -> ApSheet:
    points: dict[str, Point] = {}
    for name, cell in zip(header, rows[0] if rows else [], strict=False):
        if not name:
            continue
        match = _POINT.fullmatch(_normal(cell))
        if match is None:
            raise BadFileError(
                path,
                f"row 2, column {name}",
                value=repr(cell),
                expected='a point like "(0.495, 15.47)"',
                way_out=_WAY_OUT,
            )
        points[name] = (float(match[1]), float(match[2]))
    texts = [_normal(cell) for row in rows[1:] for cell in row if cell is not None]
    macs = {match[1].upper(): match[2].lower() for text in texts if (match := _MAC.fullmatch(text))}
    return ApSheet(
        access_points=_checked({name: xy for name, xy in points.items() if _AP.fullmatch(name)}, path),
        macs=macs,
        corners={name: xy for name, xy in points.items() if not _AP.fullmatch(name)},
    )


def _normal(cell: object) -> str:
    """Return a cell's text with full-width letters, brackets, commas and quotes as plain ones."""
    text = unicodedata.normalize("NFKC", "" if cell is None else str(cell))
    return text.replace("，", ",").replace("“", '"').replace("”", '"').replace("\ufeff", "").strip()


def _number(cell: object, path: Path, row: int, column: str) -> float:
    if isinstance(cell, bool) or not isinstance(cell, int | float):
        raise BadFileError(
            path, f"row {row}, column {column}", value=repr(cell), expected="a number", way_out=_WAY_OUT
        )
    return float(cell)


def _checked(points: dict[str, Point], path: Path) -> dict[str, Point]:
    if not points or not all(points):
        raise BadFileError(
            path, "first column", value=list(points), expected="names like AP1", way_out=_WAY_OUT
        )
    return points
