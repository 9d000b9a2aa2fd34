"""Check files against their promised hashes: all that is missing and all that is wrong, in one report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fploc.datasets.source_files import blob_sha1, required_files
from fploc.errors import FplocError, HashMismatchError, MissingFileError
from fploc.progress import track
from fploc.sites.registry import load_spec


@dataclass(frozen=True)
class InvalidFile:
    """A file whose hash is not the promised one."""

    path: str
    algorithm: str
    found: str
    expected: str


@dataclass(frozen=True)
class VerifyReport:
    """What a check found.

    Args:
        folder: The folder that was checked.
        checked: Number of files that were looked for.
        missing: Files that are not there.
        invalid: Files whose contents are not the promised ones.
        not_there: Files that are of use but not needed, and are not there.
        way_out: What to do where something is missing or invalid.
    """

    folder: Path
    checked: int
    missing: tuple[str, ...]
    invalid: tuple[InvalidFile, ...]
    not_there: tuple[str, ...]
    way_out: str

    @property
    def is_intact(self) -> bool:
        """True where nothing is missing or invalid."""
        return not self.missing and not self.invalid

    def require_intact(self) -> None:
        """Do nothing where ``is_intact``.

        Raises:
            HashMismatchError: If one file is invalid and none is missing.
            MissingFileError: If one file is missing and none is invalid.
            FplocError: If there are several; it counts them and names the first of each kind.
        """
        if self.is_intact:
            return
        if not self.missing and len(self.invalid) == 1:
            (file,) = self.invalid
            raise HashMismatchError(
                self.folder / file.path,
                algorithm=file.algorithm,
                found=file.found,
                expected=file.expected,
                way_out=self.way_out,
            )
        if not self.invalid and len(self.missing) == 1:
            raise MissingFileError(
                self.folder / self.missing[0], expected="a file of the data set", way_out=self.way_out
            )
        parts = [("missing", list(self.missing)), ("with a wrong hash", [file.path for file in self.invalid])]
        raise FplocError(
            str(self.folder),
            value=" and ".join(f"{len(names)} files {kind} ({names[0]})" for kind, names in parts if names),
            expected=f"{self.checked} intact files",
            way_out=self.way_out,
        )


def verify(source: Path, sites: Sequence[str]) -> VerifyReport:
    """Check every public file of ``sites`` in the folder ``source`` by its git blob SHA-1.

    AP lists and long tables may be absent: sites can be built without them.

    Raises:
        UnknownNameError: If a site is unknown.
    """
    specs = [load_spec(site) for site in sites]
    required = {file for spec in specs for file in required_files(spec)}
    places = {file: spec.locate(file, source) for spec in specs for file in (*spec.files, *spec.sheets)}
    missing: list[str] = []
    not_there: list[str] = []
    invalid: list[InvalidFile] = []
    for file, path in track(list(places.items()), "verify"):
        if not path.is_file():
            (missing if file in required else not_there).append(file.name)
        elif file.blob_sha1 is not None:
            found = blob_sha1(path.read_bytes())
            if found != file.blob_sha1:
                invalid.append(InvalidFile(file.name, "git blob SHA-1", found, file.blob_sha1))
    return VerifyReport(
        folder=source,
        checked=len(places),
        missing=tuple(missing),
        invalid=tuple(invalid),
        not_there=tuple(not_there),
        way_out="fetch it again with `fploc data download`, or correct the local copy",
    )
