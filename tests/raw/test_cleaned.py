from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.raw.cleaned import read_cleaned
from fploc.sites.registry import load_spec
from fploc.sites.site import Site

IMU = "AccX,AccY,AccZ,GyroX,GyroY,GyroZ,MagX,MagY,MagZ,Azimuth,Pitch,Roll"
IMU_VALUES = "0.1,0.2,9.8,0.01,0.02,0.03,20,30,-40,1.5,0.1,-0.1"


def header(numbers: list[int], label: str) -> str:
    aps = [
        f"AP{n} True Distance (m),AP{n} RTT Distance (m),AP{n} RTT std (m),AP{n} RSS (dBm)" for n in numbers
    ]
    return ",".join(["M1 Time Stamp (ms)", *aps, IMU, label])


def write(path: Path, numbers: list[int], rows: list[str], label: str = "M1 Ground Truth") -> Path:
    path.write_text("\r\n".join([header(numbers, label), *rows]) + "\r\n")
    return path


def row(t_ms: str, cells: list[str], label: str = '"[1.0, 2.5]"') -> str:
    return ",".join([t_ms, *cells, IMU_VALUES, label])


HEARD = "1.0,3.5,0.1,-50"
UNHEARD = "0,0,0,0"


def test_rows_keep_what_the_file_says(tmp_path: Path, site: Site) -> None:
    path = write(
        tmp_path / "113.csv",
        [1, 2, 5],
        [row("40", [HEARD, UNHEARD, "2,7.25,0,-71"]), row("340.5", [UNHEARD] * 3)],
    )
    lap = read_cleaned(path, site)
    assert not lap.is_slant
    assert lap.sets["t_ms"].tolist() == [0.0, 300.5] and lap.sets["line"].tolist() == [2, 3]
    assert lap.sets[["x_m", "y_m"]].to_numpy().tolist() == [[1.0, 2.5]] * 2
    assert lap.sets["gyro_z_radps"].tolist() == [0.03] * 2
    assert lap.readings["mac"].tolist() == [*site.macs] * 2
    assert lap.readings["range_m"].tolist() == [3.5, 0, 7.25, 0, 0, 0]
    assert lap.readings["rss_dbm"].tolist() == [-50, 0, -71, 0, 0, 0]
    assert lap.readings["true_distance_m"].tolist() == [1.0, 0, 2.0, 0, 0, 0]


def test_labels_in_two_columns_with_user_and_circle(tmp_path: Path, site: Site) -> None:
    label = "M1 Ground Truth_x,M1 Ground Truth_y,user,circle"
    path = write(tmp_path / "724.csv", [1, 2, 5], [row("0", [HEARD] * 3, "22.5,-0.5,1,7")], label)
    assert read_cleaned(path, site).sets[["x_m", "y_m"]].to_numpy().tolist() == [[22.5, -0.5]]


@pytest.mark.parametrize(
    ("numbers", "cells"),
    [
        ([1, 2, 5], ["0,1,0,-1", "0,2,0,-2", "0,3,0,-3"]),
        ([1, 2, 3], ["0,1,0,-1", "0,2,0,-2", "0,3,0,-3"]),
        ([1, 2, 3, 4, 5], ["0,1,0,-1", "0,2,0,-2", UNHEARD, UNHEARD, "0,3,0,-3"]),
        ([1, 2, 3, 4, 5], ["0,1,0,-1", "0,2,0,-2", "0,3,0,-3", UNHEARD, UNHEARD]),
    ],
    ids=["names", "compact", "names-with-gaps", "compact-with-empty-columns"],
)
def test_columns_map_to_macs(tmp_path: Path, site: Site, numbers: list[int], cells: list[str]) -> None:
    readings = read_cleaned(write(tmp_path / "113.csv", numbers, [row("0", cells)]), site).readings
    assert dict(zip(readings["mac"], readings["range_m"], strict=True)) == dict(
        zip(site.macs, (1.0, 2.0, 3.0), strict=True)
    )


@pytest.mark.parametrize(
    ("numbers", "cells", "numbering"),
    [
        ([1, 2], [HEARD] * 2, "auto"),
        ([1, 2, 3, 4, 5], [HEARD] * 5, "auto"),
        ([1, 2, 3], [HEARD] * 3, "names"),
        ([1, 2, 5], [HEARD] * 3, "compact"),
    ],
)
def test_columns_of_other_access_points_are_refused(
    tmp_path: Path, site: Site, numbers: list[int], cells: list[str], numbering: str
) -> None:
    path = write(tmp_path / "113.csv", numbers, [row("0", cells)])
    with pytest.raises(BadFileError, match=r"113\.csv, header: found columns AP1, AP2.*numbering"):
        read_cleaned(path, site, numbering=numbering)


@pytest.mark.parametrize(
    ("bad", "where"),
    [
        (row("0", ["1,abc,0,-50", HEARD, HEARD]), "line 3, column AP1 RTT Distance \\(m\\): found 'abc'"),
        (
            row("0", ["1,,0,-50", HEARD, HEARD]),
            "line 3, column AP1 RTT Distance \\(m\\): found nothing \\(empty or NaN",
        ),
        (row("nan", [HEARD] * 3), "line 3, column M1 Time Stamp \\(ms\\): found nothing \\(empty or NaN"),
        (row("0", ["1,inf,0,-50", HEARD, HEARD]), "line 3, column AP1 RTT Distance"),
        (row("0", [HEARD] * 3, '"[1.0]"'), "line 3, column M1 Ground Truth"),
        (row("0", [HEARD] * 3, '"[1.0, x]"'), "line 3, column M1 Ground Truth"),
        ("500,1.0,3.5", "line 3, column AP1 RTT std \\(m\\): found nothing \\(the row is cut off\\)"),
        ('500,1.0,3.5,"[1', "whole file"),
        (row("0", [HEARD] * 5), "whole file: found .*line 3"),
    ],
    ids=["text", "empty", "nan", "inf", "label", "label-text", "truncated", "open-quote", "long-row"],
)
def test_bad_cell_is_named(tmp_path: Path, site: Site, bad: str, where: str) -> None:
    path = write(tmp_path / "113.csv", [1, 2, 5], [row("0", [HEARD] * 3), bad])
    with pytest.raises(BadFileError, match=where):
        read_cleaned(path, site)


@pytest.mark.parametrize(
    ("old", "new", "column"),
    [
        ("AP2 RSS (dBm)", "AP2 Level", "AP2 RSS"),
        ("M1 Time Stamp (ms)", "when", "Time Stamp"),
        ("M1 Ground Truth", "place", "Ground Truth_x"),
        ("AP", "BS", "AP1 RTT Distance"),
    ],
)
def test_missing_column_is_named(tmp_path: Path, site: Site, old: str, new: str, column: str) -> None:
    path = write(tmp_path / "113.csv", [1, 2, 5], [row("0", [HEARD] * 3)])
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(BadFileError, match=f"column {column}"):
        read_cleaned(path, site)


def test_files_that_are_none(tmp_path: Path, site: Site) -> None:
    with pytest.raises(MissingFileError, match="cleaned lap"):
        read_cleaned(tmp_path / "none.csv", site)
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe\x00" * 9)
    (tmp_path / "header.csv").write_text(header([1, 2, 5], "M1 Ground Truth") + "\n")
    for name in ("empty.csv", "image.csv", "header.csv"):
        with pytest.raises(BadFileError, match=f"{name}, whole file"):
            read_cleaned(tmp_path / name, site)


def test_empty_rows_of_a_spreadsheet_are_no_rows(tmp_path: Path, site: Site) -> None:
    path = write(tmp_path / "113.csv", [1, 2, 5], [row("0", [HEARD] * 3), "," * 25])
    assert len(read_cleaned(path, site).sets) == 1


def test_golden_rows_of_the_paper(source: Path) -> None:
    """Rows 1 and 2 of lab1_mod.csv; the paper misprints 14.47 as 14.75 and the std 0.345 as 0.055."""
    spec = load_spec("office")
    lap = read_cleaned(spec.locate(spec.recordings[0].files[0], source), spec.site)
    columns = ["true_distance_m", "range_m", "std_m", "rss_dbm"]
    first, second = (lap.readings[lap.readings["set"] == index][columns].to_numpy() for index in (0, 1))
    np.testing.assert_allclose(first[0], [4.46, 1.17, 0.056, -45], atol=5e-3)
    np.testing.assert_allclose(first[1], [18.05, 14.47, 0.11, -69], atol=5e-3)
    np.testing.assert_allclose(second[0], [4.43, 0.58, 0.345, -46], atol=5e-3)
    np.testing.assert_allclose(second[1], [18.02, 14.27, 0.055, -68], atol=5e-3)
    assert lap.sets["t_ms"].iloc[1] == pytest.approx(267.1, abs=0.05)
    assert lap.sets[["x_m", "y_m"]].iloc[0].tolist() == [31.0, 13.75]
    np.testing.assert_allclose(lap.sets[["x_m", "y_m"]].iloc[1], [31.0349, 13.75], atol=1e-4)
    np.testing.assert_allclose(lap.sets[["acc_x_mps2", "acc_z_mps2"]].iloc[0], [0.6096, 9.783], atol=1e-4)
