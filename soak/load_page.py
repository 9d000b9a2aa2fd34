"""docs/load.md, out of what `make soak` found.

    python soak/load_page.py runs/soak docs --note "Measured on 2 cores."

It writes docs/load.json first, which stays in the repository: the page says what stands there.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FILES = ("steady", "curve", "kills", "browser")
IN_TIME = 0.99
COLUMNS = (
    ("phones", "devices"),
    ("within 200 ms", "within_200_ms"),
    ("p50, ms", "latency_p50_ms"),
    ("p99, ms", "latency_p99_ms"),
    ("age p50, ms", "age_p50_ms"),
    ("fixes seen, least and most", "fixes_seen_of_least_and_most"),
    ("refused", "refused"),
    ("most waiting", "most_waiting"),
    ("server, cores", "server_cores"),
)


def page(found: Mapping[str, Any]) -> str:
    """Return the page.

    Args:
        found: What docs/load.json holds: ``steady`` and ``curve`` (soak/load.py), ``kills``, ``browser``, ``note``.
    """
    steady, curve, kills, browser = found["steady"][0], found["curve"], found["kills"], found["browser"]
    numbers = ",".join(str(row["devices"]) for row in curve)
    in_time = max((row["devices"] for row in curve if row["within_200_ms"] >= IN_TIME), default=0)
    return f"""\
# The server under load

Written by `make soak`; do not edit. Phones and server share one machine, connections stay open, every phone
measures 8 access points five times a second and keeps what was not acknowledged. A fix is in time where a live
connection has it within 200 ms of when its tick was due; its age counts from the measurement.

{found["note"]}

## {steady["devices"]} phones for {steady["seconds"] / 60:g} minutes

`python soak/load.py --devices {steady["devices"]} --seconds {steady["seconds"]:g}`

- {_percent(steady["within_200_ms"])} of {steady["fixes_seen"]} fixes in time; half within \
{steady["latency_p50_ms"]:.0f} ms, 99 % within {steady["latency_p99_ms"]:.0f} ms.
- {steady["accepted"]} reading sets taken in, {steady["fixes_made"]} used, {_refused(steady["refused"])} uploads \
put off; at most {steady["most_waiting"]} waited.
- {steady["memory_mb"]:.0f} MB, {100 * steady["memory_growth"]:+.1f} % after the first minute; \
{steady["server_cores"]:.2f} cores.

## More and more phones

`python soak/load.py --devices {numbers} --seconds {curve[0]["seconds"]:g}`, a new server for each number:

| {" | ".join(title for title, _ in COLUMNS)} |
|{"---|" * len(COLUMNS)}
{chr(10).join(_row(row) for row in curve)}

99 % are in time up to {in_time} phones. Past that, ticks begin late; then every phone is held to the same time
between uploads (`fploc_upload_spacing_seconds`; answers `503` with `Retry-After`), live messages say `is_overloaded`
and the map says so. Phones send what they kept in one upload, which costs less. At most about 5000 reading sets of
a site wait; then nothing is taken in until there is room. Positions grow older, nothing acknowledged is lost. Far
past the deadline (300 phones and more) it is chance whose upload finds room, and shares differ.

## Killed in mid-load

`python soak/kills.py --kills {kills["kills"]}`: {kills["kills"]} times SIGKILL and a start; of \
{kills["acknowledged"]} acknowledged reading sets {kills["lost"]} were lost, and {kills["elsewhere"]} got another
position than in a session that never ended.

## The map with {browser["devices"]} phones

`python soak/browser.py --devices {browser["devices"]} --seconds {browser["seconds"]:g}`: Chromium's renderer takes \
{_percent(browser["renderer_cores"])} of a core, all processes of the
browser together {_percent(browser["all_processes_cores"])}, at {browser["size"]} without a graphics card and \
{browser["ticks_per_s"]:.1f} ticks a second.
"""


def _row(row: Mapping[str, Any]) -> str:
    return "| " + " | ".join(_cell(key, row[key]) for _, key in COLUMNS) + " |"


def _cell(key: str, value: Any) -> str:
    match key:
        case "within_200_ms":
            return _percent(value)
        case "refused":
            return str(_refused(value))
        case "fixes_seen_of_least_and_most":
            return f"{value[0]}, {value[1]}"
        case _:
            return f"{value:.0f}" if key.endswith("_ms") else str(value)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _refused(reasons: Mapping[str, int]) -> int:
    return sum(reasons.values())


def main() -> None:
    """Write docs/load.json and docs/load.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("found", type=Path, help="Folder of what was measured.")
    parser.add_argument("docs", type=Path, help="Folder to write.")
    parser.add_argument("--note", required=True, help="On the machine, and what else ran on it.")
    options = parser.parse_args()
    found = {name: json.loads((options.found / f"{name}.json").read_text("utf-8")) for name in FILES}
    found["note"] = options.note
    text = json.dumps(found, indent=2, ensure_ascii=False) + "\n"
    (options.docs / "load.json").write_text(text, encoding="utf-8")
    (options.docs / "load.md").write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
