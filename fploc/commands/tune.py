"""``fploc tune``: settings of a method, chosen on the source."""

from __future__ import annotations

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_data_root, add_printed_json, new_parser
from fploc.commands.printing import print_values

MEANING = "Choose a method's settings on the source."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Choose the settings of a method on the source and write them to conf/method/. "
        "Example: fploc tune --method nls-robust"
    )
    parser.add_argument("--method", type=str, required=True, help="Name of the method.")
    parser.add_argument("--trials", type=int, default=40, help="Settings to try, the same for every method.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the search.")
    add_data_root(parser)
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Write the settings found to the method's file, and print them.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.experiments.tune import tune, write_tuned

    tuned = tune(options.method, trials=options.trials, seed=options.seed, data_root=options.data_root)
    values = {**tuned.settings, "rmse before, m": tuned.before, "rmse after, m": tuned.after}
    print_values({**values, "written": str(write_tuned(options.method, tuned))}, as_json=bool(options.json))
