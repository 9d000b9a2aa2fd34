"""``fploc model``: the default method, trained."""

from __future__ import annotations

from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_artifacts, add_data_root, add_printed_json, listed, new_parser
from fploc.commands.printing import print_columns

MEANING = "Train the default method."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Train the default method without each place that it learns at otherwise, and with all of "
        "them where --out is given. Example: fploc model --sites laboratory"
    )
    parser.add_argument(
        "--sites",
        type=str | None,
        default=None,
        help="Packed sites to leave out, commas between. Default: all.",
    )
    parser.add_argument(
        "--out", type=Path | None, default=None, help="Folder to write what ships to. Default: none."
    )
    add_data_root(parser)
    add_artifacts(parser)
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Train it, and print its scores at the places left out.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.experiments.model import make_model

    sites = None if options.sites is None else listed(options.sites)
    records = [one.as_json() for one in make_model(sites, options.data_root, options.runs, options.out)]
    columns = ("protocol", "site", "device", "n", "rmse_m", "p50_m", "p90_m", "coverage95", "nees")
    print_columns(records, columns, as_json=bool(options.json))
