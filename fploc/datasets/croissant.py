"""Describe a packed site in Croissant 1.1 (MLCommons), the JSON-LD that data set search and loaders read.

The file is written as plain JSON-LD, since importing mlcroissant takes seconds; ``validate_croissant`` and
the tests load it with mlcroissant.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from fploc.datasets.origin import AUTHORS, PUBLISHED_YEAR, origin_of
from fploc.datasets.packed import MANIFEST, SITE, read_manifest
from fploc.datasets.source_files import REPOSITORY
from fploc.errors import BadFileError, MissingFileError
from fploc.files import whole
from fploc.schema import SCHEMA_VERSION, TABLES, Column, Table

FILE_NAME = "croissant.json"
KEYWORDS = ("indoor localization", "WiFi RTT", "IEEE 802.11mc", "RSS", "floor plan")

# Packed file -> its media type and what it holds; tables come from fploc.schema.
_OTHER_FILES = {
    "site.json": ("application/json", "access points, heights, frame and place of the plan image"),
    "splits.json": ("application/json", "which recordings each protocol learns from and tests on"),
    "manifest.json": ("application/json", "hashes of all sources, counts of dropped and masked readings"),
    "plan.png": ("image/png", "the floor plan, georeferenced in site.json"),
    "walls.png": ("image/png", "its walls (0 wall, 255 free), in the same frame"),
}
_DATA_TYPES = {
    "int8": "cr:Int8",
    "int32": "cr:Int32",
    "float64": "cr:Float64",
    "bool": "sc:Boolean",
    "str": "sc:Text",
}
_TERMS = (
    "arrayShape citeAs column containedIn equivalentProperty extract field fileObject fileProperty fileSet "
    "format includes isArray isLiveDataset jsonPath key md5 parentField path recordSet references regex "
    "repeated replace samplingRate separator source subField transform"
)
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    **{term: f"cr:{term}" for term in _TERMS.split()},
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "description": {"@container": "@language"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
}


def write_croissant(folder: Path) -> Path:
    """Write ``croissant.json`` into the packed site ``folder`` and return its path.

    Raises what ``croissant_text`` raises.
    """
    target = folder / FILE_NAME
    with whole(target) as part:
        part.write_text(croissant_text(folder), "utf-8")
    return target


def croissant_text(folder: Path) -> str:
    """Return what ``croissant.json`` says of the packed site ``folder``.

    Raises:
        MissingFileError: If a table or the manifest of the packed site is missing.
        BadFileError: If ``site.json`` or the manifest is not what it should be.
    """
    return json.dumps(_metadata(folder), indent=2, ensure_ascii=False) + "\n"


def validate_croissant(folder: Path) -> None:
    """Load ``croissant.json`` with mlcroissant, which checks it against the specification.

    Raises:
        BadFileError: If it breaks the specification.
    """
    import mlcroissant

    try:
        mlcroissant.Dataset(jsonld=folder / FILE_NAME)
    except mlcroissant.ValidationError as error:
        raise BadFileError(
            folder / FILE_NAME,
            "JSON-LD",
            value=str(error),
            expected="Croissant 1.1",
            way_out="rebuild the packed site with `fploc data build`",
        ) from error


def _metadata(folder: Path) -> dict[str, Any]:
    manifest = read_manifest(folder)
    origin = origin_of(manifest)
    metadata = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": f"fploc-{folder.name}",
        "description": f"WiFi round-trip time and signal strength indoors, site {folder.name}. {origin.statement}",
        "version": f"{SCHEMA_VERSION}.0.0",
        "url": REPOSITORY,
        "keywords": list(KEYWORDS),
        **_responsible_use(folder, manifest),
        "distribution": [
            *(_table_file(folder, table) for table in TABLES),
            *(
                _file(folder / name, encoding, meaning)
                for name, (encoding, meaning) in _OTHER_FILES.items()
                if (folder / name).exists()
            ),
        ],
        "recordSet": [_record_set(table) for table in TABLES],
    }
    if origin.licence_url is not None:
        metadata["license"] = origin.licence_url
    if origin.citation is not None:
        people = [{"@type": "sc:Person", "name": f"{given} {family}"} for given, family in AUTHORS]
        metadata |= {"citeAs": origin.citation, "creator": people, "datePublished": PUBLISHED_YEAR}
    return metadata


def _responsible_use(folder: Path, manifest: dict[str, Any]) -> dict[str, str]:
    """Return what Croissant's vocabulary for responsible use asks for: how it was made, what is wrong with it."""
    site = _site_document(folder)
    kept = sum(totals["intervals"] for totals in manifest["totals"].values())
    rows = sum(totals["rows"] for totals in manifest["totals"].values())
    faults = [f"{fault['where']}: {fault['what']} ({fault['verdict']})" for fault in site["faults"]]
    repairs = [f"{name}: {repair['origin']}" for name, repair in site["repairs"].items()]
    return {
        "rai:dataCollection": site["description"],
        "rai:dataPreprocessingProtocol": (
            f"{kept} of {rows} reading sets kept; missing values are null; no range offset is removed; what was "
            f"dropped or masked is counted by reason in {MANIFEST}. Repairs of labels, beside the published ones: "
            + ("; ".join(repairs) or "none")
        ),
        "rai:dataLimitations": "; ".join(faults) or "none known",
    }


def _site_document(folder: Path) -> dict[str, Any]:
    path = folder / SITE
    rebuild = "rebuild the packed site with `fploc data build`"
    try:
        document = json.loads(path.read_text("utf-8"))
        _ = document["description"], document["faults"], document["repairs"]
    except FileNotFoundError:
        raise MissingFileError(
            path, expected="a packed site", way_out="build it with `fploc data build`"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise BadFileError(
            path, "whole file", value=repr(error), expected="site.json of a packed site", way_out=rebuild
        ) from error
    return dict(document)


def _table_file(folder: Path, table: Table) -> dict[str, Any]:
    path = folder / f"{table.name}.parquet"
    if not path.is_file():
        raise MissingFileError(
            path, expected=f"the table '{table.meaning}'", way_out="build it with `fploc data build`"
        )
    return _file(path, "application/x-parquet", table.meaning)


def _file(path: Path, encoding: str, meaning: str) -> dict[str, Any]:
    contents = path.read_bytes()
    return {
        "@type": "cr:FileObject",
        "@id": path.name,
        "name": path.name,
        "description": meaning,
        "contentUrl": path.name,
        "contentSize": f"{len(contents)} B",
        "encodingFormat": encoding,
        "sha256": hashlib.sha256(contents).hexdigest(),
    }


def _record_set(table: Table) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": table.name,
        "name": table.name,
        "description": table.meaning,
        "key": [{"@id": f"{table.name}/{name}"} for name in table.key],
        "field": [_field(table, column) for column in table.columns],
    }


def _field(table: Table, column: Column) -> dict[str, Any]:
    unit = f" [{column.unit}]" if column.unit not in ("", "1") else ""
    return {
        "@type": "cr:Field",
        "@id": f"{table.name}/{column.name}",
        "name": column.name,
        "description": f"{column.meaning}{unit}{'; may be null' if column.nullable else ''}",
        "dataType": _DATA_TYPES[column.dtype],
        "source": {
            "fileObject": {"@id": f"{table.name}.parquet"},
            "extract": {"column": column.name},
        },
    }
