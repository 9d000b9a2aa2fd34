"""Checks of sources and packed sites: everything wrong at once, with names and hashes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from fploc.datasets.source_files import (
    REVISIONS,
    blob_sha1,
    listed_file,
    listed_files,
    require_usable,
    site_files,
    split_by_presence,
)
from fploc.datasets.verify import verify
from fploc.errors import (
    FplocError,
    HashMismatchError,
    MissingFileError,
    UnknownNameError,
)
from fploc.sites.registry import known_sites, load_spec

LOCAL = ["office", "office-position1", "conference-room", "laboratory", "library", "shopping-mall"]


def test_the_hash_is_gits() -> None:
    # `git hash-object` of an empty file and of "hello\n".
    assert blob_sha1(b"") == "e69de29bb2d1d6434b8b29ae775ad8c2e48c5391"
    assert blob_sha1(b"hello\n") == "ce013625030ba8dba906f756967f9e9ca394464a"


def test_both_revisions_are_listed_whole() -> None:
    counts = dict.fromkeys(REVISIONS, 0)
    for file in listed_files().values():
        counts[file.revision] += 1
        assert len(file.blob_sha1) == 40 and (file.size is None or file.size > 0)
    assert counts == {"2b19c6c": 194, "0bdeb2a": 149}
    assert all(full.startswith(short) and len(full) == 40 for short, full in REVISIONS.items())


@pytest.mark.parametrize("site", known_sites())
def test_the_registry_names_only_listed_files_with_their_hashes(site: str) -> None:
    spec = load_spec(site)
    for file in (*spec.files, *spec.sheets):
        assert file.revision is not None
        assert listed_file(file.revision, file.path).blob_sha1 == file.blob_sha1
    assert {file.name for file in site_files([site])} == {file.name for file in (*spec.files, *spec.sheets)}


def test_a_file_that_no_revision_holds_is_named() -> None:
    with pytest.raises(UnknownNameError, match=r"2b19c6c/absent\.csv"):
        listed_file("2b19c6c", "absent.csv")


def test_files_of_several_sites_are_named_once() -> None:
    files = site_files(["office", "conference-room", "office"])
    assert len(files) == len({file.name for file in files})


def test_the_local_copy_is_intact(source: Path) -> None:
    present, _ = split_by_presence(source, known_sites())
    assert set(LOCAL) <= set(present)
    report = verify(source, present)
    assert report.missing == () and report.invalid == ()
    report.require_intact()


@pytest.fixture
def copy(source: Path, tmp_path: Path) -> Path:
    """A copy of the library's files, which a test may spoil."""
    spec = load_spec("library")
    for file in (*spec.files, *spec.sheets):
        target = tmp_path / "copy" / file.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(spec.locate(file, source), target)
    return tmp_path / "copy"


def test_all_that_is_missing_and_all_that_is_wrong_is_listed_at_once(copy: Path) -> None:
    spec = load_spec("library")
    gone = [spec.plan.file, spec.links[0].file]
    spoilt = [file for recording in spec.recordings[:2] for file in recording.files[:1]]
    for file in gone:
        (copy / file.name).unlink()
    for file in spoilt:
        with (copy / file.name).open("ab") as out:
            out.write(b"\n")
    (copy / spec.sheets[0].name).unlink()
    report = verify(copy, ["library"])
    assert set(report.missing) == {file.name for file in gone}
    assert report.not_there == (spec.sheets[0].name,)
    assert {file.path for file in report.invalid} == {file.name for file in spoilt}
    assert {file.expected for file in report.invalid} == {file.blob_sha1 for file in spoilt}
    with pytest.raises(FplocError, match=r"2 files missing .* and 2 files with a wrong hash"):
        report.require_intact()


def test_one_wrong_file_is_told_with_both_hashes(copy: Path) -> None:
    file = load_spec("library").recordings[0].files[0]
    (copy / file.name).write_bytes(b"truncated")
    with pytest.raises(HashMismatchError) as caught:
        verify(copy, ["library"]).require_intact()
    assert f"{file.blob_sha1}" in str(caught.value) and blob_sha1(b"truncated") in str(caught.value)


def test_one_missing_file_is_told_with_its_path(copy: Path) -> None:
    file = load_spec("library").plan.file
    (copy / file.name).unlink()
    with pytest.raises(MissingFileError, match="fploc data download"):
        verify(copy, ["library"]).require_intact()


def test_a_folder_named_by_the_full_commit_hash_is_a_source_too(copy: Path) -> None:
    for short, full in REVISIONS.items():
        if (copy / short).is_dir():
            (copy / short).rename(copy / full)
    assert require_usable(copy, named_by="--from") == copy
    assert verify(copy, ["library"]).is_intact


def test_sites_without_any_recording_are_told_apart(copy: Path) -> None:
    assert split_by_presence(copy, ["library", "laboratory"]) == (["library"], ["laboratory"])
