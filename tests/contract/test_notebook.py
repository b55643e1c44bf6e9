"""docs/notebook.ipynb: it runs, it is short, and it holds no outputs."""

import json
import sys
from pathlib import Path

import pytest

import hident
from tests.forked import GUARD_SECONDS

NOTEBOOK = Path(hident.__file__).parents[1] / "docs" / "notebook.ipynb"


def code_cells():
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def test_the_notebook_is_short_and_holds_no_outputs():
    assert sum(bool(line.strip()) for cell in code_cells() for line in cell["source"]) < 30
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code_cells())


@pytest.mark.filterwarnings("ignore")  # What the notebook's own packages warn of is not ours to mend.
@pytest.mark.skipif(sys.platform == "win32", reason="the kernel's sockets want another event loop")
def test_the_notebook_runs(tmp_path, monkeypatch):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("MPLBACKEND", "agg")
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    client = nbclient.NotebookClient(
        notebook, timeout=GUARD_SECONDS, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    table = notebook.cells[-1].outputs[0]["data"]["text/plain"].split()
    assert table[table.index("samples") + 1 :: 3] == ["100", "300", "1000"]
