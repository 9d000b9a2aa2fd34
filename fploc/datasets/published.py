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
    point is equal; where that happens several times, in the order of their occurrence. A set between two of
    these takes the label between theirs, linear in time, as the authors made all labels; before the first
    and after the last there is none (NaN).

    Args:
        lap: A raw log.
        long_table: From ``fploc.raw.long_table.read_long_table``.
        site: Its access points; the table's AP numbers count them from 1.
        lap_name: Number of the lap, the table's ``lap``.
    """
    rows = long_table[(long_table["lap"].astype(str) == lap_name) & (long_table["rss_dbm"] != 0)]
    mac = pd.Series(site.macs, index=np.arange(1, len(site.macs) + 1))
    epochs = pd.DataFrame(
        {"at": rows["epoch"], "mac": rows["ap_number"].map(mac), "rss_dbm": rows["rss_dbm"]}
    )
    # The authors left out ranges that cannot be projected (not longer than the height difference), and those
    # beyond a limit of each table, which its longest range stands for.
    heights = dict(zip(site.macs, site.height_differences_m, strict=True))
    height = lap.readings["mac"].map(heights)
    longest = np.hypot(long_table["range_m"].max(), height)
    heard = lap.readings[lap.readings["range_m"].between(height, longest, inclusive="right")]
    sets = heard.rename(columns={"set": "at"})[["at", "mac", "rss_dbm"]]
    joined = _keyed(sets, "set").merge(_keyed(epochs, "epoch"), on=["key", "occurrence"]).sort_values("set")
    if joined.empty:
        return lap
    positions = rows.groupby("epoch")[["x_m", "y_m"]].first().loc[joined["epoch"]]
    t_ms = lap.sets["t_ms"]
    known = t_ms.loc[joined["set"]]
    labels = {
        axis: np.interp(t_ms, known, positions[axis], left=np.nan, right=np.nan) for axis in ("x_m", "y_m")
    }
    return replace(lap, sets=lap.sets.assign(**labels))


def _keyed(cells: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return one row per reading set: its RSS as one text, and how often that text came before."""
    texts = cells["mac"].astype(str) + " " + cells["rss_dbm"].astype("int64").astype(str)
    ordered = cells.assign(text=texts).sort_values(["at", "mac"], kind="stable")
    keys = ordered.groupby("at", sort=True)["text"].agg(";".join)
    return pd.DataFrame(
        {name: keys.index, "key": keys.to_numpy(), "occurrence": keys.groupby(keys).cumcount().to_numpy()}
    )
