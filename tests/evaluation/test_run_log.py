from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import mlflow
import pytest
from matplotlib.figure import Figure
from mlflow.entities import Run

from fploc.errors import FplocError
from fploc.evaluation.run_log import RunLog

TAGS = {"kind": "zero-shot", "site": "hall", "commit": "abc"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one store: opening a new one takes seconds."""
    return tmp_path_factory.mktemp("runs")


def record(log: RunLog, name: str, *, tags: dict[str, str] = TAGS, rmse_m: float = 1.5) -> str:
    return log.record(
        name,
        tags=tags,
        parameters={"thin": 20, "calibration": "source-los"},
        metrics={"device1.repaired.kalman.rmse_m": rmse_m, "nan": float("nan"), "inf": float("-inf")},
        figures={},
        folders={},
    )


def runs_of(folder: Path, experiment: str) -> list[Run]:
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{folder / 'mlflow.db'}")
    found = client.get_experiment_by_name(experiment)
    assert found is not None
    return list(client.search_runs([found.experiment_id]))


def test_a_run_is_read_back_as_it_was_written(folder: Path, tmp_path: Path) -> None:
    log = RunLog(folder, "whole")
    (tmp_path / "weights.bin").write_bytes(b"123")
    figure = Figure()
    figure.subplots().plot([0, 1])
    run_id = log.record(
        "nls · hall",
        tags=TAGS,
        parameters={"thin": 20},
        metrics={"rmse_m": 1.5},
        figures={"cdf.png": figure},
        folders={"model": tmp_path},
    )
    (run,) = runs_of(folder, "whole")
    assert run.info.run_id == run_id and run.info.run_name == "nls · hall" and run.info.status == "FINISHED"
    assert run.data.metrics == {"rmse_m": 1.5} and run.data.params == {"thin": "20"}
    assert TAGS.items() <= run.data.tags.items()
    written = {
        path.relative_to(folder / "mlflow-artifacts" / run_id)
        for path in folder.rglob("*.*")
        if run_id in path.parts
    }
    assert written == {Path("artifacts/figures/cdf.png"), Path("artifacts/model/weights.bin")}


def test_metrics_that_are_not_finite_are_left_out(folder: Path) -> None:
    record(RunLog(folder, "finite"), "a")
    (run,) = runs_of(folder, "finite")
    assert run.data.metrics == {"device1.repaired.kalman.rmse_m": 1.5}


def test_a_repeated_run_takes_the_place_of_the_earlier_one(folder: Path) -> None:
    log = RunLog(folder, "repeated")
    record(log, "a")
    record(log, "b")
    again = record(RunLog(folder, "repeated"), "a", tags=TAGS | {"commit": "def"}, rmse_m=2.5)
    runs = {run.info.run_name: run for run in runs_of(folder, "repeated")}
    assert set(runs) == {"a", "b"} and runs["a"].info.run_id == again
    assert runs["a"].data.metrics["device1.repaired.kalman.rmse_m"] == 2.5


def test_a_run_with_other_tags_stays(folder: Path) -> None:
    log = RunLog(folder, "tags")
    record(log, "a")
    record(log, "a", tags=TAGS | {"site": "mall"})
    assert len(runs_of(folder, "tags")) == 2


def test_curves_of_a_training_go_to_a_run_with_its_tags(folder: Path) -> None:
    log = RunLog(folder, "curves")
    logger = log.training_logger("train gnn", TAGS)
    for step in range(3):
        logger.log_metrics({"val/rmse_m": 3.0 - step}, step=step)
    logger.finalize("success")
    (run,) = runs_of(folder, "curves")
    assert run.info.run_name == "train gnn" and run.data.tags["kind"] == "zero-shot"
    assert run.data.metrics["val/rmse_m"] == 1.0


def test_a_store_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "mlflow.db").write_text("no database, " * 100)
    with pytest.raises(FplocError, match=r"mlflow\.db, whole file: found .*; "):
        RunLog(tmp_path, "odd")


def test_a_full_disk_ends_in_one_line(tmp_path: Path, unmeasured: dict[str, str]) -> None:
    script = (
        "import resource, sys; from pathlib import Path\n"
        "from fploc.errors import FplocError; from fploc.evaluation.run_log import RunLog\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, (4096, {resource.RLIM_INFINITY}))\n"
        f"try: RunLog(Path({str(tmp_path)!r}), 'full')\n"
        "except FplocError as error: sys.exit('one line: ' + str(error))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env=unmeasured, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("one line: ") and "Traceback" not in done.stderr
