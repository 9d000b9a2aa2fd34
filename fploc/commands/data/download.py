"""``fploc data download``."""

from __future__ import annotations

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.named_sites import named_sites
from fploc.commands.options import add_printed_json, data_parser
from fploc.commands.printing import print_values

MEANING = "Fetch the public files that the sites need."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = data_parser(f"{MEANING} Example: fploc data download --sites office")
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Fetch what is missing, and print where it lies.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.datasets.download import resolve_source

    sites = named_sites(options.sites)
    source = resolve_source(options.data_root, options.source, sites)
    print_values({"source": str(source), "sites": sites}, as_json=bool(options.json))
