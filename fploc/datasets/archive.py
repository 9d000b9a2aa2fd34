"""Packed sites as one file to deposit under a DOI: the same packed sites give the same bytes, anywhere.

The file is a ZIP whose members stand in the order of their names, all of one date and uncompressed (the tables and
images are compressed already, and compressors differ). Licence and citation of the authors lie beside the data.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from fploc.datasets.croissant import FILE_NAME, KEYWORDS, croissant_text
from fploc.datasets.data_card import LABELS, index_card, site_card
from fploc.datasets.describe import describe_packed
from fploc.datasets.link_errors import link_errors
from fploc.datasets.origin import AUTHORS, PAPER, PUBLIC, Origin, origin_of, public_licence
from fploc.datasets.packed import MANIFEST, PackedSite, read_packed
from fploc.datasets.pages import Page, to_markdown, without_pictures
from fploc.datasets.source_files import REPOSITORY, REVISIONS
from fploc.errors import FplocError
from fploc.files import whole
from fploc.progress import track
from fploc.schema import SCHEMA_VERSION

TOP = f"fploc-data-{SCHEMA_VERSION}"
"""Folder that everything lies in."""
TITLE = "WiFi round-trip time and signal strength indoors, with floor plans: packed sites"
CARD = "README.md"
SUMS = "SHA256SUMS"
_UNIX = 3
_READABLE = 0o644 << 16


@dataclass(frozen=True)
class ArchiveReport:
    """What was written.

    Args:
        archive: The file.
        sites: Names of the packed sites in it.
        files: Number of its files.
        size: Bytes.
        sha256: Of the file.
        md5: Of the file, as some repositories of data show it.
    """

    archive: Path
    sites: tuple[str, ...]
    files: int
    size: int
    sha256: str
    md5: str


def write_archive(data_root: Path, sites: Sequence[str], target: Path) -> ArchiveReport:
    """Write the packed ``sites`` below ``data_root`` into one ZIP file.

    Raises:
        MissingFileError: If a site is not packed.
        HashMismatchError, BadFileError: If a packed file is not what was built.
        FplocError: If sites on different terms are named together.
        OSError: If the file cannot be written.
    """
    packed = [read_packed(data_root, site) for site in track(sorted(set(sites)), "archive")]
    members = _members(packed, _common_origin(packed))
    target.parent.mkdir(parents=True, exist_ok=True)
    with whole(target) as part:
        _write_zip(members, part)
    contents = target.read_bytes()
    return ArchiveReport(
        archive=target,
        sites=tuple(one.site.name for one in packed),
        files=len(members),
        size=len(contents),
        sha256=hashlib.sha256(contents).hexdigest(),
        md5=hashlib.md5(contents, usedforsecurity=False).hexdigest(),
    )


def _common_origin(packed: Sequence[PackedSite]) -> Origin:
    origins = {origin_of(one.manifest): one.site.name for one in packed}
    if len(origins) > 1:
        raise FplocError(
            "--sites",
            value=", ".join(f"{site} ({origin.name})" for origin, site in origins.items()),
            expected="sites of one origin: licence and citation hold for the whole archive",
            way_out="write an archive for each",
        )
    return next(iter(origins))


def _members(packed: Sequence[PackedSite], origin: Origin) -> dict[str, bytes]:
    """Return the contents of the archive by name, in order."""
    descriptions = [describe_packed(one) for one in packed]
    documents = {
        CARD: _card(index_card(descriptions, [one.manifest for one in packed], f"{{site}}/{CARD}")),
        "CITATION.cff": _citation(origin),
        "zenodo.json": _deposit(packed, origin),
    }
    if origin == PUBLIC:
        documents["LICENSE"] = public_licence()
    for one, description in zip(packed, descriptions, strict=True):
        errors = link_errors(one.site, one.plan, one.recordings(), LABELS)
        documents[f"{one.site.name}/{CARD}"] = _card(site_card(one, description, errors))
        documents[f"{one.site.name}/{FILE_NAME}"] = croissant_text(one.folder)
    members = {name: text.encode() for name, text in documents.items()}
    for one in packed:
        members |= {
            f"{one.site.name}/{name}": (one.folder / name).read_bytes()
            for name in (*one.manifest["files"], MANIFEST)
        }
    sums = [f"{hashlib.sha256(contents).hexdigest()}  {name}\n" for name, contents in sorted(members.items())]
    members[SUMS] = "".join(sums).encode()
    return {f"{TOP}/{name}": members[name] for name in sorted(members)}


def _card(page: Page) -> str:
    return to_markdown(without_pictures(page))


def _authors() -> list[dict[str, str]]:
    return [{"given-names": given, "family-names": family} for given, family in AUTHORS]


def _citation(origin: Origin) -> str:
    """Return CITATION.cff: the data, and the paper that describes them."""
    document: dict[str, object] = {
        "cff-version": "1.2.0",
        "message": "If you use these data, please cite them, and the paper where one is named.",
        "type": "dataset",
        "title": TITLE,
        "version": f"{SCHEMA_VERSION}.0.0",
        "authors": _authors() if origin == PUBLIC else [{"name": "The fploc developers"}],
    }
    if origin.licence is not None:
        document["license"] = origin.licence
    if origin == PUBLIC:
        document["repository"] = REPOSITORY
        document["references"] = [{"type": "article", "title": PAPER, "authors": _authors()}]
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=110)


def _deposit(packed: Sequence[PackedSite], origin: Origin) -> str:
    """Return the metadata of a deposit in the form that Zenodo takes."""
    people = [{"name": f"{family}, {given}"} for given, family in AUTHORS]
    sites = ", ".join(one.site.name for one in packed)
    metadata: dict[str, object] = {
        "title": TITLE,
        "upload_type": "dataset",
        "version": f"{SCHEMA_VERSION}.0.0",
        "description": f"{origin.statement} Sites: {sites}. Tables in Parquet, floor plans in PNG, described in "
        "Croissant; see README.md.",
        "creators": people if origin == PUBLIC else [{"name": "The fploc developers"}],
        "keywords": list(KEYWORDS),
    }
    if origin.licence is not None:
        metadata["license"] = origin.licence
    if origin == PUBLIC:
        metadata["contributors"] = [{"name": "The fploc developers", "type": "DataCurator"}]
        metadata["references"] = [origin.citation]
        metadata["related_identifiers"] = [
            {"identifier": f"{REPOSITORY}/tree/{revision}", "relation": "isDerivedFrom"}
            for revision in REVISIONS.values()
        ]
    return json.dumps({"metadata": metadata}, indent=2, ensure_ascii=False) + "\n"


def _write_zip(members: Mapping[str, bytes], target: Path) -> None:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        for name, contents in members.items():
            entry = zipfile.ZipInfo(name)
            entry.create_system = _UNIX
            entry.external_attr = _READABLE
            archive.writestr(entry, contents)
