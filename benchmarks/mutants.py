"""How many changes of the code the tests notice: `python benchmarks/mutants.py --help`.

mutmut makes the mutants (copies of a function with one change: another operator, number or argument) and runs
on each the tests that reach that function, fastest first, up to the first that fails; which packages and which
tests is said under ``[tool.mutmut]`` of pyproject.toml. This program draws which mutants: so many of all, alike
for one seed. A mutant that no test fails on survives; one that runs into the time limit or breaks the process
counts as killed, and one that no test reaches as surviving.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypedDict

from mutmut.mutation.data import SourceFileMutationData
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.mutation.file_mutation import mutate_file_contents
from mutmut.stats import status_by_exit_code
from mutmut.utils.format_utils import get_mutant_name

from fploc.progress import print_table

ROOT = Path(__file__).resolve().parents[1]
PUBLIC_DATA = ROOT.parent / "shared" / "rtt-dataset"
LIVING = ("survived", "no tests")
KILLED = ("killed", "timeout", "segfault")


class Rate(TypedDict):
    """One row of the table; the last one is of all modules."""

    module: str
    possible: int
    tried: int
    killed: int
    killed_share: float | None


def possible_mutants() -> dict[str, Path]:
    """Return the name of every mutant that mutmut can make here, and the file it is of."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutmut"]
    files = sorted(file for pattern in settings["only_mutate"] for file in Path().glob(f"{pattern}.py"))
    return {
        get_mutant_name(file, name): file
        for file in files
        for name in mutate_file_contents(str(file), file.read_text(), None, None).mutant_names
    }


def run(names: Iterable[str], processes: int) -> None:
    """Run the tests of each of these mutants, on so many processes; mutmut keeps the outcome under mutants/.

    What an earlier run left there is removed: mutmut numbers the mutants anew where its settings change, but
    takes over what it made of a file that did not.

    Raises:
        SystemExit: the tests fail on the code as it is, or mutmut does not work here.
    """
    shutil.rmtree("mutants", ignore_errors=True)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "MUTMUT_COLOR": "0"}
    if PUBLIC_DATA.is_dir():
        environment.setdefault("FPLOC_SOURCE", str(PUBLIC_DATA))
    command = [str(Path(sys.executable).parent / "mutmut"), "run", "--max-children", str(processes), *names]
    done = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
    if done.returncode:
        sys.exit(
            f"mutmut ended with exit code {done.returncode}:\n{done.stdout[-4000:]}{done.stderr[-4000:]}"
        )


def statuses(sample: Mapping[str, Path]) -> dict[str, str]:
    """Return the outcome of each mutant of the sample, in mutmut's words.

    Raises:
        SystemExit: one was not run to an end that says anything about it.
    """
    outcomes = {}
    for file in sorted(set(sample.values())):
        data = SourceFileMutationData(path=file)
        data.load()
        outcomes |= {
            name: status_by_exit_code[data.exit_code_by_key[name]] for name in sample if sample[name] == file
        }
    unclear = {name: status for name, status in outcomes.items() if status not in LIVING + KILLED}
    if unclear:
        sys.exit(f"mutants without an outcome: {unclear}")
    return outcomes


def rates(possible: Mapping[str, Path], outcomes: Mapping[str, str]) -> list[Rate]:
    """Return the share killed in each module, and in all."""
    everywhere = Counter(str(file) for file in possible.values())
    tried = Counter(str(possible[name]) for name in outcomes)
    killed = Counter(str(possible[name]) for name, status in outcomes.items() if status in KILLED)
    rows = [(file, everywhere[file], tried[file], killed[file]) for file in sorted(everywhere)]
    rows.append(("all", everywhere.total(), tried.total(), killed.total()))
    return [
        Rate(module=file, possible=of, tried=n, killed=dead, killed_share=dead / n if n else None)
        for file, of, n, dead in rows
    ]


def options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sample", type=int, default=300, help="mutants to try (300)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (0)")
    parser.add_argument("--processes", type=int, default=2, help="mutants at a time (2)")
    parser.add_argument("--floor", type=float, default=0.8, help="share to be killed, or exit code 1 (0.8)")
    parser.add_argument("--out", type=Path, default=Path("runs/mutants.json"), help="file for the outcome")
    return parser.parse_args()


def main() -> None:
    """Draw mutants, run their tests, print and write what survives."""
    chosen = options()
    out = chosen.out.resolve()
    os.chdir(ROOT)
    possible = possible_mutants()
    names = random.Random(chosen.seed).sample(sorted(possible), min(chosen.sample, len(possible)))
    print(f"{len(names)} of {len(possible)} mutants, seed {chosen.seed}", file=sys.stderr)  # noqa: T201
    started = time.monotonic()
    run(names, chosen.processes)
    outcomes = statuses({name: possible[name] for name in names})
    table = rates(possible, outcomes)
    survivors = {
        name: get_diff_for_mutant(name, path=possible[name])
        for name in sorted(outcomes)
        if outcomes[name] in LIVING
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    report = {
        "seed": chosen.seed, "seconds": round(time.monotonic() - started), "modules": table,
        "mutants": {name: outcomes[name] for name in sorted(outcomes)}, "survivors": survivors,
    }  # fmt: skip
    out.write_text(json.dumps(report, indent=1) + "\n")
    for diff in survivors.values():
        print(diff)  # noqa: T201
    print_table(
        [
            {
                "module": row["module"],
                "possible": str(row["possible"]),
                "tried": str(row["tried"]),
                "killed": str(row["killed"]),
                "share": "–" if row["killed_share"] is None else f"{row['killed_share']:.0%}",
            }
            for row in table
        ]
    )
    print(f"{report['seconds']} s; {out}", file=sys.stderr)  # noqa: T201
    share = table[-1]["killed_share"]
    if share is None or share < chosen.floor:
        sys.exit(f"less than {chosen.floor:.0%} of the mutants killed")


if __name__ == "__main__":
    main()
