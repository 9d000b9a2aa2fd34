"""docs/load.md, out of what `make soak` found.

    python soak/load_page.py runs/soak docs --note "Measured on 2 cores."

It writes docs/load.json first, which stays in the repository: the page says what stands there.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fploc.evaluation.facts_sections import IN_TIME

FILES = ("steady", "curve", "kills", "browser")
COLUMNS = (
    ("phones", "devices"),
    ("within 200 ms", "within_200_ms"),
    ("p50, ms", "latency_p50_ms"),
    ("p99, ms", "latency_p99_ms"),
    ("age p50, ms", "age_p50_ms"),
    ("taken in, least and most", "accepted_of_least_and_most"),
    ("fairness", "accepted_fairness"),
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
    kills, browser = found["kills"], found["browser"]
    return f"""\
# The server under load

Written by `make soak`; do not edit. Phones and server share one machine, connections stay open, every phone
measures 8 access points five times a second and keeps what was not acknowledged. A fix is in time where a live
connection has it within 200 ms of when its tick was due; its age counts from the measurement. `default` is what
`fploc serve` serves unless told otherwise.

{found["note"]}

## The same load for minutes

{chr(10).join(_steady(row) for row in found["steady"])}
## More and more phones

A new server for each number. Fairness is Jain's index of what was taken in of each phone: 1 where all got the same.

{chr(10).join(_curve(method, rows) for method, rows in curves(found).items())}
Past that, ticks begin late or reading sets wait, and phones stand in line: as much is let in as comes out, each
phone has one place, and its next upload goes to the end (answers `503` with `Retry-After`;
`fploc_upload_wait_seconds` says how long the line is). Live messages say `is_overloaded` and the map says so. Phones
send what they kept in one upload, which costs less. At most about 5000 reading sets of a site wait; then nothing is
taken in until there is room, and who was refused keeps the turn. Positions grow older, nothing acknowledged is lost.

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


def curves(found: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the rows of each method's curve, in the order of the methods."""
    methods = dict.fromkeys(row["method"] for row in found["curve"])
    return {method: [row for row in found["curve"] if row["method"] == method] for method in methods}


def most_in_time(rows: Sequence[Mapping[str, Any]]) -> int:
    """Return the largest number of phones of a curve whose fixes are in time; 0 where there is none."""
    return max((row["devices"] for row in rows if row["within_200_ms"] >= IN_TIME), default=0)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a curve as a Markdown table."""
    head = f"| {' | '.join(title for title, _ in COLUMNS)} |\n|{'---|' * len(COLUMNS)}"
    return "\n".join([head, *(_row(row) for row in rows)])


def _steady(row: Mapping[str, Any]) -> str:
    return f"""\
`python soak/load.py --method {row["method"]} --devices {row["devices"]} --seconds {row["seconds"]:g}`

- {_percent(row["within_200_ms"])} of {row["fixes_seen"]} fixes in time; half within \
{row["latency_p50_ms"]:.0f} ms, 99 % within {row["latency_p99_ms"]:.0f} ms.
- {row["accepted"]} reading sets taken in, {row["fixes_made"]} used, {_refused(row["refused"])} uploads \
put off; at most {row["most_waiting"]} waited.
- {row["memory_mb"]:.0f} MB, {100 * row["memory_growth"]:+.1f} % after the first minute; \
{row["server_cores"]:.2f} cores.
"""


def _curve(method: str, rows: Sequence[Mapping[str, Any]]) -> str:
    numbers = ",".join(str(row["devices"]) for row in rows)
    return f"""\
`python soak/load.py --method {method} --devices {numbers} --seconds {rows[0]["seconds"]:g}`:

{table(rows)}

With `{method}` 99 % are in time up to {most_in_time(rows)} phones.
"""


def _row(row: Mapping[str, Any]) -> str:
    return "| " + " | ".join(_cell(key, row.get(key)) for _, key in COLUMNS) + " |"


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "–"
    match key:
        case "within_200_ms":
            return _percent(value)
        case "refused":
            return str(_refused(value))
        case "accepted_of_least_and_most" | "fixes_seen_of_least_and_most":
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
