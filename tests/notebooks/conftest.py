"""Notebooks run on made-up buildings, and on a miniature of what ``make reproduce`` writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from fploc.datasets.build import build_sites
from fploc.sites.made_up import made_up_site

FOLDER = Path(__file__).parents[2] / "notebooks"
TIMEOUT_S = 600

Execute = Callable[[str, Path, Path], nbformat.NotebookNode]
Outputs = Callable[[nbformat.NotebookNode, str], list[str]]


@pytest.fixture(scope="session")
def notebook_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data root with two made-up buildings of five short laps."""
    root = tmp_path_factory.mktemp("notebook-data")
    build_sites(None, root, [made_up_site(seed, root / "files", laps=5, duration_s=30.0) for seed in (1, 2)])
    return root


@pytest.fixture(scope="session")
def execute() -> Execute:
    """Return what executes the notebook whose name begins so, on a data root and a folder of runs."""

    def execute(name: str, data_root: Path, runs: Path) -> nbformat.NotebookNode:
        (path,) = FOLDER.glob(f"{name}*.ipynb")
        notebook = nbformat.read(path, as_version=4)
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("FPLOC_DATA", str(data_root))
            patch.setenv("FPLOC_RUNS", str(runs))
            place = {"metadata": {"path": str(path.parent)}}
            client = NotebookClient(
                notebook,
                timeout=TIMEOUT_S,
                startup_timeout=TIMEOUT_S,
                kernel_name="python3",
                resources=place,
            )
            return client.execute()

    return execute


@pytest.fixture(scope="session")
def outputs() -> Outputs:
    """Return what lists the outputs of one MIME type of an executed notebook."""

    def outputs(notebook: nbformat.NotebookNode, kind: str) -> list[str]:
        shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
        return [output["data"][kind] for output in shown if kind in output.get("data", {})]

    return outputs
