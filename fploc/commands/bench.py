"""``fploc bench``: the time of a fix."""

from __future__ import annotations

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_data_root, add_printed_json, add_trained, listed, new_parser
from fploc.commands.printing import print_columns

MEANING = "Time one fix of every method."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Time one fix of every method, single and in a batch, with one thread and with all. "
        "Example: fploc bench --site shopping-mall"
    )
    parser.add_argument(
        "--site", type=str, default="shopping-mall", help="Packed site to take readings from."
    )
    parser.add_argument(
        "--methods", type=str | None, default=None, help="Names, commas between. Default: all."
    )
    parser.add_argument("--fixes", type=int, default=1000, help="How many to time at least.")
    parser.add_argument(
        "--batch", type=int, default=64, help="Devices that one call localizes, beside single ones."
    )
    add_data_root(parser)
    add_trained(parser)
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Print the times of every method.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.experiments.bench import bench

    named = None if options.methods is None else listed(options.methods)
    timings = bench(
        options.site,
        named,
        fixes=options.fixes,
        batch=options.batch,
        preset=options.preset,
        seed=options.seed,
        data_root=options.data_root,
        runs=options.runs,
    )
    rows = [timing.as_json() for timing in timings]
    print_columns(rows, list(rows[0]), as_json=bool(options.json))
