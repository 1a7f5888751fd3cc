"""The Python that the manual prints runs as printed."""

import importlib.util
import os
import subprocess
import sys

import pytest

from conftest import ROOT


def blocks(page):
    for rest in (ROOT / page).read_text(encoding="utf-8").split("\n```python\n")[1:]:
        yield rest.split("\n```")[0]


PRINTED = [(page, code) for page in ["README.md", "docs/python.md", "docs/torch.md", "python/README.md"] for code in blocks(page)]


@pytest.mark.parametrize(("page", "code"), PRINTED, ids=[f"{page}-{k}" for k, (page, _) in enumerate(PRINTED)])
def test_printed_python_runs(page, code, tmp_path):
    if "scipy" in code:
        pytest.importorskip("scipy", reason="scipy is not installed")
    for name in ("torch", "jax"):
        if f"import {name}" in code and importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed")
    # PyTorch leaves a folder of its own behind.
    environment = {**os.environ, "PYTHONWARNINGS": "error,ignore::ResourceWarning" if "import torch" in code else "error"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    if "minimize" in code:
        found, first = map(float, done.stdout.split(" from "))
        assert found < 0.5 * first
