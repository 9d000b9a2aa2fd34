"""Draw the picture of README.md and of the documentation; `make picture` runs this.

A made-up building, one recording of it, and what two methods without any training make of its ranges.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.filters.kalman import KalmanSettings
from fploc.localizer import localize
from fploc.methods.registry import geometric_method
from fploc.plots.trajectories import plot_trajectories
from fploc.sites.made_up import LINE_OF_SIGHT_OFFSET_M, made_up_site

PICTURE = Path(__file__).with_suffix(".png")
SEED, DPI = 7, 110


def main() -> None:
    """Write the picture beside this file."""
    with tempfile.TemporaryDirectory() as folder:
        site_file = made_up_site(SEED, Path(folder), laps=1)
        build_sites(None, Path(folder) / "data", [site_file])
        packed = read_packed(Path(folder) / "data", site_file.stem)
        recording = packed.recordings()[0]
        offsets = RangeOffsets("known", LINE_OF_SIGHT_OFFSET_M)
        stages = {}
        for method in ("nls", "bayes-grid"):
            (track,) = localize(geometric_method(method), packed.site, [recording], offsets, KalmanSettings())
            own = track.unfiltered if track.filtered is None or method == "bayes-grid" else track.filtered
            name = method if method == "bayes-grid" else f"{method} with Kalman filter"
            stages[name] = own.positions_m
        figure = plot_trajectories(
            packed.plan,
            packed.site,
            recording.labels_m("published"),
            stages,
            title="Positions from WiFi round-trip times",
        )
        figure.savefig(PICTURE, dpi=DPI, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
