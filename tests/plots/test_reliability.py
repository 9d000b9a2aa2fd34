from __future__ import annotations

import numpy as np

from fploc.plots.reliability import STATED, held_shares, plot_reliability


def normalised(scale: float) -> np.ndarray:
    """Return eᵀP⁻¹e of errors in the plane that are ``scale`` times what is stated."""
    errors = scale * np.random.default_rng(0).normal(size=(20_000, 2))
    return np.square(errors).sum(axis=1)


def test_honest_covariances_hold_what_they_state() -> None:
    np.testing.assert_allclose(held_shares(normalised(1.0)), STATED, atol=0.015)


def test_covariances_too_small_hold_less_and_too_large_ones_more() -> None:
    assert (held_shares(normalised(1.5)) < STATED).all()
    assert (held_shares(normalised(0.7)) > STATED).all()


def test_fixes_without_truth_do_not_count() -> None:
    nees = normalised(1.0)
    np.testing.assert_array_equal(held_shares(np.append(nees, [np.nan, np.nan])), held_shares(nees))
    assert not held_shares(np.array([np.nan])).any()


def test_every_place_has_its_line_beside_the_diagonal() -> None:
    figure = plot_reliability({"hall": normalised(1.0), "barn": normalised(2.0)}, "default", made_up=True)
    (axes,) = figure.axes
    assert [line.get_label() for line in axes.lines[1:]] == ["hall", "barn"]
    np.testing.assert_array_equal(axes.lines[2].get_ydata(), held_shares(normalised(2.0)))
    assert "no real data" in axes.get_title()
    assert len(plot_reliability({}, "empty").axes[0].lines) == 1
