"""The card that goes with the trained default method: what it is for, what it learned from, how good it is."""

from __future__ import annotations

from collections.abc import Sequence

from fploc.datasets.pages import markdown_grid
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import Record
from fploc.evaluation.tables import UNKNOWN, plain
from fploc.shipped import POOLED, SHIPPING_COMMAND, SOURCE_ONLY

_CARD = """# Model card: `{method}`, trained

Written by `{command}` (`make model`), which trains both artifacts below this folder again to the same numbers.

**What it does.** Ranges (WiFi round-trip time), signal strengths and, where there is one, a floor plan go in;
positions with covariances come out, causally, for one building with known coordinates of its access points.
`fploc/methods/learned_grid.py` says how; `docs/past-choices.md` how its settings were chosen.

**What it learned from.** `{pooled}`: all recordings of the local public sites, both phones; places weigh alike
(the four layouts on the office's floor are one), then sites, then devices. `{source}`: laps 1, 2 and 4 of the office,
for protocols that allow no more. Recordings, hashes of the data, the range offset, settings and seed stand in each
`artifact.json`. The measurements are those of the public repository named in the README (MIT).

**How good it is** at places that it did not see: what is scored here was trained without the place it is scored at.
Repaired labels, RMSE with the last fix held. These are development sites: methods were chosen looking at them.

{table}
**Limits.** The offset is that of two phones of the public recordings; other phones may need another
(`--calibration`). It learned from a robot that moves at 0.05 to 0.1 m/s, in four places, one of them a mall.
Where the stated 95 % region holds less than 90 % above, its covariance is too small.
"""


def model_card(records: Sequence[Record]) -> str:
    """Return the card as Markdown.

    Args:
        records: Of the trained method at places that it did not see.
    """
    rows = [
        {
            "learned from": protocol_of(one.protocol).meaning,
            "site": one.site,
            "device": str(one.device),
            "RMSE [m]": plain(one.rmse_m),
            "median [m]": plain(one.p50_m),
            "90 % [m]": plain(one.p90_m),
            "in the stated 95 % region": UNKNOWN
            if one.coverage95 is None
            else f"{100 * one.coverage95:.0f} %",
            "NEES": plain(one.nees),
        }
        for one in records
    ]
    return _CARD.format(
        method=POOLED.method,
        command=SHIPPING_COMMAND,
        pooled=POOLED.protocol,
        source=SOURCE_ONLY.protocol,
        table=markdown_grid(rows),
    )
