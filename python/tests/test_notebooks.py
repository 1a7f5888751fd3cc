"""The notebooks run from their first cell to their last."""

import json
import os
import subprocess
import sys

import pytest

from conftest import ROOT

BOOKS = sorted((ROOT / "python" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("book", BOOKS, ids=[b.stem for b in BOOKS])
def test_a_notebook_runs(book, tmp_path):
    for package in ("matplotlib", "scipy"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    cells = json.loads(book.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    environment = {**os.environ, "MPLBACKEND": "agg", "MPLCONFIGDIR": str(tmp_path / "mpl"), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if book.stem == "own_loss":
        first, last = done.stdout.split("steps:")[1].split("\n")[0].split(" to ")
        assert float(last) < 0.3 * float(first)


def test_there_are_notebooks():
    assert len(BOOKS) == 3
