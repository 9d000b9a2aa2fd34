"""Published labels of laps that have only a raw log: joined from the long table of the site."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from fploc.raw.lap import Lap
from fploc.sites.site import Site


def join_published(lap: Lap, long_table: pd.DataFrame, site: Site, lap_name: str) -> Lap:
    """Return the lap with the labels of the long table's epochs that hold the same RSS of the same APs.

    The long table has no time: an epoch and a reading set belong together where the RSS of every access
    point is equal; where that happens several times, in the order of their occurrence. Sets without an epoch
    keep NaN.

    Args:
        lap: A raw log.
        long_table: From ``fploc.raw.long_table.read_long_table``.
        site: Its access points; the table's AP numbers count them from 1.
        lap_name: Number of the lap, the table's ``lap``.
    """
    rows = long_table[(long_table["lap"].astype(str) == lap_name) & (long_table["rss_dbm"] != 0)]
    mac = pd.Series(site.macs, index=np.arange(1, len(site.macs) + 1))
    epochs = pd.DataFrame(
        {"at": rows["epoch"], "mac": rows["ap_number"].map(mac), "rss": rows["rss_dbm"].astype("int64")}
    )
    sets = pd.DataFrame(
        {
            "at": lap.readings["set"],
            "mac": lap.readings["mac"],
            "rss": lap.readings["rss_dbm"].astype("int64"),
        }
    )
    positions = rows.groupby("epoch")[["x_m", "y_m"]].first()
    left, right = _keyed(sets, "set"), _keyed(epochs, "epoch")
    joined = left.merge(right, on=["key", "occurrence"])
    labelled = lap.sets.copy()
    labelled.loc[joined["set"], ["x_m", "y_m"]] = positions.loc[joined["epoch"]].to_numpy()
    return replace(lap, sets=labelled)


def _keyed(cells: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return one row per reading set: its RSS as one text, and how often that text came before."""
    texts = cells["mac"].astype(str) + " " + cells["rss"].astype(str)
    ordered = cells.assign(text=texts).sort_values(["at", "mac"], kind="stable")
    keys = ordered.groupby("at", sort=True)["text"].agg(";".join)
    return pd.DataFrame(
        {name: keys.index, "key": keys.to_numpy(), "occurrence": keys.groupby(keys).cumcount().to_numpy()}
    )
