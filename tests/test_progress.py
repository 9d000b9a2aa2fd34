from __future__ import annotations

import pytest

from fploc.progress import is_shown, print_table, track


def test_track_yields_every_item_in_order_and_is_silent_without_a_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert list(track([3, 1, 2], "count")) == [3, 1, 2]
    assert list(track([], "nothing")) == []
    assert not is_shown()
    assert capsys.readouterr() == ("", "")


def test_track_passes_what_the_loop_raises() -> None:
    with pytest.raises(KeyboardInterrupt):
        for _ in track([1, 2], "count"):
            raise KeyboardInterrupt


def test_tables_go_to_stdout_whole(capsys: pytest.CaptureFixture[str]) -> None:
    wide = {f"column {number}": f"{number}.25" for number in range(12)}
    print_table([wide, wide])
    out, err = capsys.readouterr()
    lines = [line.split() for line in out.splitlines() if line.strip() and "─" not in line]
    assert err == "" and len(lines) == 3
    assert lines[1] == lines[2] == list(wide.values())


def test_a_cell_that_looks_like_markup_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    print_table([{"value": "[bold] [/x] [3, 4]"}])
    assert "[bold] [/x] [3, 4]" in capsys.readouterr().out


def test_no_rows_make_no_columns(capsys: pytest.CaptureFixture[str]) -> None:
    print_table([])
    assert capsys.readouterr().out.strip() == ""
