"""The default method as it comes with the package: trained, ready for any site.

Two artifacts lie in ``fploc/pretrained/``, written by ``fploc model``: one that learned at all local public sites,
for users, and one that learned at the office alone, for the protocols that allow no more.

Axes: A access points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch

from fploc.artifacts import Artifact, ArtifactKey, load_shipped, offsets_of
from fploc.errors import UnknownNameError
from fploc.floorplan.plan import FloorPlan
from fploc.intervals import Intervals
from fploc.localizer import Localizer
from fploc.methods.learned_grid import NAME
from fploc.methods.stored_grid import restored
from fploc.sites.site import Site

DEFAULT = "default"
"""What users get: name of a method that resolves to ``NAME``, trained before."""
MODEL = "model"
"""Stands in the keys of its artifacts where others name their preset."""
ANY_SITE = "any-site"
SEED = 0
POOLED = ArtifactKey(NAME, "zero-shot-pooled", ANY_SITE, MODEL, SEED)
SOURCE_ONLY = ArtifactKey(NAME, "zero-shot", ANY_SITE, MODEL, SEED)
PRETRAINED = Path(__file__).parent / "pretrained"
SHIPPING_COMMAND = "fploc model --out fploc/pretrained"


@dataclass(frozen=True)
class Reading:
    """What a device heard of one access point.

    Args:
        range_slant_m: Range as the phone gave it, metres; the access point counts as silent where it is not above 0.
        rss_dbm: Received signal strength, dBm.
        range_std_m: The phone's own spread of the range, metres; NaN or 0 where unknown.
    """

    range_slant_m: float
    rss_dbm: float
    range_std_m: float = 0.0


def shipped_artifact(key: ArtifactKey) -> Artifact:
    """Return the artifact ``POOLED`` or ``SOURCE_ONLY``.

    Raises:
        MissingArtifactError: If the package came without it.
    """
    return load_shipped(PRETRAINED, key, command=SHIPPING_COMMAND)


def leave_one_out_key(site: str) -> ArtifactKey:
    """Return the key of the default method for a site that ``POOLED`` learned at: trained without its place."""
    return ArtifactKey(NAME, POOLED.protocol, site, MODEL, SEED)


def model_command(site: str) -> str:
    """Return the command that makes the artifact of ``leave_one_out_key``."""
    return f"fploc model --sites {site}"


def shipped_localizer(site: Site, plan: FloorPlan | None) -> Localizer:
    """Return the default method, trained at all local public sites, at a site of one's own.

    Args:
        site: Its access points.
        plan: Its floor plan; None where there is none.
    """
    artifact = shipped_artifact(POOLED)
    method = restored(artifact)
    ready = method if plan is None else method.for_plan(plan)
    return Localizer(ready, site, offsets_of(artifact))


def reading_set(localizer: Localizer, readings: Mapping[str, Reading], t_s: float = 0.0) -> Intervals:
    """Return the readings of one device at one time as an interval that ``Localizer.advance`` takes.

    Args:
        localizer: That is to localize the device.
        readings: By MAC of the access point.
        t_s: The device's time, seconds.

    Raises:
        UnknownNameError: If the site has no access point of such a MAC.
    """
    macs = localizer.site.macs
    for mac in readings:
        if mac not in macs:
            raise UnknownNameError(
                f"access point of {localizer.site.name}",
                mac,
                known=list(macs),
                way_out="add it to the site, or leave its reading out",
            )
    silent = Reading(0.0, 0.0)
    columns = [readings.get(mac, silent) for mac in macs]
    values = [[one.range_slant_m, one.range_std_m, one.rss_dbm] for one in columns]
    slant, stds, rss = torch.tensor(values, dtype=torch.float64).T[:, None].nan_to_num(nan=0.0)
    return localizer.calibrated(torch.tensor([t_s], dtype=torch.float64), slant, stds, rss)
