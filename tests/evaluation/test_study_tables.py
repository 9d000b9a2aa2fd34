from __future__ import annotations

from collections.abc import Callable

from fploc.evaluation.records import TrackedRecord
from fploc.evaluation.results_page import results_page
from fploc.evaluation.selection import RecordBook
from fploc.evaluation.study_tables import study_sections
from fploc.evaluation.tables import UNKNOWN

MakeRecord = Callable[..., TrackedRecord]


def rows(text: str) -> list[list[str]]:
    return [line.strip("|\n ").split(" | ") for line in text.splitlines() if line.startswith("| ")]


def sections(records: list[TrackedRecord]) -> dict[str, str]:
    return study_sections(RecordBook(records, "full"))


def test_what_was_not_run_is_said() -> None:
    found = sections([])
    assert list(found) == ["Calibrations", "Fewer access points", "Wrong survey"]
    assert all("Not run." in text for text in found.values())


def test_calibrations_stand_by_method_in_the_order_of_the_records(made: MakeRecord) -> None:
    records = [
        made(1.0, method="nls"),
        made(2.0, method="nls", condition="calibration: source-los"),
        made(3.0, method="nls", condition="calibration: none"),
        made(4.0, method="nls", condition="calibration: none", device=2),
        made(5.0, method="nls", condition="calibration: none", labels="published"),
    ]
    text = sections(records)["Calibrations"]
    repaired, published = text.split("### Published labels")
    assert rows(repaired)[2:] == [["nls", "source-los", "2.00", UNKNOWN], ["nls", "none", "3.00", "4.00"]]
    assert rows(published)[2:] == [["nls", "none", "5.00"]]
    assert "Not run." in sections(records)["Wrong survey"]


def test_fewer_access_points_and_a_wrong_survey_are_of_the_thinned_records(made: MakeRecord) -> None:
    records = [
        made(1.0),
        made(1.5, thin=10),
        made(1.6, thin=10, condition="access points: as they are"),
        made(2.0, thin=10, condition="access points: 3"),
        made(3.0, thin=10, condition="survey error: 0.5 m"),
    ]
    found = sections(records)
    assert rows(found["Fewer access points"])[2:] == [
        ["gnn-fpdnn", "as they are", "1.60"],
        ["gnn-fpdnn", "3", "2.00"],
    ]
    assert rows(found["Wrong survey"])[2:] == [
        ["gnn-fpdnn", "as they are", "1.60"],
        ["gnn-fpdnn", "0.5 m", "3.00"],
    ]
    assert "every 10th interval" in found["Wrong survey"]


def test_studies_do_not_stand_among_the_methods(made: MakeRecord) -> None:
    page = results_page([made(1.0), made(7.77, condition="calibration: none")], {})
    comparison = page.split("## All methods")[1].split("\n## ")[0]
    assert "7.77" not in comparison and "condition" not in comparison
