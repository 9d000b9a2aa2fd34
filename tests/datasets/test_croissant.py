"""croissant.json of a packed site: loaded by mlcroissant, checked against the tables it describes."""

from __future__ import annotations

import hashlib
import json
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fploc.datasets.build import build_sites
from fploc.datasets.croissant import FILE_NAME, validate_croissant, write_croissant
from fploc.datasets.origin import AUTHORS, CITATION
from fploc.datasets.packed import packed_folder
from fploc.errors import BadFileError, MissingFileError
from fploc.schema import SCHEMA_VERSION, TABLES, Table

SITE = {
    "name": "office",
    "made_up": False,
    "description": "The office floor.",
    "faults": [{"where": "lab3", "what": "No AP3.", "verdict": "kept"}],
    "repairs": {"seam": {"kind": "seam", "constants": {}, "origin": "fitted to turns"}},
}
MANIFEST = {
    "schema_version": SCHEMA_VERSION,
    "files": {},
    "made_up": False,
    "sources": [{"path": "0bdeb2a/Office with One UE/circle1/lab1_mod.csv"}],
    "totals": {"device1": {"intervals": 3, "rows": 5}},
}


def table_of(table: Table, rows: int) -> pd.DataFrame:
    """A frame of ``rows`` rows that keeps the contract of ``table``."""
    columns = {}
    for column in table.columns:
        if column.dtype == "str":
            columns[column.name] = pd.Series([f"{row:02d}" for row in range(rows)], dtype="str")
        else:
            numbers = np.full(rows, -50.0 if column.name == "rss_dbm" else 1.0)
            columns[column.name] = pd.Series(numbers).astype(column.dtype)
    frame = pd.DataFrame(columns)
    if "t_ms" in frame:
        frame["t_ms"] = np.arange(rows, dtype=np.float64)
    if "x_repaired_m" in frame:
        frame.loc[1, "x_repaired_m"] = np.nan
    return table.check(frame, "made here")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "office"
    folder.mkdir()
    for table in TABLES:
        table_of(table, rows=3).to_parquet(folder / f"{table.name}.parquet", index=False)
    (folder / "site.json").write_text(json.dumps(SITE))
    (folder / "manifest.json").write_text(json.dumps(MANIFEST))
    return folder


def test_mlcroissant_finds_nothing_to_say(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_croissant(folder)
    validate_croissant(folder)
    assert not [record for record in caplog.records if "mlcroissant" in record.pathname]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_records_are_the_rows_of_the_tables(folder: Path, table: Table) -> None:
    import mlcroissant

    write_croissant(folder)
    records = list(mlcroissant.Dataset(jsonld=folder / FILE_NAME).records(table.name))
    expected = pd.read_parquet(folder / f"{table.name}.parquet")
    assert len(records) == 3
    for column in table.columns:
        found = [record[f"{table.name}/{column.name}"] for record in records]
        if column.dtype == "str":
            assert [value.decode() for value in found] == expected[column.name].tolist()
        else:
            np.testing.assert_array_equal(np.array(found, float), expected[column.name].to_numpy(float))


def test_a_built_site_is_read_offline_by_mlcroissant(source: Path, tmp_path: Path) -> None:
    import mlcroissant

    (report,) = build_sites(source, tmp_path, ["laboratory"])
    validate_croissant(report.folder)
    records = mlcroissant.Dataset(jsonld=report.folder / FILE_NAME).records("intervals")
    expected = pd.read_parquet(report.folder / "intervals.parquet")
    for record, row in zip(islice(records, 200), expected.itertuples(), strict=False):
        assert record["intervals/recording"].decode() == row.recording
        assert record["intervals/t_ms"] == row.t_ms
        assert record["intervals/x_repaired_m"] == row.x_repaired_m


def test_files_carry_their_hash_and_only_present_ones_are_named(folder: Path) -> None:
    metadata = json.loads(write_croissant(folder).read_text())
    files = {file["contentUrl"]: file for file in metadata["distribution"]}
    assert set(files) == {path.name for path in folder.iterdir()} - {FILE_NAME}
    for name, file in files.items():
        contents = (folder / name).read_bytes()
        assert file["sha256"] == hashlib.sha256(contents).hexdigest()
        assert file["contentSize"] == f"{len(contents)} B"


def test_licence_and_authors_are_named_and_a_made_up_building_cites_nobody(folder: Path) -> None:
    measured = json.loads(write_croissant(folder).read_text())
    assert measured["citeAs"] == CITATION and "MIT" in measured["license"]
    assert [one["name"] for one in measured["creator"]] == [" ".join(name) for name in AUTHORS]
    (folder / "manifest.json").write_text(json.dumps(MANIFEST | {"made_up": True}))
    made_up = json.loads(write_croissant(folder).read_text())
    assert "citeAs" not in made_up and "creator" not in made_up
    assert "no measurement" in made_up["description"]


def test_faults_repairs_and_what_was_kept_are_told(folder: Path) -> None:
    metadata = json.loads(write_croissant(folder).read_text())
    assert metadata["rai:dataLimitations"] == "lab3: No AP3. (kept)"
    assert metadata["rai:dataPreprocessingProtocol"].startswith("3 of 5 reading sets kept;")
    assert metadata["rai:dataPreprocessingProtocol"].endswith("seam: fitted to turns")
    assert metadata["rai:dataCollection"] == "The office floor."


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_a_packed_made_up_building_is_loaded_record_by_record(made_up_root: Path, table: Table) -> None:
    import mlcroissant

    site = packed_folder(made_up_root, "made-up-5")
    validate_croissant(site)
    expected = pd.read_parquet(site / f"{table.name}.parquet")
    records = list(mlcroissant.Dataset(jsonld=site / FILE_NAME).records(table.name))
    assert len(records) == len(expected) > 0
    name = "range_m" if table.name == "device_links" else table.key[-1]
    found = [record[f"{table.name}/{name}"] for record in records]
    if name == "mac":
        assert [value.decode() for value in found] == expected[name].tolist()
    else:
        np.testing.assert_array_equal(np.array(found, float), expected[name].to_numpy(float))


def test_a_missing_table_is_named_and_nothing_is_written(folder: Path) -> None:
    (folder / "readings.parquet").unlink()
    with pytest.raises(MissingFileError, match=r"readings\.parquet"):
        write_croissant(folder)
    assert not list(folder.glob(f"{FILE_NAME}*"))


@pytest.mark.parametrize("text", ["[", "{}", "[]"])
@pytest.mark.parametrize("name", ["site.json", "manifest.json"])
def test_an_unreadable_site_is_named(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    with pytest.raises(BadFileError, match=name.replace(".", r"\.")):
        write_croissant(folder)


@pytest.mark.parametrize("name", ["site.json", "manifest.json"])
def test_a_folder_that_is_no_packed_site_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(MissingFileError, match="fploc data build"):
        write_croissant(folder)


def test_a_description_that_breaks_the_specification_is_refused(folder: Path) -> None:
    path = write_croissant(folder)
    metadata = json.loads(path.read_text())
    metadata["recordSet"][0]["field"][0]["source"]["fileObject"]["@id"] = "absent.parquet"
    path.write_text(json.dumps(metadata))
    with pytest.raises(BadFileError, match=r"Croissant 1\.1"):
        validate_croissant(folder)
