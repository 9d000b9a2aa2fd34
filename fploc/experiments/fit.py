"""``fploc fit``: one training by LightningCLI, from a YAML of conf/experiment/ or one's own."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import lightning.pytorch as pl
from lightning.pytorch.cli import LightningCLI

from fploc.conf import conf_folder
from fploc.errors import MissingFileError

CONFIG = "--config"
RUNS = Path("runs")
RAISING = {"exit_on_error": False}
"""Of a parser: what it refuses goes to the caller, who prints it in one line."""


class _FitCLI(LightningCLI):
    def before_instantiate_classes(self) -> None:
        # The loggers of conf/experiment/ keep their SQLite file here, and SQLite makes no folder.
        RUNS.mkdir(exist_ok=True)


def fit_from_command_line(words: Sequence[str]) -> None:
    """Train what the words of a command line describe; see ``fploc fit --help``.

    Raises:
        MissingFileError: If a configuration file is not there.
    """
    # The words come from the command line itself, which Lightning cannot know.
    warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    with resources.as_file(conf_folder()) as conf:
        _FitCLI(
            pl.LightningModule,
            pl.LightningDataModule,
            subclass_mode_model=True,
            subclass_mode_data=True,
            save_config_callback=None,
            parser_kwargs={"prog": "fploc", "fit": RAISING} | RAISING,
            args=["fit", *_resolved(words, Path(conf))],
        )


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
