"""``learned-grid`` as an artifact: what it has learned, out of which recordings, and the offset before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from fploc.artifacts import Artifact, ArtifactKey
from fploc.calibration.offsets import RangeOffsets
from fploc.methods.coarse_belief import CoarseSettings
from fploc.methods.learned_grid import LearnedGridFilter, LearnedGridSettings, Trust
from fploc.methods.range_lessons import LessonSettings
from fploc.methods.walk import WalkSettings
from fploc.models.range_error import RangeErrorNetwork

NETWORK = f"{RangeErrorNetwork.__module__}.{RangeErrorNetwork.__qualname__}"


def stored(
    method: LearnedGridFilter,
    offsets: RangeOffsets,
    key: ArtifactKey,
    *,
    sites: Mapping[str, str],
    places: Mapping[str, str],
    recordings: tuple[str, ...],
    data_hash: str,
    command: str,
) -> Artifact:
    """Return what is kept of a method that has learned.

    Args:
        method: The method; its plan is not kept.
        offsets: That its ranges were calibrated with.
        key: What it was made for.
        sites: Hash of the manifest of every packed site that it learned from.
        places: Place of each of these.
        recordings: That it learned from, as ``site/device/recording``.
        data_hash: Hash over all data that it depends on.
        command: The command that makes it.
    """
    lessons = method.settings.lessons
    named = {f"range-error-{index}": network for index, network in enumerate(method.networks)}
    specs = {
        name: {
            "class_path": NETWORK,
            "init_args": {
                "view": network.view.tolist(),
                "sights": network.sights,
                "hidden": lessons.hidden,
                "dropout": lessons.dropout,
            },
        }
        for name, network in named.items()
    }
    return Artifact(
        key=key,
        specs=specs,
        networks=named,
        constants={
            "settings": asdict(method.settings),
            "offsets": asdict(offsets),
            "sites": dict(sites),
            "places": dict(places),
        },
        data_hash=data_hash,
        recordings=recordings,
        command=command,
    )


def restored(artifact: Artifact) -> LearnedGridFilter:
    """Return the method that ``stored`` kept, without a plan."""
    kept = artifact.constants["settings"]
    coarse = kept["coarse"]
    settings = LearnedGridSettings(
        **{
            **kept,
            "coarse": CoarseSettings(**{**coarse, "walk": WalkSettings(**coarse["walk"])}),
            "lessons": LessonSettings(**kept["lessons"]),
            "clear": Trust(**kept["clear"]),
            "walled": Trust(**kept["walled"]),
        }
    )
    networks = [one for one in artifact.networks.values() if isinstance(one, RangeErrorNetwork)]
    return LearnedGridFilter(settings, [one.requires_grad_(False) for one in networks])


def learned_places(artifact: Artifact) -> set[str]:
    """Return the places that a kept method learned at."""
    return set(artifact.constants["places"].values())
