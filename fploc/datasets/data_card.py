"""Data cards: what a packed site holds, how it was made, what is wrong with it and how to read and cite it.

A card is a page in Markdown and in HTML, with pictures beside it: the site's map and distributions of what was
measured. ``index`` is the card of all sites together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from fploc.datasets.data_page import column_rows, constants_text
from fploc.datasets.describe import (
    SiteDescription,
    describe_packed,
    overlay,
    reasons_text,
    table_rows,
    writable,
    write_picture,
)
from fploc.datasets.link_errors import LinkErrors, link_errors
from fploc.datasets.origin import origin_of, public_licence
from fploc.datasets.packed import MANIFEST, PackedSite, read_packed
from fploc.datasets.pages import Block, Code, Grid, Page, Picture, Section, Text, to_html, to_markdown
from fploc.datasets.reading_example import reading_example
from fploc.datasets.recordings import Floats, Recording
from fploc.plots.link_errors import MOST_WALLS, plot_errors_by_walls, walls_text
from fploc.plots.recordings import MeasuredValues, plot_heard_shares, plot_measured_values, plot_time_steps
from fploc.progress import track
from fploc.schema import SCHEMA_VERSION, TABLES
from fploc.sites.registry import SPLITS

INDEX = "index"
LABELS = "repaired"
SPEED_WINDOW_S = 5.0
MADE_UP = "**Made-up building: nothing here was measured.**"
PICTURES: Mapping[str, str] = {
    "": "Plan with access points and a path of each device, metres.",
    "-values": "What was measured: shares of each device's own values; values beyond an axis are at its edge.",
    "-walls": "Range errors by the number of walls on the straight line to the access point, repaired labels.",
    "-heard": "How often each access point has a range in each recording.",
    "-steps": "Time from each interval to the next.",
}
"""Ending of each picture's name, and its caption."""


def write_cards(data_root: Path, sites: Sequence[str], out: Path) -> list[Path]:
    """Write the card of each site and the card of all of them into ``out``; return the files, cards first.

    Raises:
        MissingFileError: If a site is not packed.
        HashMismatchError, BadFileError: If a packed file is not what was built.
        FplocError: If a file cannot be written.
    """
    cards, pictures, descriptions, manifests = [], [], [], []
    for site in track(sites, "data cards"):
        packed = read_packed(data_root, site)
        description = describe_packed(packed)
        descriptions.append(description)
        manifests.append(packed.manifest)
        errors = link_errors(packed.site, packed.plan, packed.recordings(), LABELS)
        for ending, figure in site_figures(packed, errors).items():
            pictures.append(write_picture(figure, out / f"{site}{ending}.png"))
        page = site_card(packed, description, errors)
        cards += [
            _write(to_html(page), out / f"{site}.html"),
            _write(to_markdown(page), out / f"{site}.md"),
        ]
    indices = [
        _write(to_html(index_card(descriptions, manifests, "{site}.html")), out / f"{INDEX}.html"),
        _write(to_markdown(index_card(descriptions, manifests, "{site}.md")), out / f"{INDEX}.md"),
    ]
    return [*indices, *cards, *pictures]


def site_figures(packed: PackedSite, errors: LinkErrors) -> dict[str, Figure]:
    """Return the pictures of a site's card by the endings of their names, ``PICTURES``."""
    site = packed.site
    devices = {
        f"device {device}": measured_values(packed, device)
        for device in sorted({one.device for one in packed.recordings()})
    }
    return {
        "": overlay(packed),
        "-values": plot_measured_values(devices, site.name, made_up=site.made_up),
        "-walls": plot_errors_by_walls(errors.error_m, errors.walls, site.name, made_up=site.made_up),
        "-heard": heard_figure(packed),
        "-steps": steps_figure(packed),
    }


def heard_figure(packed: PackedSite) -> Figure:
    """Return how often each access point is heard in each recording of a site."""
    recordings, site = _titled(packed), packed.site
    shares = np.array([one.heard.mean(axis=0) for one in recordings.values()])
    names = [ap.name for ap in site.access_points]
    return plot_heard_shares(list(recordings), names, shares, site.name, made_up=site.made_up)


def steps_figure(packed: PackedSite) -> Figure:
    """Return the time steps of each recording of a site."""
    times = {name: one.t_s for name, one in _titled(packed).items()}
    return plot_time_steps(times, packed.site.name, made_up=packed.site.made_up)


def _titled(packed: PackedSite) -> dict[str, Recording]:
    return {f"device {one.device}, {one.name}": one for one in packed.recordings()}


def measured_values(packed: PackedSite, device: int) -> MeasuredValues:
    """Return what one device measured at a site."""
    rows = packed.readings[packed.readings["device"] == device]
    recordings = [one for one in packed.recordings() if one.device == device]
    return MeasuredValues(
        range_m=_known(rows["range_slant_m"]),
        rss_dbm=_known(rows["rss_dbm"]),
        std_m=_known(rows["range_std_m"]),
        heard=np.concatenate([one.heard.sum(axis=1) for one in recordings]).astype(np.float64),
        step_s=np.concatenate([np.diff(one.t_s) for one in recordings]),
        speed_mps=np.concatenate([_speeds_mps(one) for one in recordings]),
    )


def site_card(packed: PackedSite, description: SiteDescription, errors: LinkErrors) -> Page:
    """Return the card of one site."""
    info, manifest = packed.info, packed.manifest
    origin = origin_of(manifest)
    notice = [Text(MADE_UP)] if packed.site.made_up else []
    sections = (
        Section("At a glance", [Grid(_glance_rows(description))]),
        Section("Map", [_picture(packed, ""), Grid(_plan_rows(info["plan"]))]),
        Section("Access points", [Text(f"Coordinates: {_sentence(info['access_points_origin'])}"),
                                  Grid(_access_point_rows(packed))]),
        Section("Recordings", [
            Grid(_recording_rows(packed)), _picture(packed, "-heard"), _picture(packed, "-steps"),
        ]),
        Section("Dropped and masked", [
            Text("Reading sets and readings of the files are kept or dropped for one of these reasons; masked values "
                 "are null or flagged in what was kept. Summed over the recordings of a device."),
            Grid(_reason_rows(description)),
        ]),
        Section("Ranges between the devices", [
            Grid(_link_rows(manifest["device_links"]), "None were recorded, or none is in the files.")
        ]),
        Section("Distributions", [_picture(packed, "-values")]),
        Section("Walls and range errors", [
            Text("Measured slant range minus distance to the repaired label, no offset removed. Walls are those of "
                 "`walls.png` on the straight line in the plan."),
            _picture(packed, "-walls"),
            Grid(_error_rows(errors), "No recording has positions."),
        ]),
        Section("Known faults", [
            Grid([{"where": one["where"], "fault": one["what"], "what is done": one["verdict"]}
                  for one in info["faults"]], "None known.")
        ]),
        Section("Repairs of labels", [
            Text("The published label stays beside the repaired one in `intervals.parquet`."),
            Grid(_repair_rows(info["repairs"])),
        ]),
        Section("Columns and units", _column_blocks()),
        Section("Reading it with pandas", [Code(reading_example(packed.site.name), "python")]),
        Section("Licence and citation", _terms([manifest])),
        Section("Files", [
            Grid(_file_rows(packed)),
            Text(f"`croissant.json` describes them in MLCommons Croissant 1.1. Made from {len(manifest['sources'])} "
                 f"source files, each with its hash in `{MANIFEST}`."),
        ]),
    )  # fmt: skip
    lead = [
        *notice,
        Text(_sentence(info["description"])),
        Text(
            f"Place: {packed.site.place}. {len(packed.site.access_points)} access points, "
            f"{description.device_links:,} ranges between the devices. {origin.statement}"
        ),
    ]
    return Page(f"Data card: {packed.site.name}", lead, sections)


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def index_card(
    descriptions: Sequence[SiteDescription], manifests: Sequence[Mapping[str, Any]], links: str
) -> Page:
    """Return the card of several sites together.

    Args:
        descriptions: Of the sites.
        manifests: Of the sites.
        links: Where the card of a site lies, with ``{site}`` for its name.
    """
    devices = [device for one in descriptions for device in one.devices]
    summary = Text(
        f"{_counted(len(descriptions), 'site')}, {_counted(sum(one.recordings for one in devices), 'recording')}, "
        f"{sum(one.intervals for one in devices):,} intervals, {sum(one.readings for one in devices):,} readings, "
        f"{sum(one.duration_s for one in devices) / 3600:.1f} hours; schema version {SCHEMA_VERSION}."
    )
    made_up = [Text(f"{MADE_UP} ({', '.join(one.site for one in descriptions if one.made_up)})")]
    return Page(
        "Data card: WiFi round-trip time and signal strength indoors",
        [summary, *(made_up if any(one.made_up for one in descriptions) else [])],
        (
            Section("Sites", [Grid([_linked(row, links) for row in table_rows(descriptions)])]),
            Section("Maps", [Picture(f"{one.site}.png", one.site) for one in descriptions]),
            Section("Columns and units", _column_blocks()),
            Section("Reading it with pandas", [Code(reading_example(descriptions[0].site), "python")]),
            Section("Licence and citation", _terms(manifests)),
        ),
    )


def _linked(row: Mapping[str, str], links: str) -> dict[str, str]:
    name = row["site"].partition(" ")[0]
    return dict(row) | {"site": f"[{row['site']}]({links.format(site=name)})"}


def _picture(packed: PackedSite, ending: str) -> Picture:
    return Picture(f"{packed.site.name}{ending}.png", PICTURES[ending])


def _glance_rows(description: SiteDescription) -> list[dict[str, str]]:
    devices = description.devices
    totals: Mapping[str, Callable[[Any], float]] = {
        "recordings": lambda one: one.recordings,
        "intervals": lambda one: one.intervals,
        "intervals with a label": lambda one: one.labelled,
        "minutes": lambda one: one.duration_s / 60,
        "access points heard": lambda one: one.access_points,
        "readings": lambda one: one.readings,
        "readings with a range": lambda one: one.ranges,
    }
    return [
        {"": name, **{f"device {one.device}": f"{value(one):,.0f}" for one in devices}}
        for name, value in totals.items()
    ]


def _plan_rows(plan: Mapping[str, Any]) -> list[dict[str, str]]:
    values = {
        "resolution": f"{plan['metres_per_pixel']:g} m per pixel",
        "frame": plan["convention"],
        "estimated error": "–" if plan["estimated_error_m"] is None else f"{plan['estimated_error_m']:g} m",
        "source": f"`{plan['source']}`",
        "notes": plan["notes"] or "–",
    }
    return [{"plan": name, "value": " ".join(str(value).split())} for name, value in values.items()]


def _access_point_rows(packed: PackedSite) -> list[dict[str, str]]:
    by_mac = packed.readings.groupby("mac")["range_slant_m"]
    all_readings, with_range = by_mac.size(), by_mac.count()
    rows = []
    for ap in packed.site.access_points:
        readings, ranges = int(all_readings.get(ap.mac, 0)), int(with_range.get(ap.mac, 0))
        rows.append(
            {
                "name": ap.name,
                "MAC": f"`{ap.mac}`",
                "x [m]": f"{ap.x_m:.2f}",
                "y [m]": f"{ap.y_m:.2f}",
                "height [m]": f"{ap.height_m:.2f}",
                "readings": f"{readings:,}",
                "with a range": f"{ranges:,}",
                "share of intervals with a range": f"{100 * ranges / max(len(packed.intervals), 1):.0f} %",
            }
        )
    return rows


def _recording_rows(packed: PackedSite) -> list[dict[str, str]]:
    notes = {(one["device"], one["recording"]): one for one in packed.manifest["recordings"]}
    splits = {key: part for part in SPLITS for key in packed.splits.part(part)}
    rows = []
    for one in packed.recordings():
        key = (one.device, one.name)
        rows.append(
            {
                "device": str(one.device),
                "recording": one.name,
                "split": splits.get(key, "–"),
                "intervals": f"{len(one):,}",
                "minutes": f"{np.ptp(one.t_s) / 60 if len(one) else 0.0:.1f}",
                "median step [s]": f"{np.median(np.diff(one.t_s)):.2f}" if len(one) > 1 else "–",
                "path [m]": _path_text(one),
                "labels": notes[key]["labels"],
                "clock": notes[key]["clock"],
            }
        )
    return rows


def _path_text(recording: Recording) -> str:
    positions = recording.labels_m(LABELS)
    known = positions[np.isfinite(positions).all(axis=1)]
    return f"{np.linalg.norm(np.diff(known, axis=0), axis=1).sum():.1f}" if len(known) else "–"


def _reason_rows(description: SiteDescription) -> list[dict[str, str]]:
    return [
        {
            "device": str(one.device),
            "dropped sets": reasons_text(one.dropped_sets),
            "dropped readings": reasons_text(one.dropped_readings),
            "masked": reasons_text(one.masked),
        }
        for one in description.devices
    ]


def _link_rows(links: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    return [
        {
            "lap": one["lap"],
            "rows in the file": f"{one['rows']:,}",
            "kept": f"{one['kept']:,}",
            "dropped": reasons_text(one["dropped"]),
            "masked": reasons_text(one["masked"]),
            "clock": one["clock"],
        }
        for one in links
    ]


def _error_rows(errors: LinkErrors) -> list[dict[str, str]]:
    grouped = np.minimum(errors.walls, MOST_WALLS)
    rows = []
    for walls in range(MOST_WALLS + 1):
        own = errors.error_m[grouped == walls]
        if len(own):
            low, median, high = np.percentile(own, [25.0, 50.0, 75.0])
            rows.append(
                {
                    "between": walls_text(walls),
                    "readings": f"{len(own):,}",
                    "median [m]": f"{median:+.2f}".replace("-", "−"),
                    "middle half [m]": f"{low:+.2f} to {high:+.2f}".replace("-", "−"),
                    "shorter than the distance": f"{100 * (own < 0).mean():.0f} %",
                }
            )
    return rows


def _repair_rows(repairs: Mapping[str, Mapping[str, Any]]) -> list[dict[str, str]]:
    return [
        {
            "repair": f"`{name}`",
            "kind": one["kind"],
            "constants": constants_text(one["constants"]),
            "origin": one["origin"],
        }
        for name, one in repairs.items()
    ]


def _column_blocks() -> list[Block]:
    blocks: list[Block] = []
    for table in TABLES:
        meaning = f"{table.meaning[0].upper()}{table.meaning[1:]}"
        blocks.append(Text(f"`{table.name}.parquet`: {meaning}; key: {', '.join(table.key)}."))
        blocks.append(Grid(column_rows(table)))
    return blocks


def _terms(manifests: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Return the terms of every kind of origin among the sites, each once."""
    origins = dict.fromkeys(origin_of(manifest) for manifest in manifests)
    blocks: list[Block] = []
    for origin in origins:
        blocks.append(Text(origin.statement))
        if origin.licence_url is not None:
            blocks.append(Text(f"Licence: [{origin.licence}]({origin.licence_url})."))
        if origin.citation is not None:
            blocks += [Text(f"Cite: {origin.citation}."), Code(public_licence(), "text")]
    return blocks


def _file_rows(packed: PackedSite) -> list[dict[str, str]]:
    return [
        {
            "file": f"`{name}`",
            "bytes": f"{(packed.folder / name).stat().st_size:,}",
            "SHA-256": f"`{expected}`",
        }
        for name, expected in packed.manifest["files"].items()
    ]


def _speeds_mps(recording: Recording) -> Floats:
    """Return the labelled speed over windows of ``SPEED_WINDOW_S``; nothing without labels."""
    positions = recording.labels_m(LABELS)
    known = np.isfinite(positions).all(axis=1)
    if not known.any():
        return np.empty(0)
    t_s, path = recording.t_s[known], positions[known]
    times = np.arange(t_s[0], t_s[-1], SPEED_WINDOW_S)
    places = np.column_stack([np.interp(times, t_s, path[:, axis]) for axis in range(2)])
    return np.asarray(np.linalg.norm(np.diff(places, axis=0), axis=1) / SPEED_WINDOW_S, dtype=np.float64)


def _known(values: pd.Series) -> Floats:
    return values.dropna().to_numpy(dtype=np.float64)


def _sentence(text: str) -> str:
    return f"{' '.join(text.split()).rstrip('.')}."


def _write(text: str, target: Path) -> Path:
    with writable(target) as part:
        part.write_text(text, encoding="utf-8")
    return target
