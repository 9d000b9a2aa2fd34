from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.selection import UNFILTERED, RecordBook, Slot
from fploc.evaluation.tables import UNKNOWN

MakeRecord = Callable[..., TrackedRecord]
MALL = Slot("zero-shot", "shopping-mall", 1, "gnn-fpdnn")


def test_a_slot_finds_its_seeds_in_order_and_nothing_else(made: MakeRecord) -> None:
    others = [
        made(9.0, labels="published"),
        made(9.0, plan="blank"),
        made(9.0, thin=10),
        made(9.0, condition="without link"),
        made(9.0, preset="full--bare-distance"),
        made(9.0, preset="fuller"),
        made(9.0, filter="none"),
        made(9.0, smoother=True),
        made(9.0, device=2),
        made(9.0, protocol="seen"),
        made(9.0, site="laboratory"),
        made(9.0, method="gnn"),
    ]
    book = RecordBook([made(3.0, seed=2), *others, made(1.0), made(2.0, seed=1)], "full")
    assert book.values(MALL, "rmse_m") == [1.0, 2.0, 3.0]
    assert book.mean(MALL) == 2.0 and book.text(MALL) == "2.00 ± 1.00"
    assert book.mean(replace(MALL, variant="bare-distance")) == 9.0
    assert book.mean(replace(MALL, filters=("none",))) == 9.0


def test_a_methods_own_filter_stands_in_for_both(made: MakeRecord) -> None:
    book = RecordBook([made(1.5, method="bayes-grid", filter="own")], "full")
    slot = replace(MALL, method="bayes-grid")
    assert book.mean(slot) == book.mean(replace(slot, filters=UNFILTERED)) == 1.5


def test_the_least_thinned_records_count_unless_asked(made: MakeRecord) -> None:
    book = RecordBook([made(1.0, thin=2), made(5.0, thin=20)], "full")
    assert book.mean(MALL) == 1.0 and book.mean(replace(MALL, thin=20)) == 5.0


def test_what_is_not_there_is_a_dash(made: MakeRecord) -> None:
    book = RecordBook([made(None)], "full")
    assert book.mean(MALL) is None and book.text(MALL) == UNKNOWN
    assert RecordBook([], "full").text(MALL) == UNKNOWN


def test_slots_are_the_places_and_methods_that_have_a_record(made: MakeRecord) -> None:
    book = RecordBook([made(), made(seed=1), made(device=2), made(method="gnn", labels="published")], "full")
    found = [(slot.device, slot.method) for slot in book.slots(Slot("zero-shot", "", 0, ""))]
    assert found == [(1, "gnn-fpdnn"), (2, "gnn-fpdnn")]
    (published,) = book.slots(Slot("zero-shot", "", 0, "", labels="published"))
    assert published.method == "gnn"
