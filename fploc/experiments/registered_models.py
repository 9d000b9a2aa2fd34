"""Trained artifacts as registered models of the run log, the best zero-shot one of each method its champion."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fploc.artifacts import ArtifactKey
from fploc.evaluation.run_log import RunLog
from fploc.experiments.plan import ZERO_SHOT
from fploc.experiments.preset import VARIANT

CHAMPION = "champion"
VALIDATION = "validation_m"
"""Tag with the error that validation says, metres: smaller is better."""
BYTES = "sha256"
IDENTITY = ("protocol", "target", "seed", "preset")
"""Tags that tell versions of a model apart."""


def register_models(log: RunLog, folders: Mapping[ArtifactKey, Path], *, made_up: bool) -> None:
    """Register each artifact as a version of the model of its method, and name the champions.

    A champion is the zero-shot version, of a whole preset and not of an ablation, with the smallest error in
    validation: on the source's validation recordings, the same for every target, preset and seed. What the
    targets' labels say takes no part.

    Args:
        log: The run log.
        folders: Where each artifact lies.
        made_up: True where it was trained on made-up buildings, whose models have names of their own.
    """
    made: dict[str, dict[Path, dict[str, str]]] = {}
    for key, folder in folders.items():
        made.setdefault(model_name(key.method, made_up=made_up), {})[folder] = _tags(key, folder)
    for name, versions in made.items():
        log.register(name, versions, identity=IDENTITY)
        champion = _champion(log.versions(name))
        if champion is not None:
            log.name_version(name, CHAMPION, champion)


def model_name(method: str, *, made_up: bool) -> str:
    """Return the name of a method's registered model."""
    return f"{method}, made-up" if made_up else method


def _champion(versions: Mapping[str, Mapping[str, str]]) -> str | None:
    """Return the version with the smallest error in validation, of those that may be champion; None without one."""
    errors_m = {
        version: float(tags[VALIDATION])
        for version, tags in versions.items()
        if tags["protocol"] == ZERO_SHOT and VARIANT not in tags["preset"] and VALIDATION in tags
    }
    return min(errors_m, key=lambda version: (errors_m[version], int(version)), default=None)


def _tags(key: ArtifactKey, folder: Path) -> dict[str, str]:
    """Return what a version's tags say: what it was made for, from what, and its error in validation."""
    description = json.loads((folder / "artifact.json").read_text("utf-8"))
    digest = hashlib.sha256()
    for file in sorted(folder.iterdir()):
        digest.update(file.read_bytes())
    tags = {
        "protocol": key.protocol,
        "target": key.target,
        "seed": str(key.seed),
        "preset": key.preset,
        "data_hash": str(description["data_hash"]),
        "command": str(description["command"]),
        BYTES: digest.hexdigest(),
    }
    error_m = _validation_error_m(key.method, description["constants"])
    return tags if error_m is None else tags | {VALIDATION: f"{error_m:.6f}"}


def _validation_error_m(method: str, constants: Mapping[str, Any]) -> float | None:
    """Return the error in validation, metres: of positions for ``gnn``, of corrected ranges for ``gnn-fpdnn``."""
    match method:
        case "gnn":
            return float((2.0 * constants["variance_m2"]) ** 0.5)
        case "gnn-fpdnn":
            return float(constants["sigma_m"])
        case _:
            return None
