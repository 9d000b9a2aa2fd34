"""Relative figures, which stay comparable where labels and data differ: gains, gaps and what the link is worth.

All are of the RMSE, with a filter behind the method unless said. The paper's percentages are those of its text
(Yu et al., sections "Localization in The Office", "Experimental Results in Different Scenarios" and "Multi-User
Localization").
"""

from __future__ import annotations

from dataclasses import replace

from fploc.evaluation.paper_numbers import published
from fploc.evaluation.records import NO_FILTER
from fploc.evaluation.selection import FILTERED, UNFILTERED, RecordBook, Slot
from fploc.evaluation.tables import UNKNOWN

Rows = list[dict[str, str]]

OURS = "gnn-fpdnn"
ANY = (*FILTERED, NO_FILTER)
PAPER_RIVALS = ("rtt-rss", "bayes-grid", "cbt-wccg")
PAPER_GAINS = {("shopping-mall", 1): "31.1–55.4 %", ("laboratory", 1): "38.5–58.7 %"}
"""Of zero-shot gnn-fpdnn over ``PAPER_RIVALS``."""
PAPER_TUNING = {
    "shopping-mall": "6.0–11.8 %",
    "laboratory": "7.0–16.8 %",
    "office-position1": "10–20 %",
    "office-position2": "10–20 %",
}
PAPER_LINK = "−18.8 %"
"""Device 1 with two devices against device 1 alone, which the paper tests on other samples."""
BEFORE_TUNING = "before fine-tuning"
TWO_ACCESS_POINTS = "two APs, mean"


def percent(change: float) -> str:
    """Return a share as a percentage with its sign."""
    return f"{100.0 * change:+.1f} %".replace("-", "−")


def gain_rows(book: RecordBook, labels: str) -> Rows:
    """Return how much smaller the RMSE of zero-shot gnn-fpdnn is than each other method's, in per cent."""
    like = Slot("zero-shot", "", 0, "", labels=labels)
    slots = list(book.slots(like))
    rivals = dict.fromkeys(slot.method for slot in slots if slot.method != OURS)
    places = dict.fromkeys((slot.site, slot.device) for slot in slots if slot.method == OURS)
    return [
        {
            "site": site,
            "device": str(device),
            **{rival: _gain(book, replace(like, site=site, device=device, method=rival)) for rival in rivals},
            f"paper, over {', '.join(PAPER_RIVALS)}": PAPER_GAINS.get((site, device), UNKNOWN),
        }
        for site, device in places
    ]


def tuning_rows(book: RecordBook, labels: str) -> Rows:
    """Return how much fine-tuning takes off the RMSE on the same second part of each path."""
    like = Slot("fine-tuned", "", 0, "", filters=ANY, labels=labels, condition=BEFORE_TUNING)
    return [
        {
            "site": slot.site,
            "device": str(slot.device),
            "method": slot.method,
            "filter": name,
            "before [m]": book.text(replace(slot, filters=filters)),
            "after [m]": book.text(replace(slot, filters=filters, condition="")),
            "change": _change(
                book.mean(replace(slot, filters=filters)),
                book.mean(replace(slot, filters=filters, condition="")),
            ),
            "paper's gap": PAPER_TUNING.get(slot.site, UNKNOWN) if slot.device == 1 else UNKNOWN,
        }
        for slot in book.slots(like)
        for name, filters in (("none", UNFILTERED), ("KF", FILTERED))
    ]


def device_gap_rows(book: RecordBook, labels: str) -> Rows:
    """Return by how much device 2, of which two access points are heard, is worse than device 1."""
    first = Slot("multi-device", "", 1, "", filters=ANY, labels=labels)
    rows = []
    for slot in (slot for slot in book.slots(first) if slot.device == 1):
        second = replace(slot, device=2, condition=TWO_ACCESS_POINTS)
        for name, filters in (("none", UNFILTERED), ("KF", FILTERED)):
            one, two = replace(slot, filters=filters), replace(second, filters=filters)
            rows.append(
                {
                    "site": slot.site,
                    "method": slot.method,
                    "filter": name,
                    "device 1 [m]": book.text(one),
                    "device 2, two APs [m]": book.text(two),
                    "gap [m]": _difference(book.mean(one), book.mean(two)),
                    "paper's gap [m]": _paper_gap(slot, filtered=filters == FILTERED),
                }
            )
    return rows


def link_rows(book: RecordBook, labels: str) -> Rows:
    """Return what the link between the devices, and a wrong clock of it, does to each device."""
    like = Slot("multi-device", "", 0, "", labels=labels)
    conditions = dict.fromkeys(one.condition for one in book.records if one.protocol == "multi-device")
    found = {
        (slot.site, slot.device, slot.method): None
        for condition in conditions
        for slot in book.slots(replace(like, condition=condition))
    }
    rows = []
    for site, device, method in found:
        here = replace(like, site=site, device=device, method=method)
        without = book.mean(replace(here, condition="without link"))
        rows += [
            {
                "site": site,
                "device": str(device),
                "method": method,
                "condition": condition or "with link",
                "RMSE [m]": book.text(replace(here, condition=condition)),
                "against without link": _change(without, book.mean(replace(here, condition=condition))),
                "paper": PAPER_LINK if (device, method, condition) == (1, OURS, "") else UNKNOWN,
            }
            for condition in conditions
            if book.find(replace(here, condition=condition))
        ]
    return rows


def _gain(book: RecordBook, rival: Slot) -> str:
    other, own = book.mean(rival), book.mean(replace(rival, method=OURS))
    return UNKNOWN if other is None or own is None else percent(1.0 - own / other)


def _change(before: float | None, after: float | None) -> str:
    return UNKNOWN if before is None or after is None else percent(after / before - 1.0)


def _difference(first: float | None, second: float | None) -> str:
    return UNKNOWN if first is None or second is None else f"{second - first:.2f}"


def _paper_gap(slot: Slot, *, filtered: bool) -> str:
    """Return the gap between the devices in the paper's table, metres."""
    first, second = (
        published("multi-device", slot.method, slot.site, device, filtered=filtered, metric="rmse_m")
        for device in (1, 2)
    )
    return f"{float(second[0].value) - float(first[0].value):.2f}" if first and second else UNKNOWN
