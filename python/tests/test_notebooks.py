"""The notebooks run from their first cell to their last."""

import importlib.util
import json
import os
import re
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
    wants = [name for name in ("torch",) if f"import {name}" in str(cells)]
    for package in wants:
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    environment = {**os.environ, "MPLBACKEND": "agg", "MPLCONFIGDIR": str(tmp_path / "mpl"), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if book.stem == "own_loss":
        first, last = done.stdout.split("steps:")[1].split("\n")[0].split(" to ")
        assert float(last) < 0.3 * float(first)
    if book.stem == "lens_and_network":
        found = [[float(n) for n in re.findall(r"[0-9.]+", line.split(":")[1])] for line in done.stdout.splitlines()[:2]]
        assert found[1][0] > found[0][0] + 1 and found[1][1] > found[0][1], found
    if book.stem == "restoration":
        capture, picture = re.findall(r"([0-9.]+) dB", done.stdout.splitlines()[-1])
        assert float(picture) > float(capture) + 1, done.stdout


def test_there_are_notebooks():
    assert len(BOOKS) == 5
