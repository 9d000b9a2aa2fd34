"""MLflow as a record of runs: written to, never read to find a model."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fploc.errors import BadFileError

if TYPE_CHECKING:
    from lightning.pytorch.loggers import Logger
    from matplotlib.figure import Figure

DATABASE = "mlflow.db"
ARTIFACTS = "mlflow-artifacts"
NOTE = "mlflow.note.content"
"""Tag that the UI shows as the description of an experiment."""


class RunLog:
    """An MLflow experiment in an SQLite store below ``folder``.

    Args:
        folder: Holds the store ``mlflow.db`` and the runs' files.
        experiment: Name of the experiment.
        note: What the experiment shows, above its runs; empty keeps what stands there.

    Raises:
        BadFileError: If the store is none, or cannot be written to; as ``record``.
    """

    def __init__(self, folder: Path, experiment: str, note: str = "") -> None:
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "ERROR")
        import mlflow

        folder.mkdir(parents=True, exist_ok=True)
        self._database = (folder / DATABASE).resolve()
        self.uri = f"sqlite:///{self._database}"
        with self._usable(), warnings.catch_warnings():
            # MLflow's own use of SQLAlchemy.
            warnings.simplefilter("ignore")
            self._client = mlflow.MlflowClient(tracking_uri=self.uri, registry_uri=self.uri)
            found = self._client.get_experiment_by_name(experiment)
            location = (folder / ARTIFACTS).resolve().as_uri()
            self._experiment = (
                self._client.create_experiment(experiment, artifact_location=location)
                if found is None
                else found.experiment_id
            )
            if note:
                self._client.set_experiment_tag(self._experiment, NOTE, note)
        self._name = experiment

    def record(
        self,
        name: str,
        *,
        tags: Mapping[str, str],
        parameters: Mapping[str, object],
        metrics: Mapping[str, float],
        figures: Mapping[str, Figure],
        folders: Mapping[str, Path],
    ) -> str:
        """Write one finished run and return its id; an older run of the same name and tags is deleted.

        Args:
            name: Of the run.
            tags: For example ``kind=zero-shot``.
            parameters: Settings.
            metrics: Numbers; those that are not finite are left out.
            figures: By file name.
            folders: Folders to keep with the run, by the name they get there.
        """
        from mlflow.entities import Metric, Param, RunTag

        with self._usable():
            self._delete_earlier(name, tags)
            run = self._client.create_run(self._experiment, run_name=name, tags=dict(tags))
            run_id: str = run.info.run_id
            finite = {
                key: value for key, value in metrics.items() if value == value and abs(value) < float("inf")
            }
            self._client.log_batch(
                run_id,
                metrics=[Metric(key, value, 0, 0) for key, value in finite.items()],
                params=[Param(key, str(value)) for key, value in parameters.items()],
                tags=[RunTag(key, value) for key, value in tags.items()],
            )
            for file, figure in figures.items():
                self._client.log_figure(run_id, figure, f"figures/{file}")
            for label, folder in folders.items():
                self._client.log_artifacts(run_id, str(folder), artifact_path=label)
            self._client.set_terminated(run_id)
            return run_id

    def training_logger(self, name: str, tags: Mapping[str, str]) -> Logger:
        """Return a Lightning logger whose run holds the curves of one training; an earlier try is deleted."""
        from lightning.pytorch.loggers import MLFlowLogger

        with self._usable():
            self._delete_earlier(name, tags)
        return MLFlowLogger(experiment_name=self._name, run_name=name, tracking_uri=self.uri, tags=dict(tags))

    def register(
        self, model: str, made: Mapping[Path, Mapping[str, str]], *, identity: Sequence[str]
    ) -> None:
        """Make folders versions of a registered model; nothing where a version has all tags of one already.

        Args:
            model: Name of the registered model, made where there is none.
            made: What versions stand for, and the tags of each; folders stay where they are.
            identity: Tags that tell versions apart: an older one that is alike in them is deleted.
        """
        with self._usable():
            if not self._client.search_registered_models(f"name = '{model}'"):
                self._client.create_registered_model(model)
            known = self.versions(model)
            for folder, tags in made.items():
                if dict(tags) in known.values():
                    continue
                for version, found in known.items():
                    if all(found.get(name) == tags[name] for name in identity):
                        self._client.delete_model_version(model, version)
                self._client.create_model_version(model, folder.resolve().as_uri(), tags=dict(tags))

    def versions(self, model: str) -> dict[str, dict[str, str]]:
        """Return the tags of each version of a registered model."""
        with self._usable():
            found = self._client.search_model_versions(f"name = '{model}'")
            return {str(one.version): dict(one.tags) for one in found}

    def name_version(self, model: str, alias: str, version: str) -> None:
        """Give a version of a registered model a name of its own, which no other of its versions keeps."""
        with self._usable():
            self._client.set_registered_model_alias(model, alias, version)

    @contextmanager
    def _usable(self) -> Iterator[None]:
        """Say in one line that the store cannot be read or written."""
        from mlflow.exceptions import MlflowException
        from sqlalchemy.exc import SQLAlchemyError

        try:
            yield
        except (MlflowException, SQLAlchemyError) as error:
            raise BadFileError(
                self._database,
                "whole file",
                value=str(error).splitlines()[0],
                expected="an MLflow store with room to write to",
                way_out="free some space, or move the file away: artifacts and records do not depend on it",
            ) from error

    def _delete_earlier(self, name: str, tags: Mapping[str, str]) -> None:
        conditions = [f"attributes.run_name = '{name}'"]
        conditions += [f"tags.`{key}` = '{value}'" for key, value in tags.items() if key != "commit"]
        for run in self._client.search_runs([self._experiment], filter_string=" and ".join(conditions)):
            with suppress(OSError):
                self._client.delete_run(run.info.run_id)
