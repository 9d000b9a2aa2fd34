"""``fploc data build``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jsonargparse import ArgumentParser, Namespace

from fploc.commands.named_sites import named_sites
from fploc.commands.options import add_printed_json, data_parser
from fploc.commands.printing import print_rows, remark
from fploc.errors import FplocError

if TYPE_CHECKING:
    from fploc.sites.registry import SiteSpec

MEANING = "Pack sites."


def parser() -> ArgumentParser:
    """Return the parser of its options."""
    parser = data_parser(f"{MEANING} Example: fploc data build --from DIR --sites office,laboratory")
    add_printed_json(parser)
    return parser


def run(options: Namespace) -> None:
    """Pack sites, and print what they hold.

    Raises:
        FplocError: For any bad input.
    """
    from fploc.datasets.build import build_site
    from fploc.datasets.download import resolve_source
    from fploc.progress import track
    from fploc.sites.registry import load_spec

    specs = [load_spec(name) for name in named_sites(options.sites)]
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
    print_rows(rows, as_json=bool(options.json))
    built = [report.site for report in reports if report.state != "absent"]
    if built and not options.json:
        from fploc.datasets.describe import describe, table_rows

        print_rows(table_rows(describe(options.data_root, built)), as_json=False)


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
        remark(f"skipped {error}")


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
