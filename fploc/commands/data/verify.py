"""``fploc data verify``."""

from __future__ import annotations

from dataclasses import asdict

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.named_sites import named_sites
from fploc.commands.options import add_printed_json, data_parser
from fploc.commands.printing import print_values

MEANING = "Check files against their hashes."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = data_parser(f"{MEANING} Example: fploc data verify --from DIR")
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Print which files are missing or altered.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.datasets.download import resolve_source
    from fploc.datasets.source_files import split_by_presence
    from fploc.datasets.verify import verify

    named = named_sites(options.sites)
    source = resolve_source(options.data_root, options.source, named)
    present, absent = split_by_presence(source, named)
    # A site that is asked for by name must be there; of all sites, those that are not are only listed.
    report = verify(source, present if options.sites is None else named)
    skipped = tuple(absent) if options.sites is None else ()
    values = asdict(report) | {"sites not there": skipped}
    if report.is_intact:
        values.pop("way_out")
    print_values(values, as_json=bool(options.json))
    report.require_intact()
