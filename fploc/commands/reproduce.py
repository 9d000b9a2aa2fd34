"""``fploc reproduce``: everything from public data to a comparison of methods."""

from __future__ import annotations

from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.named_sites import named_sites
from fploc.commands.options import add_printed_json, add_public_data, new_parser
from fploc.commands.printing import print_rows, print_values

MEANING = "Get data, train, evaluate, tabulate: `make reproduce`."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Get data, build, train, evaluate, tabulate. Resumes where it was interrupted. "
        "Example: fploc reproduce --preset smoke"
    )
    parser.add_argument(
        "--preset", type=str, default="default", help="smoke, default, full, published or paper."
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="Processes to run stages in side by side: one for each core."
    )
    add_public_data(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of everything written.")
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Run what is not done yet, and print the comparison.

    Raises:
        FplocError: For any bad input.
    """
    from dataclasses import asdict

    from fploc.experiments.reproduce import reproduce

    sites = None if options.sites is None else named_sites(options.sites)
    done = reproduce(options.preset, options.data_root, options.source, options.runs, sites, options.workers)
    if options.json:
        print_values(asdict(done), as_json=True)
        return
    title = "MADE-UP BUILDINGS, no real data" if done.made_up else "public data"
    print(f"\nPreset {done.preset}, {title}, {done.labels} labels, metres:")
    print_rows(done.rows, as_json=False)
    for name, place in done.places.items():
        hint = " (look at it with `make ui`)" if name == "MLflow" else ""
        print(f"{name:>10}: {place}{hint}")
