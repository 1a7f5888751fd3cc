"""What the stubs say is what there is."""

import importlib.util
import subprocess
import sys

import pytest


def test_stubs_are_those_of_the_module(tmp_path):
    pytest.importorskip("mypy", reason="mypy is not installed")
    (tmp_path / "allowed").write_text("isoplanat\\.(torch|jax).*\n")
    # PyTorch, JAX and their types are where they are wanted, and not needed for the rest.
    without = "[mypy-{0}.*]\nignore_missing_imports = True\n[mypy-isoplanat.{0}.*]\nignore_errors = True\n"
    missing = [name for name in ("torch", "jax") if not importlib.util.find_spec(name)]
    (tmp_path / "mypy.ini").write_text("[mypy]\n" + "".join(without.format(name) for name in missing))
    commands = [
        ["mypy.stubtest", "isoplanat", "--allowlist", "allowed", "--ignore-unused-allowlist", "--mypy-config-file", "mypy.ini"],
        ["mypy", "--strict", "-p", "isoplanat", "--config-file", "mypy.ini"],
    ]
    for command in commands:
        done = subprocess.run([sys.executable, "-m", *command], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_everything_public_is_described():
    import isoplanat as iso

    for name in iso.__all__:
        thing = getattr(iso, name)
        if name in ("STATUS", "__version__"):
            continue
        assert (type(thing).__doc__ if name == "render" else thing.__doc__), name
        if isinstance(thing, type):
            for member in (m for m in vars(thing) if not m.startswith("_")):
                described = member in thing.__doc__ or getattr(thing, member).__doc__
                assert described, f"{name}.{member}"
