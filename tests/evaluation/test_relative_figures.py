from __future__ import annotations

from collections.abc import Callable

from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.relative_figures import (
    device_gap_rows,
    gain_rows,
    link_rows,
    percent,
    tuning_rows,
)
from fploc.evaluation.selection import RecordBook
from fploc.evaluation.tables import UNKNOWN

MakeRecord = Callable[..., TrackedRecord]


def test_percentages_have_their_sign() -> None:
    assert [percent(share) for share in (0.311, -0.5, 0.0)] == ["+31.1 %", "−50.0 %", "+0.0 %"]


def test_gains_are_over_each_method_at_each_place_with_the_papers_beside(made: MakeRecord) -> None:
    records = [
        made(1.0),
        made(3.0, seed=1),
        made(4.0, method="nls"),
        made(1.0, method="bayes-grid", filter="own"),
        made(5.0, method="nls", site="laboratory", device=2),
        made(1.0, site="laboratory", device=2),
    ]
    mall, laboratory = gain_rows(RecordBook(records, "full"), "repaired")
    paper = "paper, over rtt-rss, bayes-grid, cbt-wccg"
    assert mall == {
        "site": "shopping-mall", "device": "1", "nls": "+50.0 %", "bayes-grid": "−100.0 %", paper: "31.1–55.4 %",
    }  # fmt: skip
    assert (laboratory["nls"], laboratory["bayes-grid"], laboratory[paper]) == ("+80.0 %", UNKNOWN, UNKNOWN)
    assert gain_rows(RecordBook(records, "full"), "published") == []


def test_fine_tuning_is_measured_on_the_same_part(made: MakeRecord) -> None:
    records = [
        made(2.0, protocol="fine-tuned", condition="before fine-tuning"),
        made(1.5, protocol="fine-tuned"),
        made(7.0, protocol="fine-tuned", method="nls"),
    ]
    plain, filtered = tuning_rows(RecordBook(records, "full"), "repaired")
    assert (filtered["before [m]"], filtered["after [m]"], filtered["change"]) == ("2.00", "1.50", "−25.0 %")
    assert filtered["paper's gap"] == "6.0–11.8 %" and filtered["method"] == "gnn-fpdnn"
    assert plain["change"] == UNKNOWN


def test_the_gap_between_devices_is_the_papers_own_difference(made: MakeRecord) -> None:
    both = {"protocol": "multi-device", "method": "trilateration", "filter": "none"}
    records = [
        made(1.0, **both),
        made(2.5, **both, device=2, condition="two APs, mean"),
        made(9.0, **both, device=2),
    ]
    rows = device_gap_rows(RecordBook(records, "full"), "repaired")
    plain = rows[0]
    assert (plain["gap [m]"], plain["paper's gap [m]"], plain["device 2, two APs [m]"]) == (
        "1.50",
        "1.18",
        "2.50",
    )
    assert rows[1]["gap [m]"] == UNKNOWN


def test_every_condition_is_laid_against_the_one_without_link(made: MakeRecord) -> None:
    at = {"protocol": "multi-device"}
    records = [
        made(0.8, **at),
        made(1.0, **at, condition="without link"),
        made(1.2, **at, condition="link clock +5 s"),
        made(4.0, **at, device=2, condition="two APs, mean"),
    ]
    rows = link_rows(RecordBook(records, "full"), "repaired")
    assert [(row["device"], row["condition"], row["against without link"]) for row in rows] == [
        ("1", "with link", "−20.0 %"),
        ("1", "without link", "+0.0 %"),
        ("1", "link clock +5 s", "+20.0 %"),
        ("2", "two APs, mean", UNKNOWN),
    ]
    assert [row["paper"] for row in rows] == ["−18.8 %", *[UNKNOWN] * 3]
