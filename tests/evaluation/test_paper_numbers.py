from __future__ import annotations

import re

from fploc.evaluation.paper_numbers import KALMAN_SUFFIX, paper_numbers, published
from fploc.sites.registry import known_sites

EXPERIMENTS_WITHOUT_TRAINING_ON_THE_TARGET = {"zero-shot", "two devices"}


def test_every_number_is_a_number_or_a_bound_of_a_known_site() -> None:
    rows = paper_numbers()
    assert len(rows) > 60
    for row in rows:
        assert row.experiment and row.method and row.metric and row.value, row
        assert re.search(r"\d", row.value), row
        assert row.site in ("", *known_sites()), row
        assert row.device in (None, 1, 2), row


def test_no_row_stands_twice() -> None:
    rows = [
        (row.experiment, row.site, row.device, row.method, row.metric, row.note) for row in paper_numbers()
    ]
    assert len(rows) == len(set(rows))


def test_zero_shot_rows_come_first() -> None:
    found = published("zero-shot", "gnn-fpdnn", "shopping-mall", 1, filtered=True, metric="rmse_m")
    assert [(row.experiment, row.value) for row in found] == [("zero-shot", "1.19"), ("two devices", "0.90")]
    assert {row.method for row in found} == {f"gnn-fpdnn{KALMAN_SUFFIX}"}


def test_the_filter_chooses_the_row() -> None:
    values = {
        filtered: [
            row.value
            for row in published("zero-shot", "gnn", "shopping-mall", 2, filtered=filtered, metric="rmse_m")
        ]
        for filtered in (False, True)
    }
    assert values == {False: ["2.47"], True: ["1.76"]}


def test_results_that_trained_on_the_target_are_left_out() -> None:
    rows = [row for row in paper_numbers() if row.method == "gnn-fpdnn" and row.experiment == "fine-tuned"]
    assert rows, "the file holds such rows"
    for site in known_sites():
        for device in (1, 2):
            found = published("zero-shot", "gnn-fpdnn", site, device, filtered=False, metric="rmse_m")
            assert {row.experiment for row in found} <= EXPERIMENTS_WITHOUT_TRAINING_ON_THE_TARGET


def test_what_the_paper_does_not_say_is_empty() -> None:
    assert published("zero-shot", "nls", "shopping-mall", 1, filtered=False, metric="rmse_m") == []
    assert published("zero-shot", "gnn", "moon", 1, filtered=False, metric="rmse_m") == []


def test_moved_access_points_stand_for_the_office_of_the_paper() -> None:
    def rmse(protocol: str, site: str) -> list[str]:
        found = published(protocol, "gnn-fpdnn", site, 1, filtered=True, metric="rmse_m")
        return [row.value for row in found]

    for site in ("office-position1", "office-position2"):
        assert rmse("ap-moved", site) == ["0.95"] and rmse("fine-tuned", site) == ["0.87"]
    assert rmse("seen", "office") == ["0.30"] and rmse("zero-shot", "office-position1") == []
    assert rmse("fine-tuned", "shopping-mall") == ["1.05"]
    assert rmse("multi-device", "shopping-mall") == ["0.90"]
