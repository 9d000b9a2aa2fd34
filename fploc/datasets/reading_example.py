"""How a packed site is read with pandas and nothing of ours, in ten lines."""

from __future__ import annotations


def reading_example(folder: str) -> str:
    """Return a program that prints the median range error of each access point of the packed site ``folder``."""
    return f"""\
import json, pathlib
import pandas as pd

folder = pathlib.Path("{folder}")
aps = pd.DataFrame(json.loads((folder / "site.json").read_text("utf-8"))["access_points"]).set_index("mac")
readings = pd.read_parquet(folder / "readings.parquet")  # one row for each access point heard in an interval
labels = pd.read_parquet(folder / "intervals.parquet")  # one row for each interval, ground truth with it
rows = readings.merge(labels, on=["device", "recording", "interval"]).join(aps, on="mac")
true_m = ((rows["x_repaired_m"] - rows["x_m"]) ** 2 + (rows["y_repaired_m"] - rows["y_m"]) ** 2) ** 0.5
error_m = rows["range_plan_m"] - true_m  # offsets are not removed: all errors are too long
print(error_m.groupby([rows["name"], rows["device"]]).median().unstack().round(2))
"""
