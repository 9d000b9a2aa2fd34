"""Presets of ``fploc reproduce``: conf/preset/<name>.yaml."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

from fploc.conf import instantiate, read_conf
from fploc.errors import BadFileError

PRESETS = ("smoke", "default", "full", "paper")
NETWORKS = ("generator", "gnn", "fpdnn")
TRAININGS = (*NETWORKS, "gnn_adapted", "fpdnn_adapted")


@dataclass(frozen=True)
class Preset:
    """What one reproduction trains and evaluates.

    Args:
        name: Of the preset.
        seeds: One training for each.
        networks: Name in conf/model/ of ``generator``, ``gnn`` and ``fpdnn``.
        solver: ``lls`` (published) or ``nls``, behind FPDNN.
        targets: Sites of the protocol ``zero-shot``.
        methods: Scored at every site, in the order of the tables.
        calibration: Range offsets of learned methods.
        labels: Labels to learn from.
        batch_intervals: Intervals of a training batch.
        batches_per_epoch: Batches of an epoch, from each stream.
        pool_batches: Virtual batches drawn for each site.
        epochs: Of each training.
        learning_rates: Of each network.
        random_layout_share: Share of virtual batches with access points elsewhere.
        thin: Every so many-th interval is evaluated.
    """

    name: str
    seeds: tuple[int, ...]
    networks: dict[str, str]
    solver: Literal["lls", "nls"]
    targets: tuple[str, ...]
    methods: tuple[str, ...]
    calibration: str
    labels: Literal["published", "repaired"]
    batch_intervals: int
    batches_per_epoch: int
    pool_batches: int
    epochs: dict[str, int]
    learning_rates: dict[str, float]
    random_layout_share: float
    thin: int

    @property
    def fingerprint(self) -> str:
        """Hash over everything that the results depend on, network configurations included.

        No result depends on which methods stand beside it: a longer list trains nothing anew.
        """
        described = asdict(self) | {
            "conf": {name: read_conf("model", file) for name, file in self.networks.items()}
        }
        del described["methods"]
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def network_specs(self) -> dict[str, dict[str, Any]]:
        """``class_path`` and ``init_args`` of each network."""
        return {name: read_conf("model", file) for name, file in self.networks.items()}


def read_preset(name: str) -> Preset:
    """Return the preset ``name``.

    Raises:
        UnknownNameError: If there is no such preset.
        BadFileError: If a key is missing, unknown or holds the wrong kind of value.
    """
    values = read_conf("preset", name)
    spec = {"class_path": f"{Preset.__module__}.{Preset.__qualname__}", "init_args": values | {"name": name}}
    preset = instantiate(Preset, spec, source=f"conf/preset/{name}.yaml")
    for key, expected in {
        "networks": NETWORKS,
        "learning_rates": NETWORKS,
        "epochs": TRAININGS,
    }.items():
        found = getattr(preset, key)
        if set(found) != set(expected):
            raise BadFileError(
                f"conf/preset/{name}.yaml",
                key,
                value=", ".join(found),
                expected=", ".join(expected),
                way_out="name each of these once",
            )
    return preset
