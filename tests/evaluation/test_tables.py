from __future__ import annotations

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.tables import UNKNOWN, listed, mean_text, plain, signed, thousands


def test_markdown_holds_one_line_for_each_row() -> None:
    assert markdown_grid([{"a": "1", "b": "2"}]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    assert markdown_grid([]) == ""


def test_several_numbers_are_mean_and_sample_deviation_one_stands_alone_none_is_a_dash() -> None:
    assert mean_text([1.0, 2.0, None, 3.0]) == "2.00 ± 1.00"
    assert mean_text([None, 1.25], decimals=1) == "1.2"
    assert mean_text([None]) == mean_text([]) == UNKNOWN


def test_numbers_carry_signs_and_commas_and_names_stand_once() -> None:
    assert [plain(0.125, decimals=3), signed(-0.5), signed(0.5), thousands(12345.6)] == [
        "0.125", "−0.50", "+0.50", "12,346",
    ]  # fmt: skip
    assert plain(None) == signed(None) == thousands(None) == listed([]) == UNKNOWN
    assert listed(["b", "a", "b"]) == "a, b"
