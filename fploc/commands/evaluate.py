"""``fploc evaluate``: scores of a method on a packed site."""

from __future__ import annotations

from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.options import PRINTED, add_config, add_data_root, add_trained, new_parser
from fploc.commands.printing import print_columns
from fploc.errors import FplocError

MEANING = "Score a method on a packed site."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = new_parser(
        "Score a method. Example: fploc evaluate --method nls --protocol zero-shot "
        "--site shopping-mall --device 1 --json -"
    )
    add_config(parser)
    parser.add_argument("--method", type=str, required=True, help="nls, bayes-grid, gnn-fpdnn, …")
    parser.add_argument(
        "--protocol", type=str, default="zero-shot", help="What it may have learned from: seen, zero-shot, …"
    )
    parser.add_argument("--site", type=str, required=True, help="Packed site to score on.")
    parser.add_argument("--device", type=str, default="all", help="1, 2 or all.")
    parser.add_argument("--calibration", type=str | None, default=None, help="none, source-los, … or metres.")
    parser.add_argument("--labels", type=str, default="both", help="published, repaired or both.")
    parser.add_argument(
        "--plan",
        type=str,
        default="real",
        help="real, blank (nothing drawn), length (of crops, no image), none, or the name of another site.",
    )
    parser.add_argument("--speed-prior", type=float, default=0.5, help="Speed of people, metres per second.")
    parser.add_argument("--thin", type=int, default=1, help="Keep every so many-th interval.")
    parser.add_argument(
        "--smoother", action="store_true", help="Offline: smooth every position by what came after it."
    )
    add_data_root(parser)
    add_trained(parser)
    parser.add_argument(
        "--json",
        type=str,
        nargs="?",
        const=PRINTED,
        default="",
        help="File to write records to; - or nothing after it prints them.",
    )
    return parser


def run(options: Namespace) -> None:
    """Print the scores, or write them to a file.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.evaluation.evaluate import EvaluationRequest
    from fploc.evaluation.records import write_records
    from fploc.experiments.scoring import DEFAULT_CALIBRATION, answer

    if options.json not in ("", PRINTED):
        _require_place(Path(options.json))
    request = EvaluationRequest(
        protocol=options.protocol,
        site=options.site,
        device=options.device,
        calibration=DEFAULT_CALIBRATION if options.calibration is None else options.calibration,
        labels=options.labels,
        plan=options.plan,
        speed_prior=options.speed_prior,
        thin=options.thin,
        smoother=options.smoother,
        preset=options.preset,
        seed=options.seed,
    )
    answered = answer(options.method, request, options.calibration, options.data_root, options.runs)
    records = [record.as_json() for record in answered]
    if options.json not in ("", PRINTED):
        write_records(answered, Path(options.json))
    columns = ("device", "labels", "filter", "n", "no_fix_share", "rmse_m", "rmse_fixed_m", "p50_m", "p90_m")
    print_columns(records, columns, as_json=options.json == PRINTED)


def _require_place(file: Path) -> None:
    """Do nothing where ``--json FILE`` can be written, before anything is evaluated for it."""
    if file.is_dir() or not file.parent.is_dir():
        raise FplocError(
            f"--json {file}",
            value="a folder" if file.is_dir() else f"no folder {file.parent}",
            expected="a file in a folder that exists",
            way_out="name a file in it" if file.is_dir() else "make the folder or name another",
        )
