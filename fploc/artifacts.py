"""Trained things on disk: networks with everything needed to run them, found by key."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from fploc.calibration.offsets import RangeOffsets
from fploc.conf import instantiate
from fploc.errors import BadFileError, MissingArtifactError

FORMAT_VERSION = 2


@dataclass(frozen=True)
class ArtifactKey:
    """What a trained thing was made for.

    Args:
        method: Method, or ``generator``.
        protocol: Protocol that says what it may have learned from.
        target: Site that it is for.
        preset: Preset of ``fploc reproduce`` that made it.
        seed: Seed of the training.
    """

    method: str
    protocol: str
    target: str
    preset: str
    seed: int

    def folder(self, root: Path) -> Path:
        """Return where the artifact lies below ``root``."""
        return root / self.preset / self.protocol / self.target / self.method / f"seed-{self.seed}"


@dataclass(frozen=True)
class Artifact:
    """Networks and the constants that they need.

    Args:
        key: What it was made for.
        specs: ``class_path`` and ``init_args`` of each network, by name.
        networks: The networks, by name.
        constants: Calibration, crops and other settings, as plain JSON values.
        data_hash: Hash over the manifests of the packed sites that it was made from.
        recordings: Training recordings, as ``site/device/name``.
        command: The command that makes it.
    """

    key: ArtifactKey
    specs: Mapping[str, Mapping[str, Any]]
    networks: Mapping[str, torch.nn.Module]
    constants: Mapping[str, Any]
    data_hash: str
    recordings: tuple[str, ...]
    command: str

    def save(self, root: Path) -> Path:
        """Write the artifact below ``root`` and return its folder; an older one is replaced whole."""
        folder = self.key.folder(root)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".partial-") as temporary:
            new = Path(temporary) / "new"
            new.mkdir()
            for name, network in self.networks.items():
                save_file(
                    {key: value.detach().cpu().contiguous() for key, value in network.state_dict().items()},
                    new / f"{name}.safetensors",
                )
            description = {
                "format_version": FORMAT_VERSION,
                "key": asdict(self.key),
                "specs": {name: dict(spec) for name, spec in self.specs.items()},
                "constants": dict(self.constants),
                "data_hash": self.data_hash,
                "recordings": list(self.recordings),
                "command": self.command,
            }
            (new / "artifact.json").write_text(json.dumps(description, indent=2) + "\n")
            if folder.exists():
                folder.rename(Path(temporary) / "old")
            new.rename(folder)
        return folder


def load_artifact(root: Path, key: ArtifactKey, *, data_hash: str, command: str) -> Artifact:
    """Return the artifact of ``key`` below ``root``, its networks in evaluation mode.

    Args:
        root: Folder of artifacts.
        key: What it must have been made for.
        data_hash: Hash of the data that it must have been made from.
        command: The command that makes it, named where it is missing.

    Raises:
        MissingArtifactError: If there is none, or it was made from other data or by another version.
        BadFileError: If its files cannot be read.
    """
    return _artifact(root, key, {"data_hash": data_hash}, command)


def load_shipped(root: Path, key: ArtifactKey, *, command: str) -> Artifact:
    """Return an artifact that is used wherever its data are not at hand; see ``load_artifact``."""
    return _artifact(root, key, {}, command)


def offsets_of(artifact: Artifact) -> RangeOffsets:
    """Return the range offsets that an artifact was trained behind."""
    stored = artifact.constants["offsets"]
    return RangeOffsets(**{**stored, "recordings": tuple(stored["recordings"])})


def _artifact(root: Path, key: ArtifactKey, also: Mapping[str, str], command: str) -> Artifact:
    """Return the artifact of ``key`` where its description says this, and also what ``also`` says."""
    folder = key.folder(root)
    description = _description(folder, key, command)
    wanted = {"key": asdict(key), **also, "format_version": FORMAT_VERSION}
    for name, value in wanted.items():
        found = description.get(name)
        if found != value:
            raise MissingArtifactError(
                f"{folder}, {name}", value=found, expected=str(value), way_out=f"make it: {command}"
            )
    specs = description["specs"]
    networks = {name: _network(folder / f"{name}.safetensors", spec) for name, spec in specs.items()}
    return Artifact(
        key=key,
        specs=specs,
        networks=networks,
        constants=description["constants"],
        data_hash=description["data_hash"],
        recordings=tuple(description["recordings"]),
        command=description["command"],
    )


def _description(folder: Path, key: ArtifactKey, command: str) -> dict[str, Any]:
    file = folder / "artifact.json"
    if not file.is_file():
        raise MissingArtifactError(
            f"artifact of {key.method} for {key.target} (protocol {key.protocol}, preset {key.preset}, "
            f"seed {key.seed})",
            value=f"nothing at {folder}",
            expected="a trained artifact",
            way_out=f"make it: {command}",
        )
    try:
        description = json.loads(file.read_text())
    except ValueError as error:
        raise BadFileError(
            file, "whole file", value=str(error), expected="JSON", way_out=f"make it again: {command}"
        ) from error
    if not isinstance(description, dict):
        raise BadFileError(
            file,
            "whole file",
            value=type(description).__name__,
            expected="a JSON object",
            way_out=f"make it again: {command}",
        )
    return description


def _network(file: Path, spec: dict[str, Any]) -> torch.nn.Module:
    network = instantiate(torch.nn.Module, spec)
    try:
        network.load_state_dict(load_file(file))
    except (OSError, SafetensorError, RuntimeError) as error:
        raise BadFileError(
            file,
            "weights",
            value=str(error).splitlines()[0],
            expected=f"the weights of {spec['class_path']}",
            way_out="delete the folder and make the artifact again",
        ) from error
    return network.eval()
