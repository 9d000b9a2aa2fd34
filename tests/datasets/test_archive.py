from __future__ import annotations

import hashlib
import json
import os
import shutil
import zipfile
from pathlib import Path

import pandas as pd
import pytest
import yaml

from fploc.datasets.archive import TOP, write_archive
from fploc.datasets.build import build_sites
from fploc.datasets.origin import AUTHORS, CITATION
from fploc.datasets.packed import packed_folder
from fploc.errors import FplocError, HashMismatchError
from fploc.sites.made_up import made_up_site

SITE = "made-up-5"


def as_public(root: Path, site: str, path: str = "2b19c6c/raw_data/a.csv") -> None:
    """Make a packed made-up site look as if it were measured, its sources at ``path``."""
    folder = packed_folder(root, site)
    document = json.loads((folder / "site.json").read_text()) | {"made_up": False}
    (folder / "site.json").write_text(json.dumps(document))
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest |= {"made_up": False, "sources": [{"path": path, "git_blob_sha1": "0", "bytes": 1}]}
    manifest["files"]["site.json"] = hashlib.sha256((folder / "site.json").read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))


@pytest.fixture
def root(made_up_root: Path, tmp_path: Path) -> Path:
    shutil.copytree(made_up_root / "packed", tmp_path / "root" / "packed")
    return tmp_path / "root"


def test_two_builds_give_the_same_bytes_whatever_their_dates(made_up_root: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    build_sites(None, again, [made_up_site(5, again / "files", laps=2, duration_s=30.0)])
    for path in packed_folder(again, SITE).iterdir():
        os.utime(path, (1_000_000_000, 1_000_000_000))
        path.chmod(0o600)
    first = write_archive(made_up_root, [SITE], tmp_path / "first.zip")
    second = write_archive(again, [SITE], tmp_path / "below" / "second.zip")
    assert (tmp_path / "first.zip").read_bytes() == (tmp_path / "below" / "second.zip").read_bytes()
    assert (first.sha256, first.md5, first.size) == (second.sha256, second.md5, second.size)
    assert first.sha256 == hashlib.sha256((tmp_path / "first.zip").read_bytes()).hexdigest()


def test_everything_is_in_it_with_its_hash_and_can_be_read(root: Path, tmp_path: Path) -> None:
    import mlcroissant

    report = write_archive(root, [SITE], tmp_path / "data.zip")
    with zipfile.ZipFile(report.archive) as archive:
        assert archive.namelist() == sorted(archive.namelist()) and len(archive.namelist()) == report.files
        archive.extractall(tmp_path / "out")
    top = tmp_path / "out" / TOP
    sums = dict(reversed(line.split("  ")) for line in (top / "SHA256SUMS").read_text().splitlines())
    files = {path.relative_to(top).as_posix() for path in top.rglob("*") if path.is_file()}
    assert sums.keys() == files - {"SHA256SUMS"}
    for name, expected in sums.items():
        assert hashlib.sha256((top / name).read_bytes()).hexdigest() == expected
    packed = {f"{SITE}/{path.name}" for path in packed_folder(root, SITE).iterdir()}
    assert files - packed == {"SHA256SUMS", "README.md", f"{SITE}/README.md", "CITATION.cff", "zenodo.json"}
    intervals = pd.read_parquet(top / SITE / "intervals.parquet")
    dataset = mlcroissant.Dataset(jsonld=top / SITE / "croissant.json")
    times = [record["intervals/t_ms"] for record in dataset.records("intervals")]
    assert times == intervals["t_ms"].tolist()


def test_its_readme_links_to_what_is_there(root: Path, tmp_path: Path) -> None:
    report = write_archive(root, [SITE], tmp_path / "data.zip")
    with zipfile.ZipFile(report.archive) as archive:
        page = archive.read(f"{TOP}/README.md").decode()
        assert f"({SITE}/README.md)" in page and ".png)" not in page and "Made-up building" in page


def test_licence_and_authors_go_with_public_data(root: Path, tmp_path: Path) -> None:
    as_public(root, SITE)
    report = write_archive(root, [SITE], tmp_path / "data.zip")
    with zipfile.ZipFile(report.archive) as archive:
        assert "Copyright (c) 2022 haiyaoyu" in archive.read(f"{TOP}/LICENSE").decode()
        citation = yaml.safe_load(archive.read(f"{TOP}/CITATION.cff"))
        deposit = json.loads(archive.read(f"{TOP}/zenodo.json"))["metadata"]
        croissant = json.loads(archive.read(f"{TOP}/{SITE}/croissant.json"))
    assert citation["license"] == deposit["license"] == "MIT"
    assert [one["family-names"] for one in citation["authors"]] == [family for _, family in AUTHORS]
    assert [one["name"] for one in deposit["creators"]] == [f"{family}, {given}" for given, family in AUTHORS]
    assert deposit["references"] == [croissant["citeAs"]] == [CITATION]
    assert all("2b19c6c0db" in one or "0bdeb2a525" in one for one in
               (one["identifier"] for one in deposit["related_identifiers"]))  # fmt: skip


def test_a_users_own_data_are_given_no_terms(root: Path, tmp_path: Path) -> None:
    as_public(root, SITE, path="laps/1.csv")
    report = write_archive(root, [SITE], tmp_path / "data.zip")
    with zipfile.ZipFile(report.archive) as archive:
        assert f"{TOP}/LICENSE" not in archive.namelist()
        assert "license" not in yaml.safe_load(archive.read(f"{TOP}/CITATION.cff"))
        assert "license" not in json.loads(archive.read(f"{TOP}/zenodo.json"))["metadata"]
        assert "license" not in json.loads(archive.read(f"{TOP}/{SITE}/croissant.json"))


def test_made_up_buildings_do_not_go_with_measured_sites(root: Path, tmp_path: Path) -> None:
    shutil.copytree(packed_folder(root, SITE), packed_folder(root, "made-up-6"))
    as_public(root, "made-up-6")
    with pytest.raises(FplocError, match=r"made-up-5 \(made-up\).*write an archive for each"):
        write_archive(root, [SITE, "made-up-6"], tmp_path / "data.zip")
    assert not (tmp_path / "data.zip").exists()


def test_a_changed_file_is_not_archived(root: Path, tmp_path: Path) -> None:
    (packed_folder(root, SITE) / "plan.png").write_bytes(b"")
    with pytest.raises(HashMismatchError, match=r"plan\.png"):
        write_archive(root, [SITE], tmp_path / "data.zip")
    assert not list(tmp_path.glob("data.zip*"))
