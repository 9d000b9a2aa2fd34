"""Sections of the results page on what was varied around each method, zero-shot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.conditions import (
    ACCESS_POINTS,
    AS_IS,
    CALIBRATION,
    STUDIES,
    SURVEY_ERROR,
    condition,
    varied,
)
from fploc.evaluation.selection import RecordBook, Slot
from fploc.evaluation.tables import MISSING

PLAIN = Slot("zero-shot", "", 0, "")


def study_sections(book: RecordBook) -> dict[str, str]:
    """Return the sections by their titles; what was not run is said to be so."""
    return {
        "Calibrations": _calibrations(book),
        "Fewer access points": _access_points(book),
        "Wrong survey": _survey(book),
    }


def _calibrations(book: RecordBook) -> str:
    parts = []
    for labels in ("repaired", "published"):
        like = replace(PLAIN, labels=labels)
        table = _table(book, like, CALIBRATION, _conditions(book, CALIBRATION))
        if table:
            parts.append(f"### {labels.capitalize()} labels\n\n{table}\n")
    return (
        "RMSE with KF, zero-shot, of methods without training behind each way to fit range offsets on the source: "
        "`none`; `source-los`, one number from readings in line of sight; `source-median`, one number from all "
        "readings; `source-mac`, line of sight by access point. Each method's own, chosen on the source, stands "
        f"in the tables above.\n\n{''.join(parts) or MISSING}"
    )


def _access_points(book: RecordBook) -> str:
    like = replace(PLAIN, thin=_thin(book))
    table = _table(book, like, "access points", _conditions(book, ACCESS_POINTS))
    return (
        f"RMSE with KF, zero-shot, repaired labels, every {like.thin}th interval, of devices that hear so many of "
        "the access points that they otherwise hear, over five choices, the same for all recordings that hear "
        f"the same ones. First seed of trained methods, which are not adapted to what is left.\n\n{table or MISSING}"
    )


def _survey(book: RecordBook) -> str:
    like = replace(PLAIN, thin=_thin(book))
    errors = _conditions(book, SURVEY_ERROR)
    table = _table(book, like, "greatest error", [condition(ACCESS_POINTS, AS_IS), *errors]) if errors else ""
    return (
        f"RMSE with KF, zero-shot, repaired labels, every {like.thin}th interval, where each coordinate of each "
        f"access point is off by up to so much, evenly distributed, over five draws.\n\n{table or MISSING}"
    )


def _table(book: RecordBook, like: Slot, title: str, conditions: Sequence[str]) -> str:
    """Return methods and conditions by places."""
    slots = {named: list(book.slots(replace(like, condition=named))) for named in conditions}
    every = [slot for found in slots.values() for slot in found]
    places = sorted({(slot.site, slot.device) for slot in every})
    return markdown_grid(
        [
            {
                "method": method,
                title: varied(named)[1],
                **{
                    f"{site} {device}": book.text(
                        replace(like, site=site, device=device, method=method, condition=named)
                    )
                    for site, device in places
                },
            }
            for method in dict.fromkeys(slot.method for slot in every)
            for named, found in slots.items()
            if any(slot.method == method for slot in found)
        ]
    )


def _conditions(book: RecordBook, study: str) -> list[str]:
    """Return the conditions of a study in the order of the records."""
    return list(dict.fromkeys(one.condition for one in book.records if varied(one.condition)[0] == study))


def _thin(book: RecordBook) -> int:
    """Return how thinned the records with other access points are."""
    equipment = set(STUDIES) - {CALIBRATION}
    return next((one.thin for one in book.records if varied(one.condition)[0] in equipment), 1)
