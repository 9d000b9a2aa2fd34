"""Site files: what is known of an AP layout, read from YAML and checked key by key.

The registry beside this module holds one file per AP layout of the public data set; a user's own building
is a file of the same format, given by its path, whose files are relative to it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml

from fploc.errors import BadFileError, FplocError, MissingFileError, UnknownNameError
from fploc.floorplan.georeference import Georeference
from fploc.sites.site import AccessPoint, Site

# How the AP numbers of a file's columns map to access points (``ColumnNumbering``).
NUMBERINGS = ("auto", "names", "compact")
SPLITS = ("train", "validate", "test")

_MAC = re.compile(r"[0-9a-f]{2}(:[0-9a-f]{2}){5}")
_SHA1 = re.compile(r"[0-9a-f]{40}")
_NAME = re.compile(r"[a-z0-9][a-z0-9._-]*")
_WAY_OUT = "correct that key (docs/data.md shows the format)"

Value = TypeVar("Value")


@dataclass(frozen=True)
class FileRef:
    """One file that a site is made of.

    Args:
        path: In the public repository, or relative to the site file where there is no revision.
        revision: Short commit hash: the folder of a source that holds the file. None for a user's own.
        blob_sha1: Git blob SHA-1 that the contents must have. None for a user's own.
    """

    path: str
    revision: str | None = None
    blob_sha1: str | None = None

    @property
    def name(self) -> str:
        """``<revision>/<path>``, or the path alone for a user's own file."""
        return self.path if self.revision is None else f"{self.revision}/{self.path}"


@dataclass(frozen=True)
class AlternativePose:
    """Another place of the plan in the site frame: a hypothesis, reported apart from everything else."""

    native_from_metres: Georeference
    origin_m: tuple[float, float]
    size_px: tuple[int, int]
    allowed_in_zero_shot: bool
    notes: str


@dataclass(frozen=True)
class PlanSpec:
    """Where the floor plan comes from and how it is placed.

    Args:
        file: The image as published.
        native_from_metres: Metres of the site frame to pixels of that image.
        origin_m: Outer corner of the top-left pixel of the rendered plan, metres.
        size_px: Width and height of the rendered plan, pixels.
        metres_per_pixel: Side of a pixel of the rendered plan.
        not_walls_m: Polygons in metres whose lines are no walls.
        blank_boxes_px: Boxes x0, y0, x1, y1 in native pixels that hold a scale bar or text.
        thinnest_wall_m: Lines thinner than this are no walls; 0 keeps every line.
        estimated_error_m: How far the plan may lie from where it should.
        notes: What a reader should know of it.
        alternative: Another pose, or None.
    """

    file: FileRef
    native_from_metres: Georeference
    origin_m: tuple[float, float]
    size_px: tuple[int, int]
    metres_per_pixel: float
    not_walls_m: tuple[tuple[tuple[float, float], ...], ...]
    blank_boxes_px: tuple[tuple[int, ...], ...]
    thinnest_wall_m: float
    estimated_error_m: float
    notes: str
    alternative: AlternativePose | None


@dataclass(frozen=True)
class RecordingSpec:
    """One lap of one device, and the files that hold it.

    Args:
        device: 1 or 2.
        name: Name of the lap's file, for example ``713``.
        lap: Folder of the lap: recordings of one lap were made at the same time.
        split: ``train``, ``validate`` or ``test``.
        cleaned: The cleaned lap; the main source of a recording where it exists.
        raw: The phone's own log; the source where there is no cleaned lap.
        repairs: Names of the site's repairs that apply to it.
    """

    device: int
    name: str
    lap: str
    split: str
    cleaned: FileRef | None
    raw: FileRef | None
    repairs: tuple[str, ...]

    @property
    def files(self) -> tuple[FileRef, ...]:
        """Its files, main one first."""
        return tuple(file for file in (self.cleaned, self.raw) if file is not None)


@dataclass(frozen=True)
class LinkSpec:
    """A log of ranges between the two devices.

    Args:
        lap: Folder of the lap.
        file: The log.
        clock: What is known of its zero against the devices' clocks.
    """

    lap: str
    file: FileRef
    clock: str


@dataclass(frozen=True)
class RepairSpec:
    """A repair of labels: its kind (``fploc.repair.labels``), its constants and where they come from."""

    name: str
    kind: str
    constants: Mapping[str, Any]
    origin: str


@dataclass(frozen=True)
class FaultSpec:
    """A known fault of the data and what is done about it."""

    where: str
    what: str
    verdict: str


@dataclass(frozen=True)
class SiteSpec:
    """Everything that a site file says.

    Args:
        site: The access points and heights: all that methods see of it.
        description: One sentence.
        access_points_origin: Where the coordinates come from.
        numbering: How AP numbers of columns map to access points: ``names`` (AP5 is the access point of
            that name), ``compact`` (APk is the k-th of the list) or ``auto`` (decided per file).
        true_distance_faults: Names of access points whose published true distance is known to be wrong.
        plan: The floor plan.
        recordings: In order of device and lap.
        links: Logs of ranges between the devices.
        sheets: AP lists of the public data set, for checks.
        long_table: The long table of the public data set, or None.
        repairs: Repairs by name.
        faults: Known faults.
        path: The site file.
        sha256: Hash of the site file.
    """

    site: Site
    description: str
    access_points_origin: str
    numbering: str
    true_distance_faults: tuple[str, ...]
    plan: PlanSpec
    recordings: tuple[RecordingSpec, ...]
    links: tuple[LinkSpec, ...]
    sheets: tuple[FileRef, ...]
    long_table: FileRef | None
    repairs: Mapping[str, RepairSpec]
    faults: tuple[FaultSpec, ...]
    path: Path
    sha256: str

    @property
    def files(self) -> tuple[FileRef, ...]:
        """Every file that the packed site is built from, each once: plan, recordings, links, long table."""
        files = [self.plan.file]
        files += [file for recording in self.recordings for file in recording.files]
        files += [link.file for link in self.links]
        files += [] if self.long_table is None else [self.long_table]
        return tuple(dict.fromkeys(files))

    def locate(self, file: FileRef, source: Path | None) -> Path:
        """Return where ``file`` stands: below ``source`` if it has a revision, else beside the site file.

        A revision's folder may carry the short or the full commit hash.
        """
        if file.revision is None:
            return self.path.parent / file.path
        if source is None:
            raise MissingFileError(
                file.name,
                expected=f"a source of the public data, which the site {self.site.name} is built from",
                way_out="give one with --from DIR or FPLOC_SOURCE, or run `fploc data download`",
            )
        short = source / file.revision
        if short.is_dir():
            return short / file.path
        full = sorted(source.glob(f"{file.revision}*"))
        return (full[0] if full else short) / file.path


def known_sites() -> tuple[str, ...]:
    """Return the names of the registry's sites, the office layouts first."""
    return _KNOWN


def load_spec(name_or_path: str | Path) -> SiteSpec:
    """Return the site file of a registry name, or the one at a path ending in .yaml or .yml.

    Raises:
        UnknownNameError: If the registry has no such site.
        MissingFileError: If there is no such file.
        BadFileError: If the file is no YAML, or a key is unknown, missing or wrong.
    """
    if Path(name_or_path).suffix in {".yaml", ".yml"}:
        path = Path(name_or_path)
        if not path.is_file():
            raise MissingFileError(
                path, expected="a site file (YAML)", way_out="check the path, or name a site of the registry"
            )
    elif str(name_or_path) in _KNOWN:
        path = Path(str(resources.files("fploc.sites").joinpath("registry", f"{name_or_path}.yaml")))
    else:
        raise UnknownNameError(
            "site", str(name_or_path), known=list(_KNOWN), way_out="or give the path of a site file (.yaml)"
        )
    contents = path.read_bytes()
    try:
        document = yaml.load(contents, Loader=_Loader)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadFileError(
            path,
            "whole file",
            value=str(error).replace("\n", " "),
            expected="YAML",
            way_out="correct it there",
        ) from error
    return _spec(_Section(path, "", document), hashlib.sha256(contents).hexdigest())


_KNOWN = (
    "office",
    "office-position1",
    "office-position2",
    "conference-room",
    "laboratory",
    "library",
    "shopping-mall",
    "canteen",
    "carpark",
)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Safe YAML that refuses a key given twice."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [key.value for key, _ in node.value]
        twice = sorted({key for key in keys if keys.count(key) > 1})
        if twice:
            raise yaml.constructor.ConstructorError(
                None, None, f"key {twice[0]} stands twice", node.start_mark
            )
        return super().construct_mapping(node, deep)


class _Section:
    """A mapping of the file whose keys are taken one by one; what is left over is unknown."""

    def __init__(self, path: Path, where: str, value: Any) -> None:
        self.path, self._where = path, where
        if not isinstance(value, dict):
            raise self.error("", value=value, expected="a mapping of keys")
        self._left = dict(value)
        self._known: list[str] = []

    def error(self, key: str, *, value: object, expected: str) -> BadFileError:
        where = ".".join(part for part in (self._where, key) if part)
        return BadFileError(
            self.path,
            f"key {where}" if where else "whole file",
            value=repr(value),
            expected=expected,
            way_out=_WAY_OUT,
        )

    def take(self, key: str, kind: type[Value], expected: str, default: Value | None = None) -> Value:
        self._known.append(key)
        if key not in self._left:
            if default is None:
                raise self.error(key, value="nothing", expected=expected)
            return default
        value = self._left.pop(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(key, value=value, expected=expected)
        return value

    def text(self, key: str, default: str | None = None) -> str:
        return self.take(key, str, "text", default).strip()

    def choice(self, key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        value = self.take(key, str, f"one of {', '.join(choices)}", default)
        if value not in choices:
            raise self.error(key, value=value, expected=f"one of {', '.join(choices)}")
        return value

    def matching(self, key: str, pattern: re.Pattern[str], expected: str) -> str:
        value = self.take(key, str, expected)
        if not pattern.fullmatch(value):
            raise self.error(key, value=value, expected=expected)
        return value

    def number(self, key: str, default: float | None = None) -> float:
        value = self.take(key, object, "a number", default)
        return self.as_number(key, value)

    def as_number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
            raise self.error(key, value=value, expected="a number")
        return float(value)

    def whole(self, key: str) -> int:
        return self.take(key, int, "a whole number")

    def flag(self, key: str, default: bool) -> bool:
        return self.take(key, bool, "true or false", default)

    def numbers(self, key: str, count: int) -> tuple[float, ...]:
        return self.as_numbers(key, self.take(key, list, f"a list of {count} numbers"), count)

    def as_numbers(self, key: str, value: object, count: int) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise self.error(key, value=value, expected=f"a list of {count} numbers")
        return tuple(self.as_number(key, item) for item in value)

    def names(self, key: str) -> tuple[str, ...]:
        values: list[object] = self.take(key, list, "a list of names", [])
        if not all(isinstance(value, str) for value in values):
            raise self.error(key, value=values, expected="a list of names")
        return tuple(str(value) for value in values)

    def section(self, key: str) -> _Section:
        value = self.take(key, dict, "a mapping of keys")
        return _Section(self.path, ".".join(part for part in (self._where, key) if part), value)

    def optional_section(self, key: str) -> _Section | None:
        if key in self._left:
            return self.section(key)
        self._known.append(key)
        return None

    def sections(self, key: str, *, required: bool = False) -> list[_Section]:
        default: list[Any] | None = None if required else []
        values = self.take(key, list, "a list of mappings", default)
        prefix = ".".join(part for part in (self._where, key) if part)
        return [_Section(self.path, f"{prefix}[{index}]", value) for index, value in enumerate(values)]

    def named_sections(self, key: str) -> dict[str, _Section]:
        value: dict[object, object] = self.take(key, dict, "a mapping of keys", {})
        prefix = ".".join(part for part in (self._where, key) if part)
        return {str(name): _Section(self.path, f"{prefix}.{name}", entry) for name, entry in value.items()}

    def close(self) -> None:
        if self._left:
            key = next(iter(self._left))
            raise self.error(
                str(key), value="an unknown key", expected=f"only {', '.join(dict.fromkeys(self._known))}"
            )


def _spec(top: _Section, sha256: str) -> SiteSpec:
    site = _site(top)
    plan = _plan(top.section("plan"))
    repairs = {name: _repair(name, section) for name, section in top.named_sections("repairs").items()}
    recordings = tuple(_recording(section, repairs) for section in top.sections("recordings", required=True))
    keys = [(recording.device, recording.name) for recording in recordings]
    for key in keys:
        if keys.count(key) > 1:
            raise top.error("recordings", value=key, expected="each device and name once")
    names = [ap.name for ap in site.access_points]
    faulty = top.names("true_distance_faults")
    if not set(faulty) <= set(names):
        raise top.error(
            "true_distance_faults", value=list(faulty), expected=f"names among {', '.join(names)}"
        )
    long_table = top.optional_section("long_table")
    spec = SiteSpec(
        site=site,
        description=top.text("description", ""),
        access_points_origin=top.text("access_points_origin", ""),
        numbering=top.choice("numbering", NUMBERINGS, "auto"),
        true_distance_faults=faulty,
        plan=plan,
        recordings=recordings,
        links=tuple(_link(section) for section in top.sections("links")),
        sheets=tuple(_file(section) for section in top.sections("sheets")),
        long_table=None if long_table is None else _file(long_table),
        repairs=repairs,
        faults=tuple(_fault(section) for section in top.sections("faults")),
        path=top.path,
        sha256=sha256,
    )
    top.close()
    return spec


def _site(top: _Section) -> Site:
    access_points = tuple(_access_point(section) for section in top.sections("access_points", required=True))
    for label, values in (
        ("MAC", [ap.mac for ap in access_points]),
        ("name", [ap.name for ap in access_points]),
    ):
        twice = [value for value in values if values.count(value) > 1]
        if twice:
            raise top.error(
                "access_points", value=f"the {label} {twice[0]} twice", expected=f"each {label} once"
            )
    if not access_points:
        raise top.error("access_points", value="an empty list", expected="at least one access point")
    name = top.matching("name", _NAME, "lower-case letters, digits, dots and hyphens")
    return Site(
        name=name,
        place=top.text("place", name),
        access_points=access_points,
        device_height_m=top.number("device_height_m"),
        made_up=top.flag("made_up", False),
    )


def _access_point(section: _Section) -> AccessPoint:
    access_point = AccessPoint(
        name=section.text("name"),
        mac=section.matching("mac", _MAC, "a MAC address in lower case, like b0:e4:d5:39:26:89"),
        x_m=section.number("x_m"),
        y_m=section.number("y_m"),
        height_m=section.number("height_m"),
    )
    section.close()
    return access_point


def _file(section: _Section) -> FileRef:
    revision = section.text("revision", "")
    if not revision:
        file = FileRef(path=section.text("path"))
    else:
        file = FileRef(
            path=section.text("path"),
            revision=revision,
            blob_sha1=section.matching("blob_sha1", _SHA1, "a git blob SHA-1 of 40 digits"),
        )
    section.close()
    return file


def _optional_file(section: _Section | None) -> FileRef | None:
    return None if section is None else _file(section)


def _matrix(section: _Section, key: str) -> Georeference:
    rows = section.take(key, list, "2 rows of 3 numbers")
    if len(rows) != 2:
        raise section.error(key, value=rows, expected="2 rows of 3 numbers")
    try:
        return Georeference([section.as_numbers(key, row, 3) for row in rows])  # type: ignore[arg-type]
    except BadFileError:
        raise
    except FplocError as error:
        raise section.error(key, value=rows, expected=error.expected) from error


def _pose(section: _Section) -> tuple[Georeference, tuple[float, float], tuple[int, int]]:
    matrix = _matrix(section, "native_from_metres")
    x_m, y_m = section.numbers("origin_m", 2)
    width, height = section.numbers("size_px", 2)
    if min(width, height) < 1 or width % 1 or height % 1:
        raise section.error("size_px", value=[width, height], expected="two whole numbers above 0")
    return matrix, (x_m, y_m), (int(width), int(height))


def _plan(section: _Section) -> PlanSpec:
    file = _file(section.section("file"))
    matrix, origin_m, size_px = _pose(section)
    metres_per_pixel = section.number("metres_per_pixel", 0.05)
    if not metres_per_pixel > 0:
        raise section.error("metres_per_pixel", value=metres_per_pixel, expected="a number above 0")
    polygons: list[Any] = section.take("not_walls_m", list, "a list of polygons", [])
    boxes: list[Any] = section.take("blank_boxes_px", list, "a list of boxes x0, y0, x1, y1", [])
    alternative = section.optional_section("alternative")
    plan = PlanSpec(
        file=file,
        native_from_metres=matrix,
        origin_m=origin_m,
        size_px=size_px,
        metres_per_pixel=metres_per_pixel,
        not_walls_m=tuple(_polygon(section, polygon) for polygon in polygons),
        blank_boxes_px=tuple(
            tuple(int(number) for number in section.as_numbers("blank_boxes_px", box, 4)) for box in boxes
        ),
        thinnest_wall_m=section.number("thinnest_wall_m", 0.0),
        estimated_error_m=section.number("estimated_error_m"),
        notes=section.text("notes", ""),
        alternative=None if alternative is None else _alternative(alternative),
    )
    section.close()
    return plan


def _polygon(section: _Section, value: object) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, list) or len(value) < 3:
        raise section.error("not_walls_m", value=value, expected="polygons of at least 3 corners x, y")
    corners = [section.as_numbers("not_walls_m", corner, 2) for corner in value]
    return tuple((x, y) for x, y in corners)


def _alternative(section: _Section) -> AlternativePose:
    matrix, origin_m, size_px = _pose(section)
    pose = AlternativePose(
        native_from_metres=matrix,
        origin_m=origin_m,
        size_px=size_px,
        allowed_in_zero_shot=section.flag("allowed_in_zero_shot", False),
        notes=section.text("notes", ""),
    )
    section.close()
    return pose


def _recording(section: _Section, repairs: Mapping[str, RepairSpec]) -> RecordingSpec:
    device = section.whole("device")
    if device not in (1, 2):
        raise section.error("device", value=device, expected="1 or 2")
    recording = RecordingSpec(
        device=device,
        name=section.text("name"),
        lap=section.text("lap"),
        split=section.choice("split", SPLITS, "test"),
        cleaned=_optional_file(section.optional_section("cleaned")),
        raw=_optional_file(section.optional_section("raw")),
        repairs=section.names("repairs"),
    )
    if not recording.files:
        raise section.error("cleaned", value="nothing", expected="a cleaned lap or a raw log")
    unknown = [name for name in recording.repairs if name not in repairs]
    if unknown:
        raise section.error("repairs", value=unknown[0], expected=f"one of {', '.join(repairs) or 'none'}")
    section.close()
    return recording


def _link(section: _Section) -> LinkSpec:
    link = LinkSpec(
        lap=section.text("lap"), file=_file(section.section("file")), clock=section.text("clock", "unknown")
    )
    section.close()
    return link


def _repair(name: str, section: _Section) -> RepairSpec:
    repair = RepairSpec(
        name=name,
        kind=section.text("kind"),
        constants=section.take("constants", dict, "a mapping of constants", {}),
        origin=section.text("origin"),
    )
    section.close()
    return repair


def _fault(section: _Section) -> FaultSpec:
    fault = FaultSpec(where=section.text("where"), what=section.text("what"), verdict=section.text("verdict"))
    section.close()
    return fault
