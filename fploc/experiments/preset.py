"""Presets of ``fploc reproduce`` (conf/preset/) and what is changed in them one at a time (conf/ablation/)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from fploc.conf import instantiate, read_conf
from fploc.errors import BadFileError, UnknownNameError

PRESETS = ("smoke", "default", "full", "published", "paper")
NETWORKS = ("generator", "gnn", "fpdnn")
TRAININGS = (*NETWORKS, "gnn_adapted", "fpdnn_adapted")
VARIANT = "--"
"""Between the name of a preset and that of an ablation: ``full--bare-distance``."""
SCORED_ONLY = (
    "seeds",
    "protocols",
    "methods",
    "ablations",
    "ablation_targets",
    "ablation_seeds",
    "synthesized",
    "plans",
    "thins",
    "calibrations",
    "access_point_counts",
    "survey_errors_m",
    "studied_thin",
)
"""No trained network depends on what else is trained, or on how it is scored."""

Solver = Literal["lls", "nls", "nls-onesided"]
Streams = Literal["both", "measured", "virtual"]
NetworkChanges = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Preset:
    """What one reproduction trains and evaluates.

    Args:
        name: Of the preset.
        seeds: One training for each.
        networks: Name in conf/model/ of ``generator``, ``gnn`` and ``fpdnn``.
        solver: Behind FPDNN: ``lls`` (published), ``nls`` or ``nls-onesided``. The last was chosen on the
            office's lap 3, which validates: RMSE 1.10 m behind the Kalman filter, for 1.42 m with ``nls`` and
            1.92 m with ``lls``. The laboratory, a development site, was in view when it was chosen.
        protocols: Sites of each protocol.
        methods: Scored at every site, in the order of the tables.
        calibration: Range offsets of learned methods.
        labels: Labels to learn from.
        batch_intervals: Intervals of a training batch.
        batches_per_epoch: Batches of an epoch, from each stream.
        pool_batches: Virtual batches drawn for each site.
        epochs: Of each training.
        learning_rates: Of each network.
        random_layout_share: Share of virtual batches with access points elsewhere.
        validation_thin: Every so many-th interval of the source's validation recordings validates.
        thins: Every so many-th interval is evaluated; the first is the headline, the others are zero-shot.
        synthesized: Sites that the generator's maps and its match with measurements are made of.
        plans: Plans that ``gnn-fpdnn`` is scored with at ``ablation_targets`` beside the real one, zero-shot.
        ablations: Names in conf/ablation/, each trained and scored zero-shot at ``ablation_targets``.
        ablation_targets: Sites of the ablations.
        ablation_seeds: Of ``seeds``, those that ablations are trained with.
        calibrations: Each of them in front of every method without training, zero-shot.
        access_point_counts: Numbers of access points that every method is left with, zero-shot.
        survey_errors_m: Greatest errors of the access points' coordinates, zero-shot, metres.
        studied_thin: Every so many-th interval is scored with other access points.
        streams: What networks learn from: measured intervals, virtual ones, or both.
        sight_shares: Shares of training links that FPDNN sees the crop of, its length alone, and nothing.
        augmentation: Strengths of ``fploc.floorplan.augmentation.CropAugmentation``; empty for its own.
        network_changes: What differs from conf/model/, by network.
    """

    name: str
    seeds: tuple[int, ...]
    networks: dict[str, str]
    solver: Solver
    protocols: dict[str, tuple[str, ...]]
    methods: tuple[str, ...]
    calibration: str
    labels: Literal["published", "repaired"]
    batch_intervals: int
    batches_per_epoch: int
    pool_batches: int
    epochs: dict[str, int]
    learning_rates: dict[str, float]
    random_layout_share: float
    validation_thin: int = 1
    thins: tuple[int, ...] = (1,)
    synthesized: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()
    ablations: tuple[str, ...] = ()
    ablation_targets: tuple[str, ...] = ()
    ablation_seeds: tuple[int, ...] = ()
    calibrations: tuple[str, ...] = ()
    access_point_counts: tuple[int, ...] = ()
    survey_errors_m: tuple[float, ...] = ()
    studied_thin: int = 10
    streams: Streams = "both"
    sight_shares: tuple[float, float, float] = (0.8, 0.1, 0.1)
    augmentation: dict[str, float] = field(default_factory=dict)
    network_changes: NetworkChanges = field(default_factory=dict)

    @property
    def fingerprint(self) -> str:
        """Hash over everything that trained networks depend on, their configurations included."""
        described = asdict(self) | {"conf": self.network_specs}
        for name in SCORED_ONLY:
            del described[name]
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def network_specs(self) -> dict[str, dict[str, Any]]:
        """``class_path`` and ``init_args`` of each network."""
        return {
            name: merged(read_conf("model", file), self.network_changes.get(name, {}))
            for name, file in self.networks.items()
        }

    def trains_like(self, other: Preset) -> bool:
        """Return whether both train the same networks on the same streams."""
        return (
            replace(self, name="", solver="nls", network_changes={})
            == replace(other, name="", solver="nls", network_changes={})
            and self.network_specs == other.network_specs
        )

    def variant(self, ablation: str) -> Preset:
        """Return the preset with the change of an ablation; the preset itself for an empty name."""
        if not ablation:
            return self
        change = read_ablation(ablation)
        return replace(
            self,
            name=f"{self.name}{VARIANT}{ablation}",
            network_changes=merged(self.network_changes, change.networks),
            **{
                key: value
                for key in ("solver", "streams", "sight_shares", "augmentation")
                if (value := getattr(change, key)) is not None
            },
        )


@dataclass(frozen=True)
class Ablation:
    """One change to a preset.

    Args:
        reason: What it shows, in one sentence.
        networks: What differs from conf/model/, by network.
        solver: As in ``Preset``; None leaves it.
        streams: As in ``Preset``; None leaves it.
        sight_shares: As in ``Preset``; None leaves it.
        augmentation: As in ``Preset``; None leaves it.
    """

    reason: str
    networks: NetworkChanges = field(default_factory=dict)
    solver: Solver | None = None
    streams: Streams | None = None
    sight_shares: tuple[float, float, float] | None = None
    augmentation: dict[str, float] | None = None


def read_ablation(name: str) -> Ablation:
    """Return the ablation ``name``.

    Raises:
        UnknownNameError: If there is no such ablation.
        BadFileError: If a key is missing, unknown or holds the wrong kind of value.
    """
    values = read_conf("ablation", name)
    # Descriptions of classes stay what they are: they are merged with others before anything is made of them.
    networks = values.pop("networks", {})
    if not isinstance(networks, dict) or not set(networks) <= set(NETWORKS):
        raise BadFileError(
            f"conf/ablation/{name}.yaml",
            "networks",
            value=networks,
            expected=f"changes of {', '.join(NETWORKS)}",
            way_out="correct the file",
        )
    spec = {"class_path": f"{Ablation.__module__}.{Ablation.__qualname__}", "init_args": values}
    return replace(instantiate(Ablation, spec, source=f"conf/ablation/{name}.yaml"), networks=networks)


def read_preset(name: str) -> Preset:
    """Return the preset ``name``, or a variant of one, ``full--bare-distance``.

    Raises:
        UnknownNameError: If there is no such preset or ablation.
        BadFileError: If a key is missing, unknown or holds the wrong kind of value.
    """
    own, _, ablation = name.partition(VARIANT)
    values = read_conf("preset", own)
    spec = {"class_path": f"{Preset.__module__}.{Preset.__qualname__}", "init_args": values | {"name": own}}
    preset = instantiate(Preset, spec, source=f"conf/preset/{own}.yaml")
    for key, expected in {
        "networks": NETWORKS,
        "learning_rates": NETWORKS,
        "epochs": TRAININGS,
    }.items():
        found = getattr(preset, key)
        if set(found) != set(expected):
            raise BadFileError(
                f"conf/preset/{own}.yaml",
                key,
                value=", ".join(found),
                expected=", ".join(expected),
                way_out="name each of these once",
            )
    return preset.variant(ablation)


def check_preset(name: str) -> None:
    """Raise where there is no preset ``name``, for those who need none of its contents.

    Raises:
        UnknownNameError: Listing those there are.
    """
    own, _, ablation = name.partition(VARIANT)
    if own not in PRESETS:
        raise UnknownNameError("--preset", name, known=list(PRESETS), way_out="choose one of these")
    if ablation:
        read_ablation(ablation)


def merged(spec: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``spec`` with ``changes``, mappings within mappings merged."""
    inner = {
        key: merged(spec[key], value)
        for key, value in changes.items()
        if isinstance(value, Mapping) and isinstance(spec.get(key), Mapping)
    }
    return dict(spec) | dict(changes) | inner
