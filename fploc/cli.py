"""The command ``fploc``. Everything heavy is imported by the sub-command that needs it."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jsonargparse import ActionConfigFile, ArgumentError, ArgumentParser, Namespace

from fploc.errors import FplocError, UnknownNameError
from fploc.files import advice
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
    "describe": "Count what packed sites hold, draw them. Example: fploc data describe --out overlays",
}
MEANINGS = {
    "data": "Fetch, check, pack and describe the public data set.",
    "made-up": "Write a made-up building and its recordings.",
    "evaluate": "Score a method on a packed site.",
    "reproduce": "Get data, train, evaluate, tabulate: `make reproduce`.",
    "fit": "Train one network (LightningCLI).",
    "tune": "Choose a method's settings on the source.",
    "synthesize": "Draw what the trained generator says of a packed site.",
    "bench": "Time one fix of every method.",
    "completion": "Print what makes a shell complete these words.",
}
"""In the order in which they are met."""
COMMANDS = {"": tuple(MEANINGS), "data": tuple(DATA_COMMANDS)}
SHELLS = ("bash", "zsh")
PRINTED = "-"
SITE_FILES = (".yaml", ".yml")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 for bad input, 130 when interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    # torch_geometric scripts a function at import, which torch announces the end of.
    warnings.filterwarnings("ignore", message=".*torch.jit.script.*", category=FutureWarning)
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
        "synthesize": _synthesize_parser(),
        "bench": _bench_parser(),
        "completion": _completion_parser(),
    }
    _add_commands(parser, "command", {name: (parsers[name], text) for name, text in MEANINGS.items()})
    _add_commands(
        parsers["data"],
        "data_command",
        {name: (_data_parser(name, text), text.split(". ")[0] + ".") for name, text in DATA_COMMANDS.items()},
    )
    return parser


def _add_commands(
    parser: ArgumentParser, dest: str, parsers: Mapping[str, tuple[ArgumentParser, str]]
) -> None:
    """Add sub-commands, each with its parser and its line in the list of ``parser``."""
    commands = parser.add_subcommands(
        required=True,
        dest=dest,
        title="commands",
        metavar="COMMAND",
        description=f"`{parser.prog} COMMAND --help` explains each.",
    )
    for name, (own, meaning) in parsers.items():
        commands.add_subcommand(name, own, help=meaning)
        own.prog = f"{parser.prog} {name}"


def _data_parser(name: str, text: str) -> ArgumentParser:
    parser = ArgumentParser(description=text, exit_on_error=False)
    parser.add_argument("--config", action=ActionConfigFile, help="YAML with these options.")
    _add_data_options(parser)
    if name == "describe":
        parser.add_argument("--out", type=Path, default=Path("runs/overlays"), help="Folder of the pictures.")
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
        "Example: fploc tune --method nls",
        exit_on_error=False,
    )
    parser.add_argument("--method", type=str, required=True, help="Name of the method.")
    parser.add_argument("--trials", type=int, default=40, help="Settings to try, the same for every method.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the search.")
    _add_data_root(parser)
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
        "bench": _run_bench,
        "reproduce": _run_reproduce,
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
    from fploc.datasets.describe import describe, table_rows, write_overlays
    from fploc.datasets.packed import packed_sites

    sites = packed_sites(options.data_root)
    if options.sites is not None:
        sites = [_packed_name(name) for name in _named_sites(options.sites, also=sites)]
    descriptions = describe(options.data_root, sites)
    if options.json:
        print(json.dumps([description.to_json() for description in descriptions], indent=2))  # noqa: T201
    else:
        _print_rows(table_rows(descriptions), as_json=False)
    for path in write_overlays(options.data_root, sites, options.out):
        print(f"picture: {path}", file=sys.stderr)  # noqa: T201


def _packed_name(name_or_file: str) -> str:
    from fploc.sites.registry import load_spec

    return load_spec(name_or_file).site.name if name_or_file.endswith(SITE_FILES) else name_or_file


def _run_made_up(options: Namespace) -> None:
    from fploc.sites.made_up import made_up_site

    site = made_up_site(options.seed, options.out)
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


def _run_bench(options: Namespace) -> None:
    from fploc.experiments.bench import bench

    named = None if options.methods is None else [name.strip() for name in options.methods.split(",")]
    timings = bench(
        options.site,
        named,
        fixes=options.fixes,
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
    from fploc.experiments.reproduce import reproduce

    sites = None if options.sites is None else _named_sites(options.sites)
    reproduce(options.preset, options.data_root, options.source, options.runs, sites, options.workers)


def _run_completion(options: Namespace) -> None:
    from fploc.completion import completion_script

    print(completion_script(make_parser(), options.shell), end="")  # noqa: T201


def _fit(words: list[str]) -> int:
    from fploc.experiments.fit import fit_from_command_line

    fit_from_command_line(words)
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
