"""Links per second that a virtual site draws: `python benchmarks/virtual_stream.py --help`.

Weights are untrained and every link is heard: neither changes the work. A link is a device–AP pair, or a pair
of devices in line of sight. Where other programs run, the rate per second of CPU time says more than that per
second.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TypedDict

import torch

from fploc.conf import instantiate, read_conf
from fploc.datasets.packed import read_packed
from fploc.models.generator import Generator
from fploc.progress import print_table
from fploc.virtual.dropout import Dropout
from fploc.virtual.site import VirtualSite

PAIRS = 32
RANDOM_LAYOUT_SHARE = 0.5
EVERY_LINK = Dropout(heard_shares=(1.0,))


class Rate(TypedDict):
    """One row of the table."""

    site: str
    network: str
    threads: int
    draws: int
    links: int
    seconds: float
    cpu_seconds: float
    links_per_s: float
    links_per_cpu_s: float


def virtual_site(data_root: Path, site: str, network: str) -> VirtualSite:
    """Return the virtual site of a packed one, filled by an untrained network of conf/model/."""
    packed = read_packed(data_root, site)
    torch.manual_seed(0)
    generator = instantiate(Generator, read_conf("model", network))
    return VirtualSite(
        packed.site, packed.plan, generator, generator.vision.crops, EVERY_LINK, RANDOM_LAYOUT_SHARE
    )


def rate(site: VirtualSite, pairs: int, draws: int) -> tuple[int, float, float]:
    """Return the links of ``draws`` draws of ``pairs`` pairs of devices, their seconds and CPU seconds."""
    random = torch.Generator().manual_seed(0)
    site.draw(pairs, random)
    links = 0
    started, cpu_started = time.perf_counter(), time.process_time()
    for _ in range(draws):
        intervals = site.draw(pairs, random).intervals
        assert intervals.links is not None
        links += int(intervals.heard.sum()) + intervals.links.index.shape[1] // 2
    return links, time.perf_counter() - started, time.process_time() - cpu_started


def rates(options: argparse.Namespace) -> Iterator[Rate]:
    """Yield the rate of every site, network and number of threads asked for."""
    for name in options.sites.split(","):
        for network, draws, pairs in (
            ("generator", options.draws, PAIRS),
            ("generator-paper", options.paper_draws, options.paper_pairs),
        ):
            site = virtual_site(options.data_root, name, network)
            for threads in options.threads:
                torch.set_num_threads(threads)
                if draws:
                    links, seconds, cpu_seconds = rate(site, pairs, draws)
                    yield Rate(
                        site=name,
                        network=network,
                        threads=threads,
                        draws=draws,
                        links=links,
                        seconds=seconds,
                        cpu_seconds=cpu_seconds,
                        links_per_s=links / seconds,
                        links_per_cpu_s=links / cpu_seconds,
                    )


def main() -> None:
    """Measure, and write a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data-root", type=Path, default=Path("data"), help="folder of packed sites")
    parser.add_argument("--sites", default="office,shopping-mall", help="names, with commas between")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="threads of torch")
    parser.add_argument("--draws", type=int, default=30, help=f"draws of {PAIRS} pairs, small network")
    parser.add_argument("--paper-draws", type=int, default=2, help="draws at the published widths; 0: none")
    parser.add_argument("--paper-pairs", type=int, default=2, help="pairs of devices of each of these")
    parser.add_argument("--json", action="store_true", help="JSON instead of a table")
    options = parser.parse_args()
    measured = list(rates(options))
    if options.json:
        print(json.dumps(measured, indent=2))  # noqa: T201
        return
    print_table(
        [
            {
                "site": row["site"],
                "network": row["network"],
                "threads": str(row["threads"]),
                "links": str(row["links"]),
                "links/s": f"{row['links_per_s']:,.0f}",
                "links/CPU s": f"{row['links_per_cpu_s']:,.0f}",
            }
            for row in measured
        ]
    )


if __name__ == "__main__":
    main()
