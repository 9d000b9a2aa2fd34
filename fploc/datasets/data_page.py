"""The generated parts of docs/data.md: the tables of ``fploc.schema`` and the known faults of the registry."""

from __future__ import annotations

import re
from collections.abc import Sequence

from fploc.schema import TABLES, Column, Table
from fploc.sites.registry import FaultSpec, RepairSpec, known_sites, load_spec


def refreshed(page: str) -> str:
    """Return ``page`` with the text between its markers ``<!-- columns: … -->``, ``<!-- end -->`` made anew."""
    return _filled(_filled(page, "columns", _columns()), "faults", _faults())


def _filled(page: str, part: str, text: str) -> str:
    match = re.search(rf"<!-- {part}:.*?-->\n(.*?)<!-- end -->", page, flags=re.DOTALL)
    assert match is not None, f"docs/data.md holds no marker for its {part}"
    return page[: match.start(1)] + text + page[match.end(1) :]


def _columns() -> str:
    return "\n".join(_table(table) for table in TABLES)


def _table(table: Table) -> str:
    rows = [_column(column) for column in table.columns]
    return (
        f"### {table.name}\n{table.meaning[0].upper()}{table.meaning[1:]}; key: {', '.join(table.key)}.\n\n"
        + _grid(("column", "dtype", "unit", "null", "range", "meaning"), rows)
    )


def _column(column: Column) -> tuple[str, ...]:
    low = "" if column.minimum is None else f"≥ {column.minimum:g}"
    high = "" if column.maximum is None else f"≤ {column.maximum:g}"
    return (
        f"`{column.name}`",
        column.dtype,
        column.unit if column.unit != "1" else "",
        "yes" if column.nullable else "no",
        ", ".join(limit for limit in (low, high) if limit),
        column.meaning,
    )


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
        (", ".join(sites), fault.where, fault.what, fault.verdict) for fault, sites in faults.items()
    ]
    repair_rows = [
        (site, f"`{repair.name}`", _constants(repair), repair.origin.rstrip(".")) for site, repair in repairs
    ]
    return (
        _grid(("site", "where", "fault", "what is done"), fault_rows)
        + "\nRepairs of labels, with their constants:\n\n"
        + _grid(("site", "repair", "constants", "origin"), repair_rows)
    )


def _constants(repair: RepairSpec) -> str:
    plain = [f"{key} {value}" for key, value in repair.constants.items() if not isinstance(value, dict)]
    keyed = [
        f"{key}: {name} {entry}"
        for key, value in repair.constants.items()
        if isinstance(value, dict)
        for name, entry in value.items()
    ]
    return "; ".join(plain + keyed)


def _grid(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)
