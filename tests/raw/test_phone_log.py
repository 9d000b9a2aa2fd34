from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.errors import BadFileError, MissingFileError, UnknownNameError
from fploc.raw.phone_log import read_duration_ms, read_phone_log
from fploc.sites.site import Site

HEADER = (
    "Number,RTT_TIMESTAMP,RTT_RESULT,IMU_TIMESTAMP,Accx,Accy,Accz,Gyrox,Gyroy,Gyroz,Magx,Magy,Magz,"
    "Azimuth,Pitch,Roll"
)
IMU = "0.1,0.2,9.8,0.01,0.02,3.0E-4,20,30,-40,1.5,0.1,-0.1"
ONE = "b0:e4:d5:39:26:89, 1270, 56, -45"
TWO = "cc:f4:11:8b:29:4d, -227351, 795, -50"


def write(path: Path, rows: list[tuple[str, str, str]], header: str = HEADER, tail: str = "") -> Path:
    lines = [f'{i},{ns},"{result}",{imu_ns},{IMU}{tail}' for i, (ns, result, imu_ns) in enumerate(rows)]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def test_a_reading_set_is_read_once(tmp_path: Path, site: Site) -> None:
    path = write(
        tmp_path / "log.csv",
        [
            ("1000000000", f"[{ONE}, {TWO}]", "1000000001"),
            ("1000000000", f"[{ONE}, {TWO}]", "1200000000"),
            ("1300000000", "[]", "1300000002"),
            ("1550000000", f"[{ONE}]", "1500000000"),
        ],
    )
    lap = read_phone_log(path, site)
    assert lap.is_slant
    assert lap.sets["t_ms"].tolist() == [0.0, 300.0, 550.0] and lap.sets["line"].tolist() == [2, 4, 5]
    assert lap.readings["set"].tolist() == [0, 0, 2]
    assert lap.readings["mac"].tolist() == [site.macs[0], site.macs[1], site.macs[0]]
    assert lap.readings["range_m"].tolist() == [1.27, -227.351, 1.27]
    assert lap.readings["std_m"].tolist() == [0.056, 0.795, 0.056]
    assert lap.readings["rss_dbm"].tolist() == [-45, -50, -45]
    assert lap.sets[["x_m", "y_m"]].isna().all(axis=None)


def test_doubly_wrapped_list_of_2022_with_rounded_times(tmp_path: Path, site: Site) -> None:
    wrapped = [(f"['[{ONE}]']", "6.3552E+14"), (f"['[{TWO}]']", "6.3552E+14")]
    path = write(tmp_path / "lab1.csv", [(ns, result, ns) for result, ns in wrapped])
    lap = read_phone_log(path, site)
    assert lap.sets["t_ms"].tolist() == [0.0, 0.0]
    assert lap.readings["mac"].tolist() == list(site.macs[:2])


def test_points_are_ground_truth_named_or_not(tmp_path: Path, site: Site) -> None:
    rows = [("1000000000", f"[{ONE}]", "1"), ("1300000000", f"[{TWO}]", "2")]
    for name, header in (("named", "Points,x,y,"), ("unnamed", "Points,,")):
        tail = ",0,22.161,20.159" + ("," if name == "named" else "")
        lap = read_phone_log(write(tmp_path / name, rows, f"{HEADER},{header}", tail), site)
        assert lap.sets[["x_m", "y_m"]].to_numpy().tolist() == [[22.161, 20.159]] * 2
    without = read_phone_log(write(tmp_path / "office", rows, f"{HEADER},Points,", ",0,"), site)
    assert without.sets["x_m"].isna().all()


def test_upper_case_macs_are_the_same(tmp_path: Path, site: Site) -> None:
    path = write(tmp_path / "log.csv", [("1", f"[{ONE.upper()}]", "1")])
    assert read_phone_log(path, site).readings["mac"].tolist() == [site.macs[0]]


@pytest.mark.parametrize(
    ("result", "where"),
    [
        ("[b0:e4:d5:39:26:89, abc, 56, -45]", "line 3, column RTT_RESULT"),
        ("[b0:e4:d5:39:26:89, 1270, 56]", "line 3, column RTT_RESULT"),
        ("[b0:e4:d5:39:26, 1270, 56, -45]", "line 3, column RTT_RESULT"),
        (f"[{ONE}, b0:e4:d5:39:2", "line 3, column RTT_RESULT"),
        ("[nan]", "line 3, column RTT_RESULT"),
    ],
    ids=["text", "short", "mac", "cut", "nan"],
)
def test_bad_result_is_named(tmp_path: Path, site: Site, result: str, where: str) -> None:
    path = write(tmp_path / "log.csv", [("1", f"[{ONE}]", "1"), ("2", result, "2")])
    with pytest.raises(BadFileError, match=where):
        read_phone_log(path, site)


def test_unknown_mac_is_named_with_its_line(tmp_path: Path, site: Site) -> None:
    path = write(
        tmp_path / "log.csv", [("1", f"[{ONE}]", "1"), ("2", "[00:11:22:33:44:55, 1270, 56, -45]", "2")]
    )
    with pytest.raises(
        UnknownNameError, match=r"log.csv, line 3, MAC.*'00:11:22:33:44:55', expected one of b0:"
    ):
        read_phone_log(path, site)


def test_bad_numbers_columns_and_files(tmp_path: Path, site: Site) -> None:
    with pytest.raises(BadFileError, match="line 2, column RTT_TIMESTAMP: found 'soon'"):
        read_phone_log(write(tmp_path / "a.csv", [("soon", f"[{ONE}]", "1")]), site)
    with pytest.raises(BadFileError, match="column RTT_RESULT"):
        read_phone_log(
            write(tmp_path / "b.csv", [("1", f"[{ONE}]", "1")], HEADER.replace("RTT_RESULT", "RESULT")), site
        )
    with pytest.raises(BadFileError, match="column magy"):
        read_phone_log(write(tmp_path / "c.csv", [("1", f"[{ONE}]", "1")], HEADER.replace("Magy", "M")), site)
    with pytest.raises(MissingFileError, match="raw phone log"):
        read_phone_log(tmp_path / "none.csv", site)


def test_truncated_log_is_refused(tmp_path: Path, site: Site) -> None:
    path = write(tmp_path / "log.csv", [("1", f"[{ONE}]", "1"), ("2", f"[{TWO}]", "2")])
    path.write_text(path.read_text()[:-90])
    with pytest.raises(BadFileError, match=r"log\.csv"):
        read_phone_log(path, site)


@pytest.mark.parametrize("digits", [11, 10, 8, 0])
def test_duration_survives_rounded_times(tmp_path: Path, site: Site, digits: int) -> None:
    """1,000 rows of 203 ms: rounding to as much as 100 s moves the duration by at most one row in a step."""
    times = 1.5e13 + np.arange(1000) * 203e6
    rounded = np.round(times / 10**digits) * 10**digits
    rows = [(f"{ns:.0f}", f"[{ONE}]", f"{ns:.0f}") for ns in rounded]
    duration = read_duration_ms(write(tmp_path / "log.csv", rows))
    assert duration == pytest.approx(999 * 203.0, rel=3e-3)


def test_duration_of_a_log_without_times_cannot_be_told(tmp_path: Path) -> None:
    rows = [("1.3E+13", f"[{ONE}]", "1.3E+13")] * 5
    assert read_duration_ms(write(tmp_path / "log.csv", rows)) is None
