"""The command ``fploc``. Everything heavy is imported by the sub-command that needs it."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jsonargparse import ActionConfigFile, ArgumentError, ArgumentParser, Namespace

from fploc.errors import FplocError, UnknownNameError
from fploc.files import advice
from fploc.progress import hush_imports
from fploc.usage import HelpFormatter, usage_message

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fploc.sites.registry import SiteSpec

BAD_INPUT = 2
INTERRUPTED = 130
DATA_VARIABLE = "FPLOC_DATA"
DATA_COMMANDS = {
    "download": "Fetch the public files that the sites need. Example: fploc data download --sites office",
    "verify": "Check files against their hashes. Example: fploc data verify --from DIR",
    "build": "Pack sites. Example: fploc data build --from DIR --sites office,laboratory",
    "describe": "Count what packed sites hold, write their data cards. Example: fploc data describe --out cards",
    "archive": "Put packed sites into one file to deposit. Example: fploc data archive --out data.zip",
}
MEANINGS = {
    "data": "Fetch, check, pack, describe and archive public data.",
    "made-up": "Write a made-up building and its recordings.",
    "evaluate": "Score a method on a packed site.",
    "reproduce": "Get data, train, evaluate, tabulate: `make reproduce`.",
    "fit": "Train one network (LightningCLI).",
    "tune": "Choose a method's settings on the source.",
    "model": "Train the default method.",
    "synthesize": "Draw what the trained generator says of a packed site.",
    "bench": "Time one fix of every method.",
    "serve": "Take in what phones send, show where they are.",
    "replay": "Send recordings as phones would.",
    "completion": "Print what makes a shell complete these words.",
}
"""In the order in which they are met."""
COMMANDS = {"": tuple(MEANINGS), "data": tuple(DATA_COMMANDS), "serve": ("token",)}
SHELLS = ("bash", "zsh")
PRINTED = "-"
SITE_FILES = (".yaml", ".yml")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 for bad input, 130 when interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    hush_imports()
    try:
        if words[:1] == ["fit"]:
            return _fit(words[1:])
        code = _runner(make_parser().parse_args(words))
        sys.stdout.flush()
        return code
    except FplocError as error:
        return _fail(str(error), BAD_INPUT)
    except ArgumentError as error:
        return _fail(usage_message(str(error), words, COMMANDS), BAD_INPUT)
    except BrokenPipeError:
        # Whoever read the output has had enough; Python must not try to flush the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        path = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else None
        place = "" if path is None else f"{path}: "
        reason = error.strerror or str(error)
        return _fail(f"{place}{reason}; {advice(error, path)}, and run again", BAD_INPUT)
    except KeyboardInterrupt:
        return _fail("interrupted; the next call goes on from the last finished step", INTERRUPTED)


def make_parser() -> ArgumentParser:
    """Return the parser of every sub-command but ``fit``, which is Lightning's own."""
    parser = ArgumentParser(
        prog="fploc",
        description="Find people and things indoors from WiFi round-trip time and a floor plan. "
        "Example: fploc made-up --seed 7 --out building",
        version=_version(),
        exit_on_error=False,
        formatter_class=HelpFormatter,
    )
    parsers = {
        "data": ArgumentParser(
            description="The public data set: fetch, check, pack and describe it. "
            "Example: fploc data build --sites office,laboratory",
            exit_on_error=False,
        ),
        "made-up": _made_up_parser(),
        "evaluate": _evaluate_parser(),
        "reproduce": _reproduce_parser(),
        "fit": ArgumentParser(exit_on_error=False),
        "tune": _tune_parser(),
        "model": _model_parser(),
        "synthesize": _synthesize_parser(),
        "bench": _bench_parser(),
        "serve": _serve_parser(),
        "replay": _replay_parser(),
        "completion": _completion_parser(),
    }
    _add_commands(parser, "command", {name: (parsers[name], text) for name, text in MEANINGS.items()})
    _add_commands(
        parsers["data"],
        "data_command",
        {name: (_data_parser(name, text), text.split(". ")[0] + ".") for name, text in DATA_COMMANDS.items()},
    )
    tokens = {"token": (_token_parser(), "Make a token for a phone or a reader.")}
    _add_commands(parsers["serve"], "serve_command", tokens, required=False)
    return parser


def _add_commands(
    parser: ArgumentParser,
    dest: str,
    parsers: Mapping[str, tuple[ArgumentParser, str]],
    *,
    required: bool = True,
) -> None:
    """Add sub-commands, each with its parser and its line in the list of ``parser``."""
    commands = parser.add_subcommands(
        required=required,
        dest=dest,
        title=f"commands (`{parser.prog} COMMAND --help` explains each)",
        description=" ",
        metavar="COMMAND",
    )
    for name, (own, meaning) in parsers.items():
        commands.add_subcommand(name, own, help=meaning)
        own.prog = f"{parser.prog} {name}"


def _data_parser(name: str, text: str) -> ArgumentParser:
    parser = ArgumentParser(description=text, exit_on_error=False)
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")
    _add_data_options(parser)
    if name == "describe":
        parser.add_argument(
            "--out",
            type=Path,
            default=Path("runs/data-cards"),
            help="Folder of cards (HTML, Markdown) and pictures.",
        )
    if name == "archive":
        parser.add_argument("--out", type=Path, default=Path("runs/fploc-data.zip"), help="File to write.")
    _add_printed_json(parser)
    return parser


def _add_printed_json(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--json",
        type=str,
        nargs="?",
        const=PRINTED,
        choices=["", PRINTED],
        metavar=PRINTED,
        default="",
        help="Print JSON instead of a table; --json - is the same.",
    )


def _add_data_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--from",
        type=Path | None,
        dest="source",
        default=None,
        help="Local copy of the public files, laid out <revision>/<path>. Default: FPLOC_SOURCE.",
    )
    _add_data_root(parser)
    parser.add_argument(
        "--sites",
        type=str | None,
        default=None,
        help="Names, separated by commas, or site files. Default: all.",
    )


def _add_data_root(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--data-root",
        type=Path,
        default=Path(os.environ.get(DATA_VARIABLE, "data")),
        help="Folder of the data. Default: FPLOC_DATA, else ./data.",
    )


def _made_up_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Write a seeded made-up building: plan, access points and phone logs, as the phone "
        "logger writes them. Example: fploc made-up --seed 7 --out building",
        exit_on_error=False,
    )
    parser.add_argument("--seed", type=int, required=True, help="One seed, one building.")
    parser.add_argument("--out", type=Path, required=True, help="Folder to write.")
    _add_printed_json(parser)
    return parser


def _synthesize_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Maps of synthetic RTT and RSS, and their match with measurements. "
        "Example: fploc synthesize --site office",
        exit_on_error=False,
    )
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")
    parser.add_argument("--site", type=str, required=True, help="Packed site to synthesize.")
    parser.add_argument("--source", type=str, default="office", help="Site that the generator learned on.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the generator and of its samples.")
    parser.add_argument("--preset", type=str, default="default", help="Preset that trained the generator.")
    _add_data_root(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of trained artifacts.")
    parser.add_argument(
        "--out", type=Path | None, default=None, help="Folder to write. Default: synthetic/SITE below --runs."
    )
    _add_printed_json(parser)
    return parser


def _evaluate_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Score a method. Example: fploc evaluate --method nls --protocol zero-shot "
        "--site shopping-mall --device 1 --json -",
        exit_on_error=False,
    )
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")
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
    parser.add_argument("--seed", type=int, default=0, help="Seed of the trained artifact.")
    parser.add_argument("--preset", type=str, default="default", help="Preset of the trained artifact.")
    _add_data_root(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of trained artifacts.")
    parser.add_argument(
        "--json",
        type=str,
        nargs="?",
        const=PRINTED,
        default="",
        help="File to write records to; - or nothing after it prints them.",
    )
    return parser


def _tune_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Choose the settings of a method on the source and write them to conf/method/. "
        "Example: fploc tune --method nls-robust",
        exit_on_error=False,
    )
    parser.add_argument("--method", type=str, required=True, help="Name of the method.")
    parser.add_argument("--trials", type=int, default=40, help="Settings to try, the same for every method.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the search.")
    _add_data_root(parser)
    _add_printed_json(parser)
    return parser


def _model_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Train the default method without each place that it learns at otherwise, and with all of "
        "them where --out is given. Example: fploc model --sites laboratory",
        exit_on_error=False,
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
    _add_data_root(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of trained artifacts.")
    _add_printed_json(parser)
    return parser


def _bench_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Time one fix of every method, single and in a batch, with one thread and with all. "
        "Example: fploc bench --site shopping-mall",
        exit_on_error=False,
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
    parser.add_argument("--seed", type=int, default=0, help="Seed of trained artifacts.")
    parser.add_argument("--preset", type=str, default="default", help="Preset of trained artifacts.")
    _add_data_root(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of trained artifacts.")
    _add_printed_json(parser)
    return parser


def _reproduce_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Get data, build, train, evaluate, tabulate. Resumes where it was interrupted. "
        "Example: fploc reproduce --preset smoke",
        exit_on_error=False,
    )
    parser.add_argument(
        "--preset", type=str, default="default", help="smoke, default, full, published or paper."
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="Processes to run stages in side by side: one for each core."
    )
    _add_data_options(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of everything written.")
    _add_printed_json(parser)
    return parser


def _serve_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Take in what phones send, localize them every tick, show them on a map. "
        "Example: fploc serve --site shopping-mall",
        exit_on_error=False,
    )
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")
    parser.add_argument(
        "--site", type=str | None, default=None, help="Packed sites, names or folders, commas between."
    )
    parser.add_argument("--model", type=str, default="default", help="Name of the method.")
    parser.add_argument("--calibration", type=str | None, default=None, help="none, source-los, … or metres.")
    parser.add_argument(
        "--speed-prior", type=float | None, default=None, help="Of people, m/s. Default: of the settings."
    )
    parser.add_argument("--seed", type=int, default=0, help="Seed of the trained artifact.")
    parser.add_argument("--preset", type=str, default="default", help="Preset of the trained artifact.")
    parser.add_argument(
        "--settings", type=str, default="default", help="Limits and times: conf/serve/NAME.yaml."
    )
    parser.add_argument("--host", type=str, default="127.0.0.1", help="Address to listen at.")
    parser.add_argument("--port", type=int, default=8000, help="Port to listen at; 0 takes a free one.")
    _add_database(parser)
    _add_data_root(parser)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="Folder of trained artifacts.")
    return parser


def _add_database(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--state", type=Path, default=Path("runs/serve"), help="Folder of the database, where none is named."
    )
    parser.add_argument(
        "--database", type=str | None, default=None, help="URL: sqlite:////folder/file.db or postgresql://…"
    )


def _token_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Make a token; it is shown once. Example: fploc serve token --name phone-7 --scope upload",
        exit_on_error=False,
    )
    parser.add_argument("--name", type=str, default="token", help="What it is for.")
    parser.add_argument("--scope", type=str, default="upload", help="upload, read, admin; commas between.")
    parser.add_argument("--days", type=float, default=365.0, help="How long it is valid.")
    parser.add_argument(
        "--expire", type=str | None, default=None, help="Id of a token that ends now instead."
    )
    _add_database(parser)
    return parser


def _replay_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Send recordings of a packed site to a server, as phones would. "
        "Example: fploc replay --site shopping-mall --speed 5 --token fploc_…",
        exit_on_error=False,
    )
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")
    parser.add_argument("--site", type=str, required=True, help="Packed site to take recordings from.")
    parser.add_argument("--device", type=str, default="all", help="1, 2 or all.")
    parser.add_argument(
        "--recordings", type=str | None, default=None, help="Names, commas between. Default: all."
    )
    parser.add_argument(
        "--phones", type=int | None, default=None, help="How many. Default: one for each recording."
    )
    parser.add_argument("--url", type=str, default="http://127.0.0.1:8000", help="Of the server.")
    parser.add_argument("--to", type=str | None, default=None, help="Site of the server. Default: --site.")
    parser.add_argument("--token", type=str | None, default=None, help="With the scope upload.")
    parser.add_argument("--speed", type=float, default=1.0, help="Seconds of the recording in one second.")
    parser.add_argument("--drop", type=float, default=0.0, help="Share of reading sets that get lost.")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="Longest delay of a reading set.")
    parser.add_argument("--seed", type=int, default=0, help="Of what is lost and late.")
    _add_data_root(parser)
    _add_printed_json(parser)
    return parser


def _completion_parser() -> ArgumentParser:
    parser = ArgumentParser(
        description="Print the script that makes a shell complete sub-commands, options and names. "
        "Example: fploc completion bash > ~/.local/share/bash-completion/completions/fploc",
        exit_on_error=False,
    )
    parser.add_argument("shell", type=str, choices=SHELLS, help="bash or zsh.")
    return parser


def _runner(options: Namespace) -> int:
    runners: Mapping[str, Callable[[Namespace], None]] = {
        "data": _run_data,
        "made-up": _run_made_up,
        "synthesize": _run_synthesize,
        "evaluate": _run_evaluate,
        "tune": _run_tune,
        "model": _run_model,
        "bench": _run_bench,
        "reproduce": _run_reproduce,
        "serve": _run_serve,
        "replay": _run_replay,
        "completion": _run_completion,
    }
    runners[options.command](options[options.command])
    return 0


def _run_data(options: Namespace) -> None:
    runners: Mapping[str, Callable[[Namespace], None]] = {
        "download": _run_download,
        "verify": _run_verify,
        "build": _run_build,
        "describe": _run_describe,
        "archive": _run_archive,
    }
    runners[options.data_command](options[options.data_command])


def _run_download(options: Namespace) -> None:
    from fploc.datasets.download import resolve_source

    sites = _named_sites(options.sites)
    source = resolve_source(options.data_root, options.source, sites)
    _print({"source": str(source), "sites": sites}, as_json=bool(options.json))


def _run_verify(options: Namespace) -> None:
    from dataclasses import asdict

    from fploc.datasets.download import resolve_source
    from fploc.datasets.source_files import split_by_presence
    from fploc.datasets.verify import verify

    named = _named_sites(options.sites)
    source = resolve_source(options.data_root, options.source, named)
    present, absent = split_by_presence(source, named)
    # A site that is asked for by name must be there; of all sites, those that are not are only listed.
    report = verify(source, present if options.sites is None else named)
    skipped = tuple(absent) if options.sites is None else ()
    values = asdict(report) | {"sites not there": skipped}
    if report.is_intact:
        values.pop("way_out")
    _print(values, as_json=bool(options.json))
    report.require_intact()


def _run_build(options: Namespace) -> None:
    from fploc.datasets.build import build_site
    from fploc.datasets.download import resolve_source
    from fploc.progress import track
    from fploc.sites.registry import load_spec

    specs = [load_spec(name) for name in _named_sites(options.sites)]
    public = [spec.site.name for spec in specs if spec.plan.file.revision is not None]
    source = resolve_source(options.data_root, options.source, public) if public else None
    reports = [build_site(spec, source, options.data_root) for spec in track(specs, "build")]
    if options.sites is not None:
        _report_absent(
            [spec for spec, report in zip(specs, reports, strict=True) if report.state == "absent"],
            source,
            of=len(specs),
        )
    rows = [
        {
            "site": report.site,
            "state": report.state,
            "missing files": str(len(report.missing)),
            "seconds": f"{report.seconds:.1f}",
            "folder": str(report.folder) if report.state != "absent" else "",
        }
        for report in reports
    ]
    _print_rows(rows, as_json=bool(options.json))
    built = [report.site for report in reports if report.state != "absent"]
    if built and not options.json:
        from fploc.datasets.describe import describe, table_rows

        _print_rows(table_rows(describe(options.data_root, built)), as_json=False)


def _report_absent(specs: Sequence[SiteSpec], source: Path | None, *, of: int) -> None:
    """Say which sites, asked for by name, have no recording where it should be.

    Raises:
        FplocError: If these are all that were asked for.
    """
    errors = [_absent(spec, source) for spec in specs]
    if len(errors) == of:
        raise (
            errors[0]
            if of == 1
            else FplocError(
                "--sites",
                value=f"no recording of {', '.join(spec.site.name for spec in specs)}",
                expected="at least one site with recordings",
                way_out=errors[0].way_out,
            )
        )
    for error in errors:
        _fail(f"skipped {error}", BAD_INPUT)


def _absent(spec: SiteSpec, source: Path | None) -> FplocError:
    name = spec.site.name
    own = all(file.revision is None for file in spec.files)
    return FplocError(
        f"--sites {name}",
        value=f"no recording of it in {spec.path.parent if own else source}",
        expected="at least one of those that its site file lists",
        way_out=f"correct the paths in {spec.path}"
        if own
        else f"fetch it with `fploc data download --sites {name}`, or point --from at a copy that has it",
    )


def _run_describe(options: Namespace) -> None:
    from fploc.datasets.data_card import write_cards
    from fploc.datasets.describe import describe, table_rows

    sites = _packed_names(options)
    descriptions = describe(options.data_root, sites)
    if options.json:
        print(json.dumps([description.to_json() for description in descriptions], indent=2))  # noqa: T201
    else:
        _print_rows(table_rows(descriptions), as_json=False)
    for path in write_cards(options.data_root, sites, options.out):
        print(f"written: {path}", file=sys.stderr)  # noqa: T201


def _run_archive(options: Namespace) -> None:
    from dataclasses import asdict

    from fploc.datasets.archive import write_archive
    from fploc.datasets.origin import MADE_UP, origin_of
    from fploc.datasets.packed import packed_folder, read_manifest

    sites = _packed_names(options)
    if options.sites is None:
        # Made-up buildings are packed beside public sites by some runs: unasked, they stay where they are.
        origins = {site: origin_of(read_manifest(packed_folder(options.data_root, site))) for site in sites}
        sites = [site for site in sites if origins[site] != MADE_UP] or sites
    report = write_archive(options.data_root, sites, options.out)
    _print(asdict(report), as_json=bool(options.json))


def _packed_names(options: Namespace) -> list[str]:
    """Return the packed sites that ``--sites`` names; all of them without it."""
    from fploc.datasets.packed import packed_sites

    sites = packed_sites(options.data_root)
    if options.sites is None:
        return sites
    return [_packed_name(name) for name in _named_sites(options.sites, also=sites)]


def _packed_name(name_or_file: str) -> str:
    from fploc.sites.registry import load_spec

    return load_spec(name_or_file).site.name if name_or_file.endswith(SITE_FILES) else name_or_file


def _run_made_up(options: Namespace) -> None:
    from fploc.sites.made_up import made_up_site

    site = made_up_site(options.seed, options.out)
    if options.json:
        files = sorted(str(path) for path in options.out.rglob("*") if path.is_file())
        _print({"site": str(site), "seed": options.seed, "files": files}, as_json=True)
        return
    print(f"{site}: pack it with `fploc data build --sites {site}`")  # noqa: T201


def _run_synthesize(options: Namespace) -> None:
    from fploc.evaluation.generator_match import printed_rows
    from fploc.experiments.synthesize import synthesize
    from fploc.progress import busy

    with busy(f"synthesize {options.site}"):
        done = synthesize(
            options.site,
            source=options.source,
            preset_name=options.preset,
            seed=options.seed,
            data_root=options.data_root,
            runs=options.runs,
            out=options.runs / "synthetic" / options.site if options.out is None else options.out,
        )
    if options.json:
        print(json.dumps(done.match, indent=2))  # noqa: T201
    else:
        made_up = ", MADE-UP BUILDING, no real data" if done.match["made_up"] else ""
        print(f"{options.site}{made_up}: {done.match['kind']}")  # noqa: T201
        if done.match["rows"]:
            _print_rows(printed_rows(done.match), as_json=False)
        else:
            print("no recording with positions to compare with: maps only")  # noqa: T201
    for path in done.files:
        print(f"written: {path}", file=sys.stderr)  # noqa: T201


def _run_evaluate(options: Namespace) -> None:
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
    if options.json == PRINTED:
        print(json.dumps(records, indent=2))  # noqa: T201
        return
    if options.json:
        write_records(answered, Path(options.json))
    columns = ("device", "labels", "filter", "n", "no_fix_share", "rmse_m", "rmse_fixed_m", "p50_m", "p90_m")
    _print_rows([{name: _text(record[name]) for name in columns} for record in records], as_json=False)


def _require_place(file: Path) -> None:
    """Do nothing where ``--json FILE`` can be written, before anything is evaluated for it."""
    if file.is_dir() or not file.parent.is_dir():
        raise FplocError(
            f"--json {file}",
            value="a folder" if file.is_dir() else f"no folder {file.parent}",
            expected="a file in a folder that exists",
            way_out="name a file in it" if file.is_dir() else "make the folder or name another",
        )


def _run_tune(options: Namespace) -> None:
    from fploc.experiments.tune import tune, write_tuned

    tuned = tune(options.method, trials=options.trials, seed=options.seed, data_root=options.data_root)
    values = {**tuned.settings, "rmse before, m": tuned.before, "rmse after, m": tuned.after}
    _print({**values, "written": str(write_tuned(options.method, tuned))}, as_json=bool(options.json))


def _run_model(options: Namespace) -> None:
    from fploc.experiments.model import make_model

    sites = None if options.sites is None else [name.strip() for name in options.sites.split(",")]
    records = [one.as_json() for one in make_model(sites, options.data_root, options.runs, options.out)]
    if options.json:
        print(json.dumps(records, indent=2))  # noqa: T201
        return
    columns = ("protocol", "site", "device", "n", "rmse_m", "p50_m", "p90_m", "coverage95", "nees")
    _print_rows([{name: _text(record[name]) for name in columns} for record in records], as_json=False)


def _run_bench(options: Namespace) -> None:
    from fploc.experiments.bench import bench

    named = None if options.methods is None else [name.strip() for name in options.methods.split(",")]
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
    if options.json:
        print(json.dumps(rows, indent=2))  # noqa: T201
    else:
        _print_rows([{name: _text(value) for name, value in row.items()} for row in rows], as_json=False)


def _run_reproduce(options: Namespace) -> None:
    from dataclasses import asdict

    from fploc.experiments.reproduce import reproduce

    sites = None if options.sites is None else _named_sites(options.sites)
    done = reproduce(options.preset, options.data_root, options.source, options.runs, sites, options.workers)
    if options.json:
        _print(asdict(done), as_json=True)
        return
    title = "MADE-UP BUILDINGS, no real data" if done.made_up else "public data"
    print(f"\nPreset {done.preset}, {title}, {done.labels} labels, metres:")  # noqa: T201
    _print_rows(done.rows, as_json=False)
    for name, place in done.places.items():
        hint = " (look at it with `make ui`)" if name == "MLflow" else ""
        print(f"{name:>10}: {place}{hint}")  # noqa: T201


def _database_url(options: Namespace) -> str:
    from fploc.serve.store import sqlite_url

    return sqlite_url(options.state) if options.database is None else options.database


def _run_serve(options: Namespace) -> None:
    if options.serve_command == "token":
        _run_token(options.token)
        return
    if options.site is None:
        raise FplocError(
            "--site", value="nothing", expected="a packed site", way_out="write `fploc serve --site SITE`"
        )
    from fploc.serve.app import make_app
    from fploc.serve.models import ModelRequest, packed_place, served_site
    from fploc.serve.server import announcement, listening_socket, server_of
    from fploc.serve.settings import ServeSettings
    from fploc.serve.store import Store

    settings = ServeSettings.read(options.settings)
    speed_mps = settings.speed_prior_mps if options.speed_prior is None else options.speed_prior
    request = ModelRequest(
        options.model, options.calibration, speed_mps, options.preset, options.seed, options.runs
    )
    places = [packed_place(name.strip(), options.data_root) for name in options.site.split(",")]
    sites = [served_site(root, name, request) for root, name in dict.fromkeys(places)]
    store = Store(_database_url(options))
    with listening_socket(options.host, options.port) as listening:
        print(announcement(sites, listening), file=sys.stderr, flush=True)  # noqa: T201
        server_of(make_app(sites, store, settings), listening).run()
    store.close()


def _run_token(options: Namespace) -> None:
    import time

    from fploc.serve.store import Store
    from fploc.serve.tokens import make_token, scopes_of

    store = Store(_database_url(options))
    now_ms = time.time() * 1000.0
    if options.expire is None:
        print(make_token(store, options.name, scopes_of(options.scope), options.days, now_ms))  # noqa: T201
    elif not store.expire_token(options.expire, now_ms):
        known = [token.id for token in store.tokens()]
        raise UnknownNameError(
            "--expire", options.expire, known=known, way_out="the id is between the underscores of a token"
        )
    store.close()


def _run_replay(options: Namespace) -> None:
    import asyncio

    from fploc.serve.phones import Conditions, Server, send_walks
    from fploc.serve.replay import recorded_walks

    conditions = Conditions(options.speed, options.drop, options.delay_ms, options.seed)
    walks = recorded_walks(
        options.data_root, options.site, options.device, options.recordings, options.phones
    )
    server = Server(options.url, options.to or options.site, options.token)
    sent = asyncio.run(send_walks(server, walks, conditions))
    columns = ("accepted", "duplicate", "late", "skewed", "tried again")
    rows = [
        {"phone": one.device, "dropped": str(one.dropped)}
        | {name: str(one.outcomes[name]) for name in columns}
        for one in sent
    ]
    _print_rows(rows, as_json=bool(options.json))


def _run_completion(options: Namespace) -> None:
    from fploc.completion import completion_script

    print(completion_script(make_parser(), options.shell), end="")  # noqa: T201


def _fit(words: list[str]) -> int:
    from contextlib import redirect_stdout

    from fploc.experiments.fit import fit_from_command_line

    # All other words are Lightning's.
    ours = argparse.ArgumentParser(prog="fploc fit", add_help=False, allow_abbrev=False, exit_on_error=False)
    ours.add_argument("--json", nargs="?", const=PRINTED, choices=[PRINTED], default="")
    options, kept = ours.parse_known_args(words)
    as_json = bool(options.json)
    # Lightning's bars and summaries are notes where JSON was asked for.
    with redirect_stdout(sys.stderr if as_json else sys.stdout):
        fitted = fit_from_command_line(kept)
    if fitted is None:
        return 0
    if as_json:
        _print({"artifact": fitted.artifact, "validation": dict(fitted.validation)}, as_json=True)
    elif fitted.artifact is not None:
        print(f"artifact: {fitted.artifact}")  # noqa: T201
    return 0


def _named_sites(text: str | None, also: Sequence[str] = ()) -> list[str]:
    """Return the sites that ``--sites`` names, each once; None stands for the whole registry.

    Args:
        text: Names or site files, separated by commas.
        also: Names that may be given beside those of the registry.

    Raises:
        UnknownNameError: If a site is unknown.
        FplocError: If none is named.
    """
    from fploc.sites.registry import known_sites

    known = list(dict.fromkeys((*known_sites(), *also)))
    if text is None:
        return list(known_sites())
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise FplocError(
            "--sites",
            value=repr(text),
            expected=f"names separated by commas, of {', '.join(known)}",
            way_out="or leave it out for all sites",
        )
    for name in names:
        if name not in known and not name.endswith(SITE_FILES):
            raise UnknownNameError(
                "--sites", name, known=known, way_out="or give the path of a site file (.yaml)"
            )
    return names


def _print(values: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(values, indent=2, default=str))  # noqa: T201
        return
    _print_rows([{"": name, "value": _text(value)} for name, value in values.items()], as_json=False)


def _print_rows(rows: Sequence[Mapping[str, str]], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(list(rows), indent=2))  # noqa: T201
        return
    from fploc.progress import print_table

    print_table(rows)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.2f}"
    if isinstance(value, list | tuple):
        return ", ".join(str(item) for item in value) or "none"
    return str(value)


def _fail(message: str, code: int) -> int:
    print(f"fploc: {message}", file=sys.stderr)  # noqa: T201
    return code


def _version() -> str:
    from fploc import __version__

    return __version__
