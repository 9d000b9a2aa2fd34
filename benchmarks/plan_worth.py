"""What plan, survey, phone and each part of learned-grid are worth: `python benchmarks/plan_worth.py --help`.

RMSE by repaired labels, every k-th interval at its own time. Plans are moved, scaled and turned under the access
points, and access points are moved under the plan: the drawing or the survey is wrong, the readings are those
measured. Then these are made those of a phone with louder or fainter signals, or with another offset. Parts are taken
away from the trained method without training it again.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fploc.artifacts import offsets_of
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.recordings import Recording
from fploc.evaluation.metrics import score
from fploc.experiments.scoring import chosen_plan
from fploc.floorplan.georeference import Georeference
from fploc.floorplan.plan import FloorPlan
from fploc.localizer import localize
from fploc.methods.learned_grid import LearnedGridFilter
from fploc.methods.stored_grid import restored
from fploc.progress import print_table
from fploc.shipped import SOURCE_ONLY, shipped_artifact
from fploc.sites.site import Site

SITES = ("conference-room", "laboratory", "library", "shopping-mall")
SHIFT_M, SCALE, TURN = 1.0, 1.05, math.radians(3.0)
SURVEY_ERROR_M, SURVEYS = 0.5, 2
LOUDER_DB, LONGER_M = 10.0, 0.5
LABELS = "repaired"


def displaced(plan: FloorPlan, about_m: tuple[float, float], matrix: Sequence[Sequence[float]]) -> FloorPlan:
    """Return a plan drawn elsewhere: what stood at x stands at A (x − about) + about + b, with matrix [A b].

    Args:
        plan: The plan.
        about_m: Point that scaling and turning leave where it is, metres.
        matrix: A and b side by side, shape (2, 3).
    """
    moved = np.vstack([np.array(matrix, dtype=np.float64), [0.0, 0.0, 1.0]])
    to_point, back = np.eye(3), np.eye(3)
    to_point[:2, 2], back[:2, 2] = about_m, np.negative(about_m)
    after = plan.georeference.pixels_from_metres @ np.linalg.inv(to_point @ moved @ back)
    return replace(plan, georeference=Georeference(after))


def plans(packed: PackedSite, data_root: Path) -> dict[str, FloorPlan]:
    """Return every plan to try at a site, by what is done to it; the library lends its plan."""
    about = tuple(packed.site.positions_m.mean(axis=0).tolist())
    cosine, sine = math.cos(TURN), math.sin(TURN)
    changes: Mapping[str, Sequence[Sequence[float]]] = {
        f"{SHIFT_M:+.0f} m in x": [[1, 0, SHIFT_M], [0, 1, 0]],
        f"{-SHIFT_M:+.0f} m in x": [[1, 0, -SHIFT_M], [0, 1, 0]],
        f"{SHIFT_M:+.0f} m in y": [[1, 0, 0], [0, 1, SHIFT_M]],
        f"{-SHIFT_M:+.0f} m in y": [[1, 0, 0], [0, 1, -SHIFT_M]],
        f"scaled by {SCALE}": [[SCALE, 0, 0], [0, SCALE, 0]],
        f"scaled by 1/{SCALE}": [[1 / SCALE, 0, 0], [0, 1 / SCALE, 0]],
        "turned by 3 degrees": [[cosine, -sine, 0], [sine, cosine, 0]],
        "turned by -3 degrees": [[cosine, sine, 0], [-sine, cosine, 0]],
    }
    lent = "library" if packed.site.name != "library" else "laboratory"
    return {
        "real": packed.plan,
        "blank": packed.plan.blank(),
        "of another site": chosen_plan(lent, packed, data_root),
        **{name: displaced(packed.plan, about, change) for name, change in changes.items()},
    }


def parts_taken(method: LearnedGridFilter, plan: FloorPlan) -> dict[str, LearnedGridFilter]:
    """Return the method without each of its parts."""
    settings = method.settings
    in_context, by_its_past, by_strength, alone = method.networks
    walk = replace(settings.coarse.walk, walking_share=0.0)
    dawdling = replace(settings, coarse=replace(settings.coarse, walk=walk))
    changed: Mapping[str, LearnedGridFilter] = {
        "forgiving likelihood alone": LearnedGridFilter(settings.sharing(0.0), method.networks),
        "learned likelihood alone": LearnedGridFilter(settings.sharing(1.0), method.networks),
        "walls trusted like clear lines": LearnedGridFilter(
            replace(settings, walled=settings.clear), method.networks
        ),
        "without the network of the context": LearnedGridFilter(settings, [by_its_past, by_strength, alone]),
        "without the network of a link's past": LearnedGridFilter(settings, [in_context, by_strength, alone]),
        "without the network of walls and signal": LearnedGridFilter(
            settings, [in_context, by_its_past, alone]
        ),
        "network of range and signal alone, blind to walls": LearnedGridFilter(settings, [alone]),
        "nobody walks": LearnedGridFilter(dawdling, method.networks),
        "nothing tempered": LearnedGridFilter(replace(settings, correlation_s=1e-3), method.networks),
    }
    return {name: one.for_plan(plan) for name, one in changed.items()}


def resurveyed(site: Site, seed: int) -> Site:
    """Return a site whose access points stand up to ``SURVEY_ERROR_M`` off in x and in y."""
    errors = np.random.default_rng(seed).uniform(-SURVEY_ERROR_M, SURVEY_ERROR_M, (len(site.macs), 2))
    moved = [
        replace(one, x_m=one.x_m + float(dx), y_m=one.y_m + float(dy))
        for one, (dx, dy) in zip(site.access_points, errors, strict=True)
    ]
    return replace(site, access_points=tuple(moved))


def other_phones(recordings: Sequence[Recording]) -> dict[str, list[Recording]]:
    """Return what phones that receive and measure otherwise would have recorded."""
    return {
        f"signals {db:+.0f} dB": [
            replace(one, rss_dbm=np.where(one.heard, one.rss_dbm + db, 0.0)) for one in recordings
        ]
        for db in (LOUDER_DB, -LOUDER_DB)
    } | {
        f"ranges {m:+.1f} m": [
            replace(one, slant_m=np.where(one.heard, np.maximum(one.slant_m + m, 0.0), 0.0))
            for one in recordings
        ]
        for m in (LONGER_M, -LONGER_M)
    }


def rows_at(site: str, every: int, data_root: Path) -> list[dict[str, str]]:
    """Return a row for each thing that is done at a site."""
    packed = read_packed(data_root, site)
    artifact = shipped_artifact(SOURCE_ONLY)
    method, offsets = restored(artifact), offsets_of(artifact)
    recordings = [one.where(np.arange(len(one)) % every == 0) for one in packed.recordings()]

    def row(
        kind: str,
        name: str,
        ready: LearnedGridFilter,
        where: Site = packed.site,
        heard: Sequence[Recording] = recordings,
    ) -> dict[str, str]:
        tracks = localize(ready, where, heard, offsets, None)
        cells = {"site": site, "what": kind, "changed": name}
        for device in (1, 2):
            own = [one for one in tracks if one.recording.device == device]
            scores = score([one.unfiltered for one in own], [one.recording.labels_m(LABELS) for one in own])
            cells[f"device {device}, RMSE [m]"] = f"{scores.rmse_m:.2f}"
        return cells

    ready = method.for_plan(packed.plan)
    rows = [row("plan", "none", method)]
    rows += [row("plan", name, method.for_plan(plan)) for name, plan in plans(packed, data_root).items()]
    rows += [row("part", name, one) for name, one in parts_taken(method, packed.plan).items()]
    rows += [
        row("survey", f"up to {SURVEY_ERROR_M} m off, draw {seed}", ready, resurveyed(packed.site, seed))
        for seed in range(SURVEYS)
    ]
    rows += [row("phone", name, ready, heard=heard) for name, heard in other_phones(recordings).items()]
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--data-root", type=Path, default=Path("data"))
    parser.add_argument("--sites", default=",".join(SITES), help="Packed sites, commas between.")
    parser.add_argument("--every", type=int, default=10, help="Every so many-th interval is kept.")
    parser.add_argument("--json", action="store_true", help="Print JSON instead of a table.")
    options = parser.parse_args()
    rows = [
        row for site in options.sites.split(",") for row in rows_at(site, options.every, options.data_root)
    ]
    if options.json:
        print(json.dumps(rows, indent=1))  # noqa: T201
    else:
        print_table(rows)


if __name__ == "__main__":
    main()
