"""Exported networks through other programs: onnx's checker and Python's ONNX Runtime.

    ISOPLANAT_ONNX_CHECK=DIR cargo test --release --test integration recorded_models
    python tests/peers/onnx_check.py DIR

DIR holds NAME.onnx with NAME.SIZE.input.npy and NAME.SIZE.output.npy, the in-crate network's answer, f32 [1, 3, row, col].
Every model must pass `onnx.checker.check_model(full_check=True)`, every output must agree to 1e-5 of its largest value.
Needs onnx, onnxruntime, numpy. Exit code 1 where anything fails or nothing is found.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

TOLERANCE = 1e-5


def initializers(model):
    """Data types of the stored weights, by name."""
    return sorted({onnx.TensorProto.DataType.Name(t.data_type) for t in model.graph.initializer})


def check(path):
    """Checks one model and its recorded pairs; returns what is wrong, one text each."""
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    card = {p.key: p.value for p in model.metadata_props}
    wrong = []
    stored = {"f32": ["FLOAT"], "f16": ["FLOAT16"]}[card["isoplanat.weights"]]
    if initializers(model) != stored:
        wrong.append(f"weights are {initializers(model)}, the card says {card['isoplanat.weights']}")
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    inputs = sorted(path.parent.glob(f"{path.stem}.*.input.npy"))
    if not inputs:
        wrong.append("no recorded inputs")
    for at in inputs:
        x = np.load(at)
        expected = np.load(at.with_name(at.name.replace(".input.", ".output.")))
        (y,) = session.run(None, {"input": x})
        if y.shape != expected.shape or y.dtype != np.float32:
            wrong.append(f"{at.name}: {y.dtype} {y.shape} for {expected.shape}")
            continue
        error = np.abs(y - expected).max() / np.abs(expected).max()
        print(f"{path.name:20} {'x'.join(map(str, x.shape)):14} {path.stat().st_size / 1024:8.1f} KiB  {error:.1e}")
        if not error <= TOLERANCE:
            wrong.append(f"{at.name}: differs by {error:.1e} of the largest output")
    return wrong


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    models = sorted(Path(sys.argv[1]).glob("*.onnx"))
    failures = []
    for path in models:
        try:
            failures += [f"{path.name}: {text}" for text in check(path)]
        except Exception as error:  # noqa: BLE001: whatever a model breaks is a failure to report
            failures.append(f"{path.name}: {error}")
    for text in failures:
        print(f"FAILED {text}", file=sys.stderr)
    if not models:
        print(f"FAILED no models in {sys.argv[1]}", file=sys.stderr)
    print(f"onnx {onnx.__version__}, onnxruntime {onnxruntime.__version__}: {len(models)} models, {len(failures)} failures")
    sys.exit(bool(failures) or not models)


if __name__ == "__main__":
    main()
