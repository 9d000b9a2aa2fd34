from __future__ import annotations

import importlib.util
import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
_spec = importlib.util.spec_from_file_location("load_page", ROOT / "soak" / "load_page.py")
assert _spec is not None and _spec.loader is not None
load_page = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(load_page)

FOUND = json.loads((ROOT / "docs" / "load.json").read_text("utf-8"))


def test_the_page_says_what_was_found() -> None:
    assert load_page.page(FOUND) == (ROOT / "docs" / "load.md").read_text("utf-8")


def test_what_was_found_keeps_what_is_promised() -> None:
    kills, browser = FOUND["kills"], FOUND["browser"]
    (steady,) = FOUND["steady"]
    assert steady["method"] == "default"
    assert (steady["devices"], steady["seconds"]) == (50, 300.0)
    assert steady["within_200_ms"] >= 0.99 and steady["memory_growth"] < 0.05
    assert kills["kills"] >= 20 and (kills["lost"], kills["elsewhere"]) == (0, 0)
    assert browser["devices"] >= 200 and browser["renderer_cores"] <= 0.6
    # Whatever the load, the queue stays bounded, and in the steady run nobody goes without.
    assert all(row["most_waiting"] <= 6000 for row in FOUND["curve"])
    assert min(steady["fixes_seen_of_least_and_most"]) > 0
