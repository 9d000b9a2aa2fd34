from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.raw.long_table import read_long_table
from fploc.sites.registry import load_spec

HEADER = "real_dis,RTT,RTT std,RSS,AP_idx,class_idx,AP_x,AP_y,circle,user,true_x,true_y"


@pytest.mark.parametrize(
    ("text", "where"),
    [
        (HEADER + "\n1,2,0.1,-58,one,0,0,0,2,1,0,0\n", "line 2, column AP_idx: found 'one'"),
        (HEADER + "\n1,2,0.1,-58,1.5,0,0,0,2,1,0,0\n", "line 2, column AP_idx: found 1.5"),
        (HEADER + "\n1,2,0.1,-58,1,0,0,0,2,1,0,0\n1,2,0.1\n", "line 3, column RSS: found nothing"),
        (HEADER.replace("class_idx", "epoch") + "\n1,2,0.1,-58,1,0,0,0,2,1,0,0\n", "column class_idx"),
    ],
    ids=["text", "fraction", "truncated", "column"],
)
def test_bad_input_is_named(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "dataset.csv"
    path.write_text(text)
    with pytest.raises(BadFileError, match=where):
        read_long_table(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="long table"):
        read_long_table(tmp_path / "dataset.csv")


def test_library_table_agrees_with_itself(source: Path) -> None:
    """The true distance is that from the label to the AP, whose number counts the site's six APs."""
    table = read_long_table(source / "2b19c6c" / "clean_data" / "dataset_Library.csv")
    site = load_spec("library").site
    assert len(table) > 40_000
    assert set(table["device"]) == {1, 2} and set(table["lap"]) == {2, 4, 5, 6}
    at = site.positions_m[table["ap_number"] - 1]
    known = (table["true_distance_m"] > 0).to_numpy()
    np.testing.assert_allclose(table.loc[known, ["ap_x_m", "ap_y_m"]], at[known])
    distance = np.linalg.norm(table[["x_m", "y_m"]].to_numpy() - at, axis=1)
    np.testing.assert_allclose(table.loc[known, "true_distance_m"], distance[known], atol=0.01)
