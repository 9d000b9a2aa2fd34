"""``fploc fit``: one training by LightningCLI, from a YAML of conf/experiment/ or one's own."""

from __future__ import annotations

import os
import shlex
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path

import lightning.pytorch as pl
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.cli import LightningCLI

from datamodules.measured import MeasuredDataModule
from datamodules.pooled import PooledDataModule
from fploc.artifacts import Artifact, ArtifactKey
from fploc.conf import conf_folder
from fploc.datasets.packed import PackedSite
from fploc.errors import FplocError, MissingFileError
from fploc.experiments.scoring import artifacts_folder, data_hash
from fploc.tasks.streams import StreamTask
from fploc.usage import ExampleFormatter

CONFIG = "--config"
PRESET = "fit"
RUNS = Path("runs")
MEANING = (
    "Train one network: its best weights end in an artifact, with the offsets that they were trained behind. "
    "--json prints JSON at the end. "
    "Example: fploc fit --config conf/experiment/gnn-office.yaml --trainer.max_epochs 20"
)
RAISING = {"exit_on_error": False}
"""Of a parser: what it refuses goes to the caller, who prints it in one line."""


class _FitCLI(LightningCLI):
    def before_instantiate_classes(self) -> None:
        # The loggers of conf/experiment/ keep their SQLite file here, and SQLite makes no folder.
        RUNS.mkdir(exist_ok=True)

    def before_fit(self) -> None:
        if not isinstance(self.datamodule, MeasuredDataModule | PooledDataModule):
            raise FplocError(
                "data of fploc fit",
                value=type(self.datamodule).__name__,
                expected="a MeasuredDataModule or a PooledDataModule, which calibrate",
                way_out="name one of these, or a class made from one, as `class_path`",
            )


@dataclass(frozen=True)
class Fitted:
    """What a training leaves behind.

    Args:
        artifact: Folder of the artifact; None where nothing is kept.
        validation: What validation says of the weights kept, by metric.
    """

    artifact: Path | None
    validation: Mapping[str, float]


def fit_from_command_line(words: Sequence[str]) -> Fitted | None:
    """Train what the words of a command line describe; see ``fploc fit --help``.

    The weights that were best in validation end in an artifact below ``trainer.default_root_dir``, with the
    range offsets that they were trained behind. ``fast_dev_run`` keeps nothing.

    Returns:
        What was kept; None in a process that only trains along with the one that keeps it.

    Raises:
        MissingFileError: If a configuration file is not there.
        FplocError: If the data are of a kind that holds no calibration.
    """
    # The words come from the command line itself, which Lightning cannot know.
    warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    with resources.as_file(conf_folder()) as conf:
        cli = _FitCLI(
            StreamTask,
            pl.LightningDataModule,
            subclass_mode_model=True,
            subclass_mode_data=True,
            save_config_callback=None,
            parser_kwargs={
                "prog": "fploc",
                "formatter_class": ExampleFormatter,
                "fit": RAISING | {"description": MEANING},
                **RAISING,
            },
            args=["fit", *_resolved(words, Path(conf))],
        )
    trainer = cli.trainer
    is_trial = bool(cli.config["fit"]["trainer"]["fast_dev_run"])
    metrics = {} if is_trial else _validated_best(cli)
    if not trainer.is_global_zero:
        return None
    if is_trial:
        return Fitted(artifact=None, validation={})
    made = _artifact(cli, metrics, command=shlex.join(["fploc", "fit", *words]))
    return Fitted(made.save(artifacts_folder(Path(trainer.default_root_dir))), metrics)


def _validated_best(cli: LightningCLI) -> dict[str, float]:
    """Put the best weights into the network, on every process, and return what validation says of them."""
    checkpoint = cli.trainer.checkpoint_callback
    best = checkpoint.best_model_path if isinstance(checkpoint, ModelCheckpoint) else ""
    (metrics,) = cli.trainer.validate(
        cli.model, datamodule=cli.datamodule, ckpt_path=best or None, verbose=False
    )
    return {name: float(value) for name, value in metrics.items()}


def _artifact(cli: LightningCLI, metrics: dict[str, float], *, command: str) -> Artifact:
    """Return the trained network with the calibration that its ranges were behind."""
    data, name = cli.datamodule, cli.model.name
    assert data.offsets is not None, "the training has called setup()"
    config = cli.config["fit"].clone(with_meta=False)
    protocol, target, sites = _learned_from(data)
    return Artifact(
        key=ArtifactKey(name, protocol, target, PRESET, int(config["seed_everything"])),
        specs={name: config["model"]["init_args"]["network"].as_dict()},
        networks={name: cli.model.network},
        constants={"offsets": asdict(data.offsets), "labels": data.labels, "validation": metrics},
        data_hash=data_hash(*sites),
        recordings=tuple(one.key for one in data.recordings("train")),
        command=command,
    )


def _learned_from(data: MeasuredDataModule | PooledDataModule) -> tuple[str, str, list[PackedSite]]:
    """Return the protocol that describes the data, the site that validates and all sites."""
    if isinstance(data, PooledDataModule):
        return "zero-shot-pooled", data.validation_site, list(data.packed.values())
    assert data.packed is not None, "the training has called setup()"
    return "seen", data.site, [data.packed]


def _resolved(words: Sequence[str], conf: Path) -> list[str]:
    """Return the words with ``--config conf/experiment/NAME.yaml`` found wherever conf/ lies."""
    resolved = list(words)
    for index, word in enumerate(words[:-1]):
        if word == CONFIG:
            resolved[index + 1] = str(_config_file(Path(words[index + 1]), conf))
    return resolved


def _config_file(named: Path, conf: Path) -> Path:
    if named.is_file():
        return named
    packaged = conf / "experiment" / named.name
    if packaged.is_file():
        return packaged
    known = ", ".join(sorted(file.name for file in (conf / "experiment").iterdir()))
    raise MissingFileError(
        named, expected="a configuration", way_out=f"name a file, or one of conf/experiment/: {known}"
    )
