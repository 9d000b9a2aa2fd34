from __future__ import annotations

from pathlib import Path

import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.raw.device_link import read_device_link

HEADER = "Time Stamp (ms),M1-M2 RTT Distance (m),RTT std (m),RSS (dBm)"


def test_raw_range_is_taken_and_made_up_columns_are_left(tmp_path: Path) -> None:
    path = tmp_path / "rtt-log.csv"
    path.write_text(
        HEADER + ",real_distance,rtt_kalman\r\n0,-1.2,0.27,-66,4.8,0.2\r\n518,5.4,0.1,-61,4.8,0.3\r\n"
    )
    log = read_device_link(path)
    assert list(log.columns) == ["line", "t_ms", "range_m", "std_m", "rss_dbm"]
    assert log["range_m"].tolist() == [-1.2, 5.4] and log["t_ms"].tolist() == [0.0, 518.0]


@pytest.mark.parametrize(
    ("text", "where"),
    [
        (HEADER + "\n0,far,0.2,-66\n", "line 2, column M1-M2 RTT Distance"),
        (HEADER + "\n0,1.5,0.2,-66\n5,1.5\n", "line 3, column RTT std .*cut off"),
        (HEADER.replace("RSS", "Level") + "\n0,1.5,0.2,-66\n", r"column RSS \(dBm\)"),
        (HEADER + "\n", "whole file"),
    ],
    ids=["text", "truncated", "column", "no-rows"],
)
def test_bad_input_is_named(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "rtt-log.csv"
    path.write_text(text)
    with pytest.raises(BadFileError, match=where):
        read_device_link(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="link between devices"):
        read_device_link(tmp_path / "rtt-log.csv")
