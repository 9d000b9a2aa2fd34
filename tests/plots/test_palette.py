from __future__ import annotations

from matplotlib.colors import to_rgb

from fploc.plots.palette import AP_COLOUR, COLOURS, TRUTH_COLOUR, colour, hatch, line_style


def test_twenty_one_things_look_different_as_lines_and_as_bars() -> None:
    things = range(3 * len(COLOURS))
    assert len({(colour(one), line_style(one)) for one in things}) == len(things)
    assert len({(colour(one), hatch(one)) for one in things}) == len(things)


def test_no_thing_looks_like_ground_truth_or_access_points() -> None:
    assert not {to_rgb(one) for one in COLOURS} & {to_rgb(AP_COLOUR), to_rgb(TRUTH_COLOUR)}
