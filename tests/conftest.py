"""Shared fixtures. Thread settings come first: they hold only when set before torch is imported."""

from __future__ import annotations

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest

if TYPE_CHECKING:
    from fploc.evaluation.records import TrackedRecord
    from fploc.methods.gnn_fpdnn import GNNFPDNN

ROOT = Path(__file__).parents[1]

PLAIN: dict[str, object] = {
    "method": "gnn-fpdnn", "protocol": "zero-shot", "site": "shopping-mall", "device": 1, "labels": "repaired",
    "calibration": "source-los", "plan": "real", "speed_prior": 0.5, "smoother": False, "thin": 1,
    "filter": "kalman", "preset": "full", "seed": 0, "n": 100, "n_before_first_fix": 0, "no_fix_share": 0.0,
    "rmse_m": 1.0, "rmse_fixed_m": 1.0, "mae_m": 0.9, "p50_m": 0.8, "p90_m": 1.6, "p95_m": 2.0,
    "coverage95": 0.9, "nees": 2.0, "ms_per_fix": 0.5, "artifact": None, "commit": "abc",
}  # fmt: skip


@pytest.fixture(scope="session")
def unmeasured() -> dict[str, str]:
    """Environment of a process that coverage does not follow: it writes files, and takes time, of its own."""
    return {
        name: value for name, value in os.environ.items() if not name.startswith(("COVERAGE_", "COV_CORE_"))
    }


@pytest.fixture(scope="session")
def source() -> Path:
    """Local copy of the public data set, laid out ``<revision>/<path>``."""
    folder = Path(os.environ.get("FPLOC_SOURCE", ROOT.parent / "shared" / "rtt-dataset"))
    if not folder.is_dir():
        _go_without(f"no copy of the public data at {folder}: set FPLOC_SOURCE to one (README, 'Tests')")
    return folder


@pytest.fixture(scope="session")
def reference_plans(source: Path) -> Path:
    """Folder beside the public data with plans that others have georeferenced, to compare with."""
    folder = source.parent / "sites"
    if not (folder / "georeference.json").is_file():
        _go_without(f"no reference plans at {folder}: they lie beside the copy of the public data")
    return folder


def _go_without(message: str) -> NoReturn:
    """Skip a test for want of data; where everything must be there, fail it."""
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def data_root(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data root with every registry site that the local copy holds, built once per test session."""
    from fploc.datasets.build import build_sites
    from fploc.sites.registry import known_sites

    root = tmp_path_factory.mktemp("data-root")
    build_sites(source, root, known_sites())
    return root


@pytest.fixture
def untrained_chain() -> GNNFPDNN:
    """The paper's chain with small networks that have learned nothing, on a plan of noise, 40 × 20 m."""
    import torch

    from fploc.filters.kalman import KalmanSettings
    from fploc.floorplan.raster import PlanRaster
    from fploc.methods.gnn import GNNMethod
    from fploc.methods.gnn_fpdnn import GNNFPDNN
    from fploc.models.deepvit import DeepViT
    from fploc.models.fpdnn import FPDNN, DistanceHead
    from fploc.models.gnn import GNN
    from fploc.solvers.nonlinear import solve_nonlinear

    torch.manual_seed(5)
    vision = DeepViT(20, 200, (20, 10), dim=8, depth=1, num_heads=2, head_dim=4)
    return GNNFPDNN(
        coarse=GNNMethod(GNN(hidden=8, message_width=4, layers=2).eval(), variance_m2=1.0),
        network=FPDNN(vision, DistanceHead(64)).eval(),
        plan=PlanRaster(torch.rand(200, 400), torch.tensor([[10.0, 0.0, 20.0], [0.0, -10.0, 180.0]])),
        crops=vision.crops,
        solver=solve_nonlinear,
        sigma_m=0.5,
        filter_settings=KalmanSettings(),
    )


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Interruptions raise in every test: Lightning ignores them in a process from the first one on."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def made() -> Callable[..., TrackedRecord]:
    """Return what makes a record: of zero-shot gnn-fpdnn with KF in the mall, but for what is named."""
    from fploc.evaluation.records import Record, TrackedRecord

    def made(rmse_m: float | None = 1.0, *, made_up: bool = False, **changes: object) -> TrackedRecord:
        values = PLAIN | {"rmse_m": rmse_m} | changes
        return TrackedRecord(Record(**values), "run", "hash", made_up)  # type: ignore[arg-type]

    return made
