"""``fploc data describe``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.named_sites import packed_names
from fploc.commands.options import add_printed_json, data_parser
from fploc.commands.printing import print_rows

MEANING = "Count what packed sites hold, write their data cards."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = data_parser(f"{MEANING} Example: fploc data describe --out cards")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/data-cards"),
        help="Folder of cards (HTML, Markdown) and pictures.",
    )
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Print what packed sites hold, and write their cards.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.datasets.data_card import write_cards
    from fploc.datasets.describe import describe, table_rows

    sites = packed_names(options)
    descriptions = describe(options.data_root, sites)
    if options.json:
        print(json.dumps([description.to_json() for description in descriptions], indent=2))
    else:
        print_rows(table_rows(descriptions), as_json=False)
    for path in write_cards(options.data_root, sites, options.out):
        print(f"written: {path}", file=sys.stderr)
