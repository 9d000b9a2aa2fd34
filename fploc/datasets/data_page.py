"""The generated parts of docs/data.md: tables of ``fploc.schema``, known faults of the registry, how to read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from fploc.datasets.pages import markdown_grid
from fploc.datasets.reading_example import reading_example
from fploc.schema import TABLES, Column, Table
from fploc.sites.registry import FaultSpec, RepairSpec, known_sites, load_spec


def refreshed(page: str) -> str:
    """Return ``page`` with the text between its markers ``<!-- columns: … -->``, ``<!-- end -->`` made anew."""
    parts = {"columns": _columns(), "faults": _faults(), "reading": _reading()}
    for part, text in parts.items():
        page = _filled(page, part, text)
    return page


def _filled(page: str, part: str, text: str) -> str:
    match = re.search(rf"<!-- {part}:.*?-->\n(.*?)<!-- end -->", page, flags=re.DOTALL)
    assert match is not None, f"docs/data.md holds no marker for its {part}"
    return page[: match.start(1)] + text + page[match.end(1) :]


def _columns() -> str:
    return "\n".join(_table(table) for table in TABLES)


def _table(table: Table) -> str:
    meaning = f"{table.meaning[0].upper()}{table.meaning[1:]}"
    return f"### {table.name}\n{meaning}; key: {', '.join(table.key)}.\n\n{markdown_grid(column_rows(table))}"


def column_rows(table: Table) -> list[dict[str, str]]:
    """Return a row for each column of a table: name, type, unit, null rule, range, meaning."""
    return [_column(column) for column in table.columns]


def _column(column: Column) -> dict[str, str]:
    low = "" if column.minimum is None else f"≥ {column.minimum:g}"
    high = "" if column.maximum is None else f"≤ {column.maximum:g}"
    return {
        "column": f"`{column.name}`",
        "dtype": column.dtype,
        "unit": column.unit if column.unit != "1" else "",
        "null": "yes" if column.nullable else "no",
        "range": ", ".join(limit for limit in (low, high) if limit),
        "meaning": column.meaning,
    }


def _reading() -> str:
    return f"```python\n{reading_example('data/packed/office')}```\n"


def _faults() -> str:
    """One table of faults and one of repairs, each row with the sites that it holds for."""
    faults: dict[FaultSpec, list[str]] = {}
    repairs: list[tuple[str, RepairSpec]] = []
    for name in known_sites():
        spec = load_spec(name)
        for fault in spec.faults:
            faults.setdefault(fault, []).append(name)
        repairs += [(name, repair) for repair in spec.repairs.values()]
    fault_rows = [
        {"site": ", ".join(sites), "where": fault.where, "fault": fault.what, "what is done": fault.verdict}
        for fault, sites in faults.items()
    ]
    repair_rows = [
        {
            "site": site,
            "repair": f"`{repair.name}`",
            "constants": constants_text(repair.constants),
            "origin": repair.origin.rstrip("."),
        }
        for site, repair in repairs
    ]
    return f"{markdown_grid(fault_rows)}\nRepairs of labels, with their constants:\n\n{markdown_grid(repair_rows)}"


def constants_text(constants: Mapping[str, Any]) -> str:
    """Return the constants of a repair in one line."""
    plain = [f"{key} {value}" for key, value in constants.items() if not isinstance(value, Mapping)]
    keyed = [
        f"{key}: {name} {entry}"
        for key, value in constants.items()
        if isinstance(value, Mapping)
        for name, entry in value.items()
    ]
    return "; ".join(plain + keyed)
