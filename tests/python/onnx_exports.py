"""Lists the models in a folder as PyTorch exports them, and what onnxruntime makes of three inner values of each.

`OUT/graphs.json` is a list as `onnx_graphs.py` writes it; the models and their files of weights are copied beside it.

    python onnx_exports.py MODELS OUT
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort  # type: ignore[import-untyped]
from onnx import helper

HEIGHT, WIDTH = 32, 64


def main(models: Path, out: Path) -> None:
    picture = np.random.default_rng(11).uniform(-2, 2, (1, 3, HEIGHT, WIDTH)).astype(np.float32)
    picture.tofile(out / f"picture-{WIDTH}x{HEIGHT}-False.f32")
    for path in models.glob("*.onnx*"):
        shutil.copy(path, out)
    rows = []
    for path in sorted(models.glob("*.onnx")):
        model = onnx.load(path)
        inner = [name for node in model.graph.node for name in node.output]
        del model.graph.output[:]
        model.graph.output.extend(helper.make_empty_tensor_value_info(name) for name in inner)
        session = ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        found = dict(zip(inner, session.run(None, {"image": picture}), strict=True))
        maps = [n for n in inner if found[n].ndim == 4 and found[n].dtype == np.float32 and min(found[n].shape[2:]) > 1]
        # Values that are a permutation of a map are no maps.
        maps = [n for n in maps if found[n].shape[1] in (8, 16) and found[n].shape[2] < found[n].shape[3]]
        data = path.with_suffix(".onnx.data").name
        for share in (0.3, 0.6, 1.0):
            tap = maps[round(share * (len(maps) - 1))]
            truth = f"{path.stem}-{share}.f32"
            found[tap].tofile(out / truth)
            row = {"name": f"{path.name} {tap}", "file": path.name, "truth": truth, "tap": tap}
            row |= {"data": data if (models / data).exists() else None, "size": [HEIGHT, WIDTH], "bytes": False}
            rows.append(row | {"is_half": False, "refused": [], "shape": found[tap].shape})
    (out / "graphs.json").write_text(json.dumps(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
