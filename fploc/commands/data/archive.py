"""``fploc data archive``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.named_sites import packed_names
from fploc.commands.options import add_printed_json, data_parser
from fploc.commands.printing import print_values

MEANING = "Put packed sites into one file to deposit."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = data_parser(f"{MEANING} Example: fploc data archive --out data.zip")
    parser.add_argument("--out", type=Path, default=Path("runs/fploc-data.zip"), help="File to write.")
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Write the file, and print what is in it.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.datasets.archive import write_archive
    from fploc.datasets.origin import MADE_UP, origin_of
    from fploc.datasets.packed import packed_folder, read_manifest

    sites = packed_names(options)
    if options.sites is None:
        # Made-up buildings are packed beside public sites by some runs: unasked, they stay where they are.
        origins = {site: origin_of(read_manifest(packed_folder(options.data_root, site))) for site in sites}
        sites = [site for site in sites if origins[site] != MADE_UP] or sites
    report = write_archive(options.data_root, sites, options.out)
    print_values(asdict(report), as_json=bool(options.json))
