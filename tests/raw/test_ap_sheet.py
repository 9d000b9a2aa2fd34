from __future__ import annotations

from pathlib import Path

import openpyxl
import pytest

from fploc.errors import BadFileError, MissingFileError
from fploc.raw.ap_sheet import read_ap_sheet


def workbook(path: Path, rows: list[list[object]]) -> Path:
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.save(path)
    return path


def test_csv_with_bom(tmp_path: Path) -> None:
    path = tmp_path / "AP_idx.csv"
    path.write_bytes("\ufeff,x,y\r\nAP1,-14.44,-11.03\r\nAP2,0,0\r\n".encode())
    assert read_ap_sheet(path).access_points == {"AP1": (-14.44, -11.03), "AP2": (0.0, 0.0)}


def test_table_form_of_xlsx(tmp_path: Path) -> None:
    path = workbook(tmp_path / "a.xlsx", [[None, "x", "y"], ["AP1", 35.5, 14.01], [None, None, None]])
    assert read_ap_sheet(path).access_points == {"AP1": (35.5, 14.01)}


def test_wide_form_with_full_width_brackets_macs_and_corners(tmp_path: Path) -> None:
    path = workbook(
        tmp_path / "a.xlsx",
        [
            ["AP1", "AP2", "point A"],
            ["（27.695，14.68）", "(29.30, 5.67)", "(9.99,-16.329)"],
            ['AP1_Mac = "b0:e4:d5:39:26:89"'],
            ["AP2_Mac = “CC:f4:11:8b:29:4d”"],
        ],
    )
    sheet = read_ap_sheet(path)
    assert sheet.access_points == {"AP1": (27.695, 14.68), "AP2": (29.3, 5.67)}
    assert sheet.macs == {"AP1": "b0:e4:d5:39:26:89", "AP2": "cc:f4:11:8b:29:4d"}
    assert sheet.corners == {"point A": (9.99, -16.329)}


@pytest.mark.parametrize(
    ("rows", "where"),
    [
        ([["AP1"], ["27.695 14.68"]], "row 2, column AP1"),
        ([[None, "x", "y"], ["AP1", "far", 1]], "row 2, column x: found \"'far'\"|row 2, column x"),
        ([[None, "x", "y"], ["AP1", None, 1]], "row 2, column x"),
        ([[None, "x", "y"]], "first column"),
        ([], "whole file"),
    ],
    ids=["point", "text", "empty", "no-aps", "nothing"],
)
def test_bad_cell_is_named(tmp_path: Path, rows: list[list[object]], where: str) -> None:
    with pytest.raises(BadFileError, match=where):
        read_ap_sheet(workbook(tmp_path / "a.xlsx", rows))


def test_lock_file_text_and_missing_file(tmp_path: Path) -> None:
    lock = tmp_path / "~$AP_location.xlsx"
    lock.write_bytes(b"\x05user" + bytes(160))
    with pytest.raises(BadFileError, match="lock file of an office program"):
        read_ap_sheet(lock)
    text = tmp_path / "list.xlsx"
    text.write_text("AP1 0 0")
    with pytest.raises(BadFileError, match="xlsx"):
        read_ap_sheet(text)
    with pytest.raises(MissingFileError):
        read_ap_sheet(tmp_path / "none.csv")
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("name,east,north\nAP1,1,2\n")
    with pytest.raises(BadFileError, match="column x"):
        read_ap_sheet(wrong)


def test_public_list_keeps_macs_and_corner_points(source: Path) -> None:
    sheet = read_ap_sheet(
        source / "2b19c6c" / "raw_data" / "Shopping Mall" / "Shopping mall AP coordinates.xlsx"
    )
    assert sheet.access_points["AP7"] == (-13.18, 4.74) and len(sheet.access_points) == 6
    assert sheet.corners["A6"] == (13.46, -0.54) and len(sheet.corners) == 6
    assert sheet.macs["AP8"] == "14:22:3b:16:5a:bd"
