"""docs/data.md says what fploc.schema and the registry say."""

from __future__ import annotations

from pathlib import Path

from fploc.datasets.data_page import refreshed
from fploc.schema import TABLES

PAGE = Path(__file__).parents[2] / "docs" / "data.md"


def test_the_page_agrees_with_the_schema_and_the_registry() -> None:
    page = PAGE.read_text("utf-8")
    assert refreshed(page) == page, (
        "docs/data.md is out of date: write fploc.datasets.data_page.refreshed(page) back to it"
    )


def test_every_column_stands_on_the_page_with_its_meaning() -> None:
    lines = PAGE.read_text("utf-8").splitlines()
    for table in TABLES:
        for column in table.columns:
            assert any(f"`{column.name}`" in line and column.meaning in line for line in lines)


def test_stale_parts_are_replaced_and_the_rest_is_kept() -> None:
    columns, faults = "<!-- columns: from here -->", "<!-- faults: from here -->"
    reading = "<!-- reading: from here -->\nstale\n<!-- end -->"
    page = f"before\n{columns}\nstale\n<!-- end -->\nbetween\n{faults}\n<!-- end -->\n{reading}\nafter\n"
    fresh = refreshed(page)
    assert fresh.startswith("before\n<!-- columns: from here -->\n### readings\n")
    assert "<!-- end -->\nbetween\n<!-- faults: from here -->\n| site |" in fresh
    assert fresh.endswith("<!-- end -->\nafter\n") and "stale" not in fresh
    assert refreshed(fresh) == fresh
