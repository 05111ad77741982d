"""The trained network as one ONNX file, checked against PyTorch."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray
from onnx.reference import ReferenceEvaluator

from evaluation import Predict
from network import TAPS, ExportedNetwork, LaneNetwork, fold_batch_norms
from scenes import Size

OPSET = 17
OUTPUTS = ("lane", *TAPS)
# Largest difference between onnxruntime and PyTorch, as a share of the output's largest value.
TOLERANCE = 1e-3


class ExportError(Exception):
    """The exported file is not what was trained."""


@dataclass(frozen=True)
class Agreement:
    """Largest difference from PyTorch by output, as a share of the output's largest value."""

    images: int
    relative: dict[str, float]

    def worst(self) -> float:
        return max(self.relative.values())


def export(network: LaneNetwork, size: Size, file: Path) -> None:
    """Writes `file`: batch 1, fp32, batch norms folded, weights inside.

    Input `image` `[1, 3, H, W]`; outputs `lane` `[1, 1, H, W]`, then `e2`, `e3`, `e4`
    `[1, C, H/8, W/8]`.
    """
    folded = ExportedNetwork(fold_batch_norms(network)).eval()
    image = torch.zeros(1, 3, size.height, size.width)
    with warnings.catch_warnings():
        # The tracing exporter is called old-fashioned; it is the one that needs no other package.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            folded,
            (image,),
            str(file),
            dynamo=False,
            opset_version=OPSET,
            input_names=["image"],
            output_names=list(OUTPUTS),
        )
    model = onnx.load(str(file))
    _fold_constants(model)
    _tidy_names(model.graph)
    onnx.checker.check_model(model, full_check=True)
    kinds = {node.op_type for node in model.graph.node}
    if "BatchNormalization" in kinds:
        raise ExportError(f"{file}: a batch norm was left unfolded")
    if tuple(output.name for output in model.graph.output) != OUTPUTS:
        raise ExportError(f"{file}: outputs are not {OUTPUTS}")
    onnx.save(model, str(file))


def prediction_of_file(file: Path, threads: int) -> Predict:
    """The file in onnxruntime as a `Predict`; images go through one at a time."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(
        str(file), options, providers=["CPUExecutionProvider"]
    )

    def predict(inputs: NDArray[np.float32]) -> tuple[NDArray[np.float32], dict[str, NDArray]]:
        images = (inputs[i : i + 1] for i in range(len(inputs)))
        answers = [session.run(list(OUTPUTS), {"image": image}) for image in images]
        lane, *taps = (np.concatenate(parts) for parts in zip(*answers, strict=True))
        return lane, dict(zip(TAPS, taps, strict=True))

    return predict


def compare(trained: Predict, exported: Predict, inputs: NDArray[np.float32]) -> Agreement:
    """Largest relative difference between the two on `inputs` `[N, 3, H, W]`.

    Raises `ExportError` above `TOLERANCE`, or where a value is not finite.
    """
    lane, taps = trained(inputs)
    lane_exported, taps_exported = exported(inputs)
    pairs = {"lane": (lane, lane_exported)}
    pairs |= {tap: (taps[tap], taps_exported[tap]) for tap in TAPS}
    relative = {}
    for name, (wanted, found) in pairs.items():
        if wanted.shape != found.shape:
            raise ExportError(f"{name}: shape {found.shape} in the file, {wanted.shape} in PyTorch")
        if not (np.isfinite(wanted).all() and np.isfinite(found).all()):
            raise ExportError(f"{name}: values that are not finite")
        scale = max(float(np.abs(wanted).max()), 1e-12)
        relative[name] = float(np.abs(wanted - found).max()) / scale
    agreement = Agreement(len(inputs), relative)
    if agreement.worst() >= TOLERANCE:
        raise ExportError(f"the exported file differs from PyTorch: {relative}")
    return agreement


def _fold_constants(model: onnx.ModelProto) -> None:
    """Turns every tensor that does not depend on the image into a stored one (paddings, scales)."""
    graph = model.graph
    stored = {initializer.name for initializer in graph.initializer}
    fixed: list[onnx.NodeProto] = []
    live: list[onnx.NodeProto] = []
    known = set(stored)
    for node in graph.node:
        if all(name in known or not name for name in node.input):
            fixed.append(node)
            known.update(node.output)
        else:
            live.append(node)
    used = {name for node in live for name in node.input}
    wanted = [name for node in fixed for name in node.output if name in used]
    if wanted:
        outputs = [onnx.ValueInfoProto(name=name) for name in wanted]
        part = onnx.helper.make_graph(fixed, "fixed", [], outputs, list(graph.initializer))
        part_model = onnx.helper.make_model(
            part, opset_imports=model.opset_import, ir_version=model.ir_version
        )
        values = ReferenceEvaluator(part_model).run(wanted, {})
        for name, value in zip(wanted, values, strict=True):
            graph.initializer.append(onnx.numpy_helper.from_array(np.asarray(value), name))
    for node in live:
        while node.input and not node.input[-1]:
            node.input.pop()
    del graph.node[:]
    graph.node.extend(live)
    kept = [initializer for initializer in graph.initializer if initializer.name in used]
    del graph.initializer[:]
    graph.initializer.extend(kept)


def _tidy_names(graph: onnx.GraphProto) -> None:
    """`/network/encoder/e2/e2.0/...` becomes `encoder/e2.0/...`, in nodes and tensors."""

    def tidy(name: str) -> str:
        parts: list[str] = []
        for part in name.removeprefix("/").removeprefix("network").split("/"):
            if not part:
                continue
            if parts and part.startswith(parts[-1] + "."):
                parts[-1] = part
            else:
                parts.append(part)
        text = "/".join(parts).removeprefix(".")
        return text.removesuffix("_output_0")

    kept = {graph.input[0].name, *OUTPUTS}
    renamed: dict[str, str] = {}

    def rename(name: str) -> str:
        if not name or name in kept:
            return name
        if name not in renamed:
            new = tidy(name)
            if new in renamed.values() or new in kept:
                raise ExportError(f"two tensors would be named {new}")
            renamed[name] = new
        return renamed[name]

    for initializer in graph.initializer:
        initializer.name = rename(initializer.name)
    for node in graph.node:
        node.name = tidy(node.name)
        node.input[:] = [rename(name) for name in node.input]
        node.output[:] = [rename(name) for name in node.output]
    del graph.value_info[:]
