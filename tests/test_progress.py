from __future__ import annotations

import re

import pytest

from fploc.progress import busy, is_shown, print_table, track


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


COLOUR = re.compile(r"\x1b\[(?:\d+;)*[34]\d")


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Let rich take whatever it prints on for a terminal."""
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return monkeypatch


def test_a_terminal_shows_how_many_are_done_and_the_time_left(
    terminal: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert is_shown()
    assert list(track([1, 2], "count")) == [1, 2]
    out, err = capsys.readouterr()
    assert out == "" and "count" in err and "2/2" in err and "0:00:00" in err
    assert COLOUR.search(err)


def test_colours_are_off_where_they_are_not_wanted(
    terminal: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal.setenv("NO_COLOR", "1")
    assert list(track([1], "count")) == [1]
    with busy("work"):
        pass
    print_table([{"value": "1.0"}])
    out, err = capsys.readouterr()
    assert "count" in err and "work" in err and "1.0" in out
    assert not COLOUR.search(out + err)


def test_nothing_is_shown_inside_of_something_shown(
    terminal: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in track([1, 2], "outer"):
        with busy("middle"):
            assert list(track([3], "inner")) == [3]
    assert list(track([4], "later")) == [4]
    err = capsys.readouterr().err
    assert "outer" in err and "later" in err
    assert "middle" not in err and "inner" not in err


def test_work_without_an_end_in_sight_is_silent_without_a_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with busy("work"):
        pass
    assert capsys.readouterr() == ("", "")
