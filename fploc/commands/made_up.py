"""``fploc made-up``: a seeded building and its recordings."""

from __future__ import annotations

from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import add_printed_json, new_parser
from fploc.commands.printing import print_values

MEANING = "Write a made-up building and its recordings."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Write a seeded made-up building: plan, access points and phone logs, as the phone "
        "logger writes them. Example: fploc made-up --seed 7 --out building"
    )
    parser.add_argument("--seed", type=int, required=True, help="One seed, one building.")
    parser.add_argument("--out", type=Path, required=True, help="Folder to write.")
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Write the building, and print where its site file lies.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.sites.made_up import made_up_site

    site = made_up_site(options.seed, options.out)
    if options.json:
        files = sorted(str(path) for path in options.out.rglob("*") if path.is_file())
        print_values({"site": str(site), "seed": options.seed, "files": files}, as_json=True)
        return
    print(f"{site}: pack it with `fploc data build --sites {site}`")
