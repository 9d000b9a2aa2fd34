"""``fploc synthesize``: what the generator says of a site."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_artifacts, add_config, add_data_root, add_printed_json, new_parser
from fploc.commands.printing import print_rows

MEANING = "Draw what the trained generator says of a packed site."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Maps of synthetic RTT and RSS, and their match with measurements. "
        "Example: fploc synthesize --site office"
    )
    add_config(parser)
    parser.add_argument("--site", type=str, required=True, help="Packed site to synthesize.")
    parser.add_argument("--source", type=str, default="office", help="Site that the generator learned on.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the generator and of its samples.")
    parser.add_argument("--preset", type=str, default="default", help="Preset that trained the generator.")
    add_data_root(parser)
    add_artifacts(parser)
    parser.add_argument(
        "--out", type=Path | None, default=None, help="Folder to write. Default: synthetic/SITE below --runs."
    )
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Write the maps, and print how the generator matches measurements.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.evaluation.generator_match import printed_rows
    from fploc.experiments.synthesize import synthesize
    from fploc.progress import busy

    with busy(f"synthesize {options.site}"):
        done = synthesize(
            options.site,
            source=options.source,
            preset_name=options.preset,
            seed=options.seed,
            data_root=options.data_root,
            runs=options.runs,
            out=options.runs / "synthetic" / options.site if options.out is None else options.out,
        )
    if options.json:
        print(json.dumps(done.match, indent=2))
    else:
        made_up = ", MADE-UP BUILDING, no real data" if done.match["made_up"] else ""
        print(f"{options.site}{made_up}: {done.match['kind']}")
        if done.match["rows"]:
            print_rows(printed_rows(done.match), as_json=False)
        else:
            print("no recording with positions to compare with: maps only")
    for path in done.files:
        print(f"written: {path}", file=sys.stderr)
