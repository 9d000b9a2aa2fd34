"""Tables and JSON on standard output, remarks on standard error."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any


def print_values(values: Mapping[str, Any], *, as_json: bool) -> None:
    """Print named values, one to a line, or as a JSON object."""
    if as_json:
        print(json.dumps(values, indent=2, default=str))
        return
    print_rows([{"": name, "value": as_text(value)} for name, value in values.items()], as_json=False)


def print_rows(rows: Sequence[Mapping[str, str]], *, as_json: bool) -> None:
    """Print a table, or the same as a JSON list."""
    if as_json:
        print(json.dumps(list(rows), indent=2))
        return
    from fploc.progress import print_table

    print_table(rows)


def print_columns(records: Sequence[Mapping[str, object]], columns: Sequence[str], *, as_json: bool) -> None:
    """Print a table of some columns of records, or all of them as a JSON list."""
    if as_json:
        print(json.dumps(list(records), indent=2))
        return
    print_rows([{name: as_text(record[name]) for name in columns} for record in records], as_json=False)


def remark(message: str) -> None:
    """Print one line on standard error that says who speaks."""
    print(f"fploc: {message}", file=sys.stderr)


def as_text(value: object) -> str:
    """Return what stands in a cell of a table."""
    if isinstance(value, float):
        return f"{value:.2f}"
    if isinstance(value, list | tuple):
        return ", ".join(str(item) for item in value) or "none"
    return str(value)
