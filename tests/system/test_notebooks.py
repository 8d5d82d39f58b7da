"""The notebooks run, and are committed without what they show."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT
from waiting import PATIENCE_S

FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_committed_without_outputs(path: Path) -> None:
    assert len(json.loads(path.read_text())["cells"]) > 0
    for cell in json.loads(path.read_text())["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    for needed in ("ipykernel", "pandas", "matplotlib"):
        pytest.importorskip(needed)
    # Folders of this run alone, with the fonts listed: matplotlib warns when that takes long.
    for name in ("IPYTHONDIR", "MPLCONFIGDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    subprocess.run([sys.executable, "-c", "import matplotlib.font_manager"], check=True)
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    nbclient.NotebookClient(
        notebook,
        timeout=None,
        startup_timeout=int(PATIENCE_S),
        iopub_timeout=int(PATIENCE_S),
        resources={"metadata": {"path": str(FOLDER)}},
    ).execute()
    shown = [
        output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    ]
    assert not [item for item in shown if item.get("name") == "stderr"]  # warnings
    kinds = [kind for item in shown for kind in item.get("data", {})]
    assert kinds.count("image/png") == 3
    assert kinds.count("text/html") == 4  # an evaluation, an outcome, two data frames


def test_there_is_a_notebook() -> None:
    assert NOTEBOOKS
