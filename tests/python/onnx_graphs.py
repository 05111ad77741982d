"""Writes small ONNX graphs, one operator with one choice of attributes each, and what onnxruntime makes of them.

Every graph is a picture `x` [1, 3, H, W] through a convolution of eight channels, so that values have both signs, and then
through what is tried, at several sizes. `OUT/graphs.json` lists for each graph its file, its size, the shape of its value
`y` [1, C, h, w] and the file with onnxruntime's values (32-bit floats). Where onnxruntime has no kernel, onnx's reference
implementation is used. A graph that must be refused has what must be said.

    python onnx_graphs.py OUT
"""

import json
import sys
from collections.abc import Callable, Iterable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort  # type: ignore[import-untyped]
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

# Even and odd sides; the last one is used where a graph states its own sizes.
SIZES = [(50, 66), (33, 47), (24, 40)]
F32 = np.float32


class Graph:
    """A graph being written; its weights are always the same."""

    def __init__(self, size: tuple[int, int], opset: int = 17) -> None:
        self.height, self.width = size
        self.opset = opset
        self.nodes: list[onnx.NodeProto] = []
        self.weights: dict[str, np.ndarray] = {}
        self.random = np.random.default_rng(7)
        self.input_type = TensorProto.FLOAT
        self.input_shape: list[int | str] | None = None
        self.functions: list[onnx.FunctionProto] = []
        self.domains: list[onnx.OperatorSetIdProto] = []

    def const(self, values: Any, kind: Any = None) -> str:
        name = f"c{len(self.weights)}"
        self.weights[name] = np.asarray(values, kind)
        return name

    def ints(self, *values: int) -> str:
        return self.const(np.array(values, np.int64))

    def scalar(self, value: float) -> str:
        return self.const(F32(value))

    def normal(self, *shape: int, deviation: float = 0.4) -> str:
        return self.const(self.random.normal(0, deviation, shape).astype(F32))

    def op(self, kind: str, inputs: list[str], outputs: int = 1, **attributes: Any) -> Any:
        names = [f"v{len(self.nodes)}" + (f"_{i}" if i else "") for i in range(outputs)]
        self.nodes.append(helper.make_node(kind, inputs, names, **attributes))
        return names[0] if outputs == 1 else names

    def stem(self, channels: int = 8, stride: int = 1) -> str:
        """A convolution of the picture."""
        inputs = ["x", self.normal(channels, 3, 3, 3), self.normal(channels)]
        return self.op("Conv", inputs, pads=[1] * 4, strides=[stride] * 2)

    def model(self, output: str, kind: int = TensorProto.FLOAT) -> onnx.ModelProto:
        self.nodes.append(helper.make_node("Identity", [output], ["y"]))
        shape = self.input_shape or [1, 3, self.height, self.width]
        graph = helper.make_graph(
            self.nodes,
            "graph",
            [helper.make_tensor_value_info("x", self.input_type, shape)],
            [helper.make_tensor_value_info("y", kind, None)],
            [numpy_helper.from_array(values, name) for name, values in self.weights.items()],
        )
        opsets = [helper.make_opsetid("", self.opset), *self.domains]
        ir_version = {n: v for _, v, n, *_ in helper.VERSION_TABLE for n in [n]}[self.opset]
        return helper.make_model(
            graph, opset_imports=opsets, ir_version=ir_version, functions=self.functions
        )


Build = Callable[[Graph], Any]
CASES: dict[str, tuple[Build, int, list[tuple[int, int]]]] = {}


def case(name: str, build: Build, opset: int = 17, sizes: list[tuple[int, int]] | None = None) -> None:
    """Adds a graph; `build` returns the name of its value or a whole model."""
    assert name not in CASES, name
    CASES[name] = (build, opset, sizes or SIZES[:2])


def unary(kind: str, opset: int = 17, **attributes: Any) -> None:
    text = "_".join(f"{k}={v}" for k, v in attributes.items()).replace(" ", "")
    case(f"{kind}_{opset}_{text}", lambda g: g.op(kind, [g.stem()], **attributes), opset)


def poolings() -> None:
    windows = [(3, 2, 0), (3, 2, 1), (2, 2, 0), (3, 3, 1), (2, 3, 0), (5, 1, 2), (4, 3, 1)]
    for (k, s, p), ceil in product(windows, (0, 1)):
        at = {"kernel_shape": [k, k], "strides": [s, s], "pads": [p] * 4, "ceil_mode": ceil}
        for opset in (11, 22):
            unary("MaxPool", opset, **at)
            for include in (0, 1):
                unary("AveragePool", opset, count_include_pad=include, **at)
    for auto, (k, s) in product(("SAME_UPPER", "SAME_LOWER", "VALID"), ((3, 2), (2, 2), (4, 3), (3, 1))):
        at = {"kernel_shape": [k, k], "strides": [s, s], "auto_pad": auto}
        unary("MaxPool", **at)
        for include in (0, 1):
            unary("AveragePool", count_include_pad=include, **at)
    for pads, ceil in product(([0, 1, 1, 0], [1, 0, 0, 1], [0, 0, 1, 1], [2, 0, 1, 2]), (0, 1)):
        at = {"kernel_shape": [3, 3], "strides": [2, 2], "pads": pads, "ceil_mode": ceil}
        unary("MaxPool", **at)
        for include in (0, 1):
            unary("AveragePool", 19, count_include_pad=include, **at)
    for dilation, stride, pad, ceil in product((2, 3), (1, 2), (0, 1), (0, 1)):
        at = {
            "kernel_shape": [3, 3],
            "dilations": [dilation] * 2,
            "strides": [stride] * 2,
            "pads": [pad] * 4,
            "ceil_mode": ceil,
        }
        unary("MaxPool", **at)
        for include in (0, 1):
            unary("AveragePool", 19, count_include_pad=include, **at)
    for auto in ("SAME_UPPER", "SAME_LOWER", "VALID"):
        for kind in ("MaxPool", "AveragePool"):
            unary(kind, kernel_shape=[3, 3], strides=[2, 2], auto_pad=auto, ceil_mode=1)
        unary("MaxPool", kernel_shape=[3, 3], strides=[2, 2], auto_pad=auto, dilations=[2, 2])
    unary("MaxPool", kernel_shape=[3, 1], strides=[1, 2])
    unary("MaxPool", kernel_shape=[2, 3])
    unary("AveragePool", kernel_shape=[1, 3], pads=[0, 1, 0, 1])
    unary("LpPool", 11, kernel_shape=[3, 3], strides=[2, 2], p=2)
    unary("LpPool", 18, kernel_shape=[2, 2], strides=[2, 2], p=1)
    case("MaxPool_indices_unused", lambda g: g.op("MaxPool", [g.stem()], 2, kernel_shape=[2, 2], strides=[2, 2])[0])
    case(
        "MaxPool_indices_used",
        lambda g: g.op(
            "Cast",
            [g.op("MaxPool", [g.stem()], 2, kernel_shape=[2, 2], strides=[2, 2])[1]],
            to=TensorProto.FLOAT,
        ),
    )
    for kind in ("GlobalAveragePool", "GlobalMaxPool", "GlobalLpPool"):
        case(kind, lambda g, k=kind: (s := g.stem(), g.op("Mul", [s, g.op(k, [s])]))[1])
    unpool_sizes = [(24, 40)]
    case(
        "MaxUnpool",
        lambda g: g.op(
            "MaxUnpool",
            g.op("MaxPool", [g.stem()], 2, kernel_shape=[2, 2], strides=[2, 2]),
            kernel_shape=[2, 2],
            strides=[2, 2],
        ),
        sizes=unpool_sizes,
    )


def convolution(shape: tuple[int, ...], opset: int = 17, bias: bool = True, stem: int = 8, **attributes: Any) -> None:
    text = "_".join(f"{k}={v}" for k, v in attributes.items()).replace(" ", "")
    name = f"Conv_{'x'.join(map(str, shape))}_{opset}_{bias}_{text}"

    def build(g: Graph) -> str:
        inputs = [g.stem(stem), g.normal(*shape)] + ([g.normal(shape[0])] if bias else [])
        return g.op("Conv", inputs, **attributes)

    case(name, build, opset)


def transposed(shape: tuple[int, ...], bias: bool = True, opset: int = 17, **attributes: Any) -> None:
    text = "_".join(f"{k}={v}" for k, v in attributes.items()).replace(" ", "")
    name = f"ConvTranspose_{'x'.join(map(str, shape))}_{opset}_{bias}_{text}"
    outputs = shape[1] * attributes.get("group", 1)

    def build(g: Graph) -> str:
        inputs = [g.stem(), g.normal(*shape)] + ([g.normal(outputs)] if bias else [])
        return g.op("ConvTranspose", inputs, **attributes)

    sizes = SIZES[2:] if "output_shape" in attributes else SIZES[:2]
    case(name, build, opset, sizes)


def convolutions() -> None:
    convolution((6, 8, 3, 3), pads=[0, 1, 2, 0])
    convolution((6, 8, 3, 3), 22, kernel_shape=[3, 3], pads=[1, 1, 1, 1])
    for auto, (k, s, d) in product(
        ("SAME_UPPER", "SAME_LOWER", "VALID", "NOTSET"), ((3, 2, 1), (4, 3, 1), (2, 1, 1), (5, 2, 1), (3, 1, 2), (4, 3, 2))
    ):
        convolution((6, 8, k, k), auto_pad=auto, strides=[s, s], dilations=[d, d])
    convolution((8, 1, 3, 3), group=8, pads=[1] * 4)
    convolution((8, 1, 3, 3), group=8, auto_pad="SAME_UPPER", strides=[2, 2])
    convolution((16, 1, 5, 5), group=8, pads=[2] * 4)
    convolution((6, 4, 3, 3), group=2, dilations=[2, 2], pads=[2] * 4)
    convolution((6, 8, 5, 1), pads=[2, 0, 2, 0])
    convolution((6, 8, 1, 5), pads=[0, 4, 0, 4], dilations=[1, 2])
    convolution((6, 8, 3, 3), pads=[16] * 4, dilations=[16, 16])
    convolution((6, 8, 1, 1), strides=[3, 3], bias=False)
    convolution((6, 8, 4, 4), strides=[2, 2], pads=[1] * 4)
    convolution((6, 8, 7, 7), strides=[2, 2], pads=[3] * 4, bias=False)
    convolution((6, 8, 3, 3), pads=[5, 5, 5, 5])
    convolution((6, 8, 3, 3), strides=[2, 1], pads=[1] * 4)
    transposed((8, 6, 4, 4), strides=[2, 2], pads=[1] * 4)
    transposed((8, 6, 4, 4), strides=[2, 2], pads=[1] * 4, bias=False)
    transposed((8, 6, 4, 4), opset=22, strides=[2, 2], pads=[1] * 4, kernel_shape=[4, 4])
    transposed((8, 6, 2, 2), strides=[2, 2])
    transposed((8, 6, 3, 3))
    transposed((8, 6, 1, 1), strides=[2, 2])
    transposed((8, 6, 3, 3), strides=[2, 2], pads=[1] * 4, output_padding=[1, 1])
    transposed((8, 6, 3, 3), strides=[3, 2], pads=[0, 1, 1, 0], output_padding=[2, 1])
    transposed((8, 3, 4, 4), strides=[2, 2], pads=[1] * 4, group=2)
    transposed((8, 3, 3, 3), strides=[2, 2], pads=[1] * 4, group=2, output_padding=[1, 1])
    transposed((8, 1, 4, 4), strides=[2, 2], pads=[1] * 4, group=8)
    transposed((8, 2, 4, 4), strides=[2, 2], pads=[1] * 4, group=8)
    for stride in (1, 2):
        transposed((8, 6, 3, 3), strides=[stride] * 2, pads=[2] * 4, dilations=[2, 2])
    transposed((8, 6, 3, 3), strides=[2, 2], pads=[0, 1, 1, 0])
    transposed((8, 6, 3, 3), strides=[2, 2], pads=[1, 0, 0, 1])
    for auto, (k, s) in product(("SAME_UPPER", "SAME_LOWER", "VALID", "NOTSET"), ((3, 2), (4, 2), (3, 1), (2, 3), (5, 2))):
        transposed((8, 6, k, k), strides=[s, s], auto_pad=auto)
    transposed((8, 6, 3, 3), strides=[2, 2], auto_pad="SAME_UPPER", output_padding=[1, 1])
    for shape, auto in product(([48, 80], [47, 79], [49, 81], [50, 82], [51, 83]), (None, "SAME_UPPER", "SAME_LOWER")):
        for kernel in (3, 4):
            at = {"strides": [2, 2], "output_shape": shape} | ({"auto_pad": auto} if auto else {})
            transposed((8, 6, kernel, kernel), **at)
    transposed((8, 6, 3, 3), strides=[2, 2], output_shape=[48, 80], pads=[1] * 4)
    transposed((8, 6, 3, 3), strides=[2, 2], output_shape=[48, 80], output_padding=[1, 1])
    transposed((8, 6, 3, 3), strides=[2, 2], output_shape=[52, 84], dilations=[2, 2])


def resize(name: str, opset: int, scales: list[float] | None, sizes: list[int] | None, **attributes: Any) -> None:
    text = "_".join(f"{k}={v}" for k, v in attributes.items()).replace(" ", "")

    def build(g: Graph) -> str:
        inputs = [g.stem(), ""] if opset >= 13 else [g.stem(), g.const(np.zeros(0, F32))]
        if scales is not None:
            inputs.append(g.const(np.array(scales, F32)))
        else:
            inputs += ["" if opset >= 13 else g.const(np.zeros(0, F32)), g.const(np.array(sizes, np.int64))]
        resized = g.op("Resize", inputs, **attributes)
        # A single pixel is no map that could be looked at.
        return resized if sizes != [1, 8, 1, 1] else g.op("Add", [inputs[0], resized])

    case(f"Resize_{opset}_{name}_{text}", build, opset)


COORDINATES = ("half_pixel", "pytorch_half_pixel", "align_corners", "asymmetric")


def resizes() -> None:
    factors = {"x2": (2, 2), "x1.5": (1.5, 1.5), "x1.3": (1.3, 1.3), "x0.6": (0.6, 0.6), "half": (0.5, 0.5), "uneven": (1.7, 0.8), "x3": (3, 3)}
    for at, (name, (y, x)) in product(COORDINATES, factors.items()):
        for mode in ("linear", "cubic"):
            resize(name, 13, [1, 1, y, x], None, mode=mode, coordinate_transformation_mode=at)
        for rounding in ("floor", "ceil", "round_prefer_floor", "round_prefer_ceil"):
            resize(name, 13, [1, 1, y, x], None, mode="nearest", nearest_mode=rounding, coordinate_transformation_mode=at)
    for at, sizes in product(COORDINATES, ([77, 101], [20, 31], [1, 1], [100, 132], [50, 200])):
        name = "x".join(map(str, sizes))
        for mode in ("linear", "cubic", "nearest"):
            resize(name, 13, None, [1, 8, *sizes], mode=mode, coordinate_transformation_mode=at)
    for opset in (11, 18, 19, 23):
        for at, mode in product(COORDINATES, ("linear", "nearest", "cubic")):
            resize("x2", opset, [1, 1, 2, 2], None, mode=mode, coordinate_transformation_mode=at)
            resize("sizes", opset, None, [1, 8, 77, 101], mode=mode, coordinate_transformation_mode=at)
    for name, (y, x) in factors.items():
        resize(name, 19, [1, 1, y, x], None, mode="linear", coordinate_transformation_mode="half_pixel_symmetric")
        resize(name, 18, [1, 1, y, x], None, mode="linear", antialias=1)
        resize(name, 18, [1, 1, y, x], None, mode="cubic", antialias=1)
    resize("sizes", 18, None, [1, 8, 20, 31], mode="linear", antialias=1)
    resize("axes", 18, [2, 2], None, mode="linear", axes=[2, 3])
    resize("axes", 18, [1.5, 2], None, mode="linear", axes=[3, 2])
    resize("axes", 18, [2], None, mode="nearest", axes=[2])
    resize("axes", 18, None, [100, 132], mode="nearest", axes=[2, 3], coordinate_transformation_mode="asymmetric", nearest_mode="floor")
    for policy in ("not_larger", "not_smaller", "stretch"):
        resize("aspect", 18, None, [80, 80], mode="linear", axes=[2, 3], keep_aspect_ratio_policy=policy)
    resize("x2", 13, [1, 1, 2, 2], None, mode="cubic", exclude_outside=1)
    resize("x2", 13, [1, 1, 2, 2], None, mode="cubic", cubic_coeff_a=-0.5)
    for mode, name in product(("linear", "cubic"), ("x1.3", "half")):
        y, x = factors[name]
        resize(name, 18, [1, 1, y, x], None, mode=mode, exclude_outside=1)
        resize(name, 18, [1, 1, y, x], None, mode=mode, coordinate_transformation_mode="align_corners", antialias=1)
        resize(name, 18, [1, 1, y, x], None, mode=mode, coordinate_transformation_mode="asymmetric", antialias=1)
    resize("channels", 13, [1, 2, 1, 1], None, mode="nearest", nearest_mode="floor", coordinate_transformation_mode="asymmetric")
    resize("x2", 11, [1, 1, 2, 2], None, mode="nearest", coordinate_transformation_mode="tf_half_pixel_for_nn", nearest_mode="floor")
    case(
        "Resize_13_crop",
        lambda g: g.op(
            "Resize",
            [g.stem(), g.const([0, 0, 0.1, 0.2, 1, 1, 0.8, 0.9], F32), "", g.ints(1, 8, 40, 50)],
            mode="linear",
            coordinate_transformation_mode="tf_crop_and_resize",
        ),
        13,
    )
    for mode in ("linear", "nearest"):
        for factor in (2.0, 1.5):
            scales = [1, 1, factor, factor]
            case(f"Resize_10_{mode}_{factor}", lambda g, s=scales, m=mode: g.op("Resize", [g.stem(), g.const(s, F32)], mode=m), 10)
            case(f"Upsample_9_{mode}_{factor}", lambda g, s=scales, m=mode: g.op("Upsample", [g.stem(), g.const(s, F32)], mode=m), 9)
            case(f"Upsample_7_{mode}_{factor}", lambda g, s=scales, m=mode: g.op("Upsample", [g.stem()], mode=m, scales=s), 7)

    def to_size_of(g: Graph) -> str:
        g.input_shape = ["n", 3, "height", "width"]
        s = g.stem()
        small = g.op("MaxPool", [s], kernel_shape=[2, 2], strides=[2, 2])
        sides = g.op("Slice", [g.op("Shape", [s]), g.ints(2), g.ints(4), g.ints(0)])
        rest = g.op("Slice", [g.op("Shape", [small]), g.ints(0), g.ints(2), g.ints(0)])
        sizes = g.op("Concat", [rest, sides], axis=0)
        return g.op("Resize", [small, "", "", sizes], mode="linear", coordinate_transformation_mode="align_corners")

    case("Resize_13_to_size_of_another", to_size_of, 13)


def activations() -> None:
    for kind, opset, attributes in [
        ("Relu", 7, {}), ("Relu", 22, {}),
        ("HardSwish", 14, {}), ("HardSwish", 22, {}), ("HardSigmoid", 14, {"alpha": 1 / 6, "beta": 0.5}), ("HardSigmoid", 22, {}),
        ("Mish", 18, {}), ("Mish", 22, {}), ("Gelu", 20, {}), ("Gelu", 20, {"approximate": "tanh"}), ("Gelu", 20, {"approximate": "none"}),
        ("Elu", 13, {"alpha": 0.7}), ("Elu", 13, {}), ("Elu", 22, {}), ("Selu", 13, {}), ("Selu", 13, {"alpha": 1.5, "gamma": 0.8}),
        ("Celu", 13, {"alpha": 2.0}), ("Celu", 13, {}), ("Celu", 13, {"alpha": 0.3}),
        ("LeakyRelu", 13, {"alpha": 0.1}), ("LeakyRelu", 7, {"alpha": 1.5}), ("LeakyRelu", 16, {}), ("LeakyRelu", 16, {"alpha": -0.2}),
        ("ThresholdedRelu", 13, {"alpha": 0.3}), ("ThresholdedRelu", 10, {}), ("Softplus", 13, {}), ("Softsign", 13, {}),
        ("Tanh", 13, {}), ("Erf", 13, {}), ("Sigmoid", 13, {}), ("Exp", 13, {}), ("Abs", 13, {}), ("Round", 13, {}), ("Neg", 13, {}),
        ("Floor", 13, {}), ("Ceil", 13, {}), ("Sign", 13, {}), ("Sin", 13, {}), ("Cos", 13, {}), ("Atan", 13, {}), ("Sinh", 13, {}), ("Reciprocal", 13, {}),
        ("Shrink", 13, {"bias": 0.1, "lambd": 0.3}), ("Swish", 24, {}), ("Swish", 24, {"alpha": 1.7}),
        ("LRN", 13, {"size": 5, "alpha": 0.01, "beta": 0.75, "bias": 1.0}), ("LRN", 13, {"size": 3}), ("LRN", 13, {"size": 4, "alpha": 0.3, "beta": 0.5, "bias": 2.0}),
        ("LpNormalization", 13, {"axis": 1, "p": 2}), ("LpNormalization", 13, {"axis": 1, "p": 1}), ("LpNormalization", 13, {}),
        ("MeanVarianceNormalization", 13, {}), ("MeanVarianceNormalization", 13, {"axes": [2, 3]}),
        ("Clip", 7, {"min": 0.0, "max": 0.5}), ("Clip", 7, {"max": 0.5}), ("Clip", 7, {"min": -0.1}),
        ("Dropout", 7, {}), ("Dropout", 10, {"ratio": 0.3}), ("Flatten", 13, {}),
    ]:
        if kind != "Flatten":
            unary(kind, opset, **attributes)
    for kind, opset, axis in product(("Softmax", "LogSoftmax", "Hardmax"), (11, 13, 17), (None, 0, 1, 2, 3, -1, -2)):
        at = {} if axis is None else {"axis": axis}
        unary(kind, opset, **at)
    bounded = [("min_max", -0.2, 0.5), ("max", None, 0.5), ("min", 0.1, None), ("none", None, None), ("six", 0.0, 6.0)]
    for name, low, high in bounded:
        case(f"Clip_13_{name}", lambda g, a=low, b=high: g.op("Clip", [g.stem(), "" if a is None else g.scalar(a), "" if b is None else g.scalar(b)]), 13)
    case("Clip_13_min_alone", lambda g: g.op("Clip", [g.stem(), g.scalar(0)]), 13)
    case("silu", lambda g: (s := g.stem(), g.op("Mul", [s, g.op("Sigmoid", [s])]))[1])
    case(
        "hard_swish_of_parts",
        lambda g: (s := g.stem(), g.op("Div", [g.op("Mul", [s, g.op("Clip", [g.op("Add", [s, g.scalar(3)]), g.scalar(0), g.scalar(6)])]), g.scalar(6)]))[1],
    )
    case(
        "gelu_of_parts",
        lambda g: (
            s := g.stem(),
            g.op("Mul", [g.op("Mul", [s, g.op("Add", [g.op("Erf", [g.op("Div", [s, g.scalar(2**0.5)])]), g.scalar(1)])]), g.scalar(0.5)]),
        )[1],
    )
    for name, shape in {"one": (1,), "channels": (8, 1, 1), "four": (1, 8, 1, 1), "scalar": ()}.items():
        case(f"PRelu_{name}", lambda g, s=shape: g.op("PRelu", [g.stem(), g.normal(*s)]))
        case(f"PRelu_9_{name}", lambda g, s=shape: g.op("PRelu", [g.stem(), g.normal(*s)]), 9)
    case("Sqrt", lambda g: g.op("Sqrt", [g.op("Abs", [g.stem()])]))
    case("Log", lambda g: g.op("Log", [g.op("Add", [g.op("Abs", [g.stem()]), g.scalar(0.1)])]))
    for power in (2.0, 0.5, 3.0, -1.0):
        case(f"Pow_{power}", lambda g, p=power: g.op("Pow", [g.op("Add", [g.op("Abs", [g.stem()]), g.scalar(0.1)]), g.scalar(p)]))
    case("Pow_of_negative", lambda g: g.op("Pow", [g.stem(), g.scalar(2)]))
    case("Pow_of_integer", lambda g: g.op("Pow", [g.stem(), g.const(3, np.int64)]))
    case("Dropout_13", lambda g: g.op("Dropout", [g.stem(), g.scalar(0.5)]), 13)
    case("Dropout_13_training_false", lambda g: g.op("Dropout", [g.stem(), g.scalar(0.5), g.const(False)]), 13)


def last(g: Graph, build: Callable[[str], str]) -> str:
    """What `build` makes of the stem with its channels last, turned back."""
    turned = g.op("Transpose", [g.stem()], perm=[0, 2, 3, 1])
    return g.op("Transpose", [build(turned)], perm=[0, 3, 1, 2])


def normalisations() -> None:
    def batch(g: Graph, **at: Any) -> str:
        random = g.random
        scale, variance = random.uniform(0.5, 1.5, 8), random.uniform(0.3, 2, 8)
        inputs = [g.stem(), g.const(scale, F32), g.normal(8), g.normal(8), g.const(variance, F32)]
        return g.op("BatchNormalization", inputs, **at)

    for opset, at in [(7, {}), (9, {"epsilon": 1e-3, "momentum": 0.01}), (15, {"epsilon": 1e-5}), (15, {"epsilon": 0.1}), (15, {"training_mode": 0})]:
        case(f"BatchNormalization_{opset}_{at}", lambda g, a=at: batch(g, **a), opset)

    def trained(g: Graph) -> str:
        inputs = [g.stem(), g.const(np.ones(8, F32)), *(g.const(np.zeros(8, F32)) for _ in range(2)), g.const(np.ones(8, F32))]
        return g.op("BatchNormalization", inputs, 3, training_mode=1)[0]

    case("BatchNormalization_15_training", trained, 15)
    for opset, at in [(7, {}), (17, {"epsilon": 1e-3}), (22, {})]:
        case(f"InstanceNormalization_{opset}_{at}", lambda g, a=at: g.op("InstanceNormalization", [g.stem(), g.normal(8), g.normal(8)], **a), opset)
    for opset, groups, count in [(18, 4, 4), (18, 1, 1), (18, 8, 8), (21, 4, 8), (21, 1, 8), (23, 2, 8)]:
        case(
            f"GroupNormalization_{opset}_{groups}",
            lambda g, n=groups, c=count: g.op("GroupNormalization", [g.stem(), g.normal(c), g.normal(c)], num_groups=n, epsilon=1e-4),
            opset,
        )

    def grouped(g: Graph) -> str:
        s = g.stem()
        flat = g.op("Reshape", [s, g.ints(0, 4, -1)])
        normed = g.op("InstanceNormalization", [flat, g.const(np.ones(4, F32)), g.const(np.zeros(4, F32))], epsilon=1e-5)
        back = g.op("Reshape", [normed, g.op("Shape", [s])])
        return g.op("Add", [g.op("Mul", [back, g.normal(8, 1, 1)]), g.normal(8, 1, 1)])

    case("GroupNormalization_of_parts", grouped, 13)
    case("LayerNormalization_last", lambda g: last(g, lambda v: g.op("LayerNormalization", [v, g.normal(8), g.normal(8)], axis=-1, epsilon=1e-6)))
    case("LayerNormalization_no_bias", lambda g: last(g, lambda v: g.op("LayerNormalization", [v, g.normal(8)])))
    case("LayerNormalization_axis_1", lambda g: g.op("LayerNormalization", [g.stem(), g.normal(8, g.height, g.width), g.normal(8, g.height, g.width)], axis=1))
    case("LayerNormalization_axis_2", lambda g: g.op("LayerNormalization", [g.stem(), g.normal(g.height, g.width)], axis=2))
    case("LayerNormalization_outputs", lambda g: g.op("LayerNormalization", [g.stem(), g.normal(g.width)], 3)[0])
    case("RMSNormalization", lambda g: last(g, lambda v: g.op("RMSNormalization", [v, g.normal(8)], axis=-1)), 23)
    case("RMSNormalization_axis_2", lambda g: g.op("RMSNormalization", [g.stem(), g.normal(g.height, g.width)], axis=2, epsilon=1e-3), 23)
    kinds = ["L1", "L2", "LogSum", "LogSumExp", "Max", "Mean", "Min", "Prod", "Sum", "SumSquare"]
    for kind, (name, axes) in product(kinds, {"channels": [1], "sides": [2, 3], "width": [-1]}.items()):
        def reduced(g: Graph, k: str, a: list[int], new: bool) -> str:
            s = g.op("Add", [g.op("Abs", [g.stem()]), g.scalar(0.5)]) if k in ("LogSum", "Prod") else g.stem()
            if k == "Prod":
                s = g.op("Mul", [s, g.scalar(0.3)])
            inputs = [s, g.ints(*a)] if new else [s]
            at = {} if new else {"axes": a}
            return g.op("Mul", [s, g.op(f"Reduce{k}", inputs, keepdims=1, **at)])

        case(f"Reduce{kind}_11_{name}", lambda g, k=kind, a=axes: reduced(g, k, a, k == "Sum" and g.opset >= 13), 11)
        case(f"Reduce{kind}_18_{name}", lambda g, k=kind, a=axes: reduced(g, k, a, True), 18)
    for kind in ("Mean", "Max", "Sum"):
        case(f"Reduce{kind}_no_keepdims", lambda g, k=kind: (s := g.stem(), g.op("Add", [s, g.op(f"Reduce{k}", [s, g.ints(1, 2, 3)], keepdims=0)]))[1], 18)
        case(f"Reduce{kind}_all", lambda g, k=kind: (s := g.stem(), g.op("Add", [s, g.op(f"Reduce{k}", [s])]))[1], 18)
        case(f"Reduce{kind}_noop", lambda g, k=kind: (s := g.stem(), g.op("Add", [s, g.op(f"Reduce{k}", [s], noop_with_empty_axes=1)]))[1], 18)
    for kind, at in product(("ArgMax", "ArgMin"), ({"axis": 1}, {"axis": 1, "keepdims": 0}, {"axis": -1}, {"axis": 1, "select_last_index": 1})):
        def chosen(g: Graph, k: str = kind, a: dict[str, int] = at) -> str:
            s = g.op("Round", [g.stem()])
            index = g.op(k, [s], **a)
            if a.get("keepdims") == 0:
                index = g.op("Unsqueeze", [index, g.ints(1)])
            return g.op("Mul", [s, g.op("Cast", [index], to=TensorProto.FLOAT)])

        case(f"{kind}_{at}", chosen)


def shapes() -> None:
    def concat_of(g: Graph, parts: Any) -> str:
        return g.op("Concat", list(reversed(parts)), axis=1)

    case("Split_sizes_13", lambda g: concat_of(g, g.op("Split", [g.stem(), g.ints(3, 5)], 2, axis=1)), 13)
    case("Split_equal_13", lambda g: concat_of(g, g.op("Split", [g.stem()], 4, axis=1)), 13)
    case("Split_attribute_11", lambda g: concat_of(g, g.op("Split", [g.stem()], 2, axis=1, split=[3, 5])), 11)
    case("Split_equal_11", lambda g: concat_of(g, g.op("Split", [g.stem()], 2, axis=1)), 11)
    case("Split_number_18", lambda g: concat_of(g, g.op("Split", [g.stem()], 2, axis=1, num_outputs=2)), 18)
    case("Split_number_uneven_18", lambda g: concat_of(g, g.op("Split", [g.stem(7)], 3, axis=1, num_outputs=3)), 18)
    case("Split_negative_axis_18", lambda g: concat_of(g, g.op("Split", [g.stem(), g.ints(3, 5)], 2, axis=-3)), 18)

    def focus(g: Graph) -> str:
        steps, axes, ends = g.ints(2, 2), g.ints(2, 3), g.ints(2**31 - 1, 2**31 - 1)
        parts = [g.op("Slice", ["x", g.ints(a, b), ends, axes, steps]) for a, b in [(0, 0), (1, 0), (0, 1), (1, 1)]]
        return g.op("Conv", [g.op("Concat", parts, axis=1), g.normal(6, 12, 3, 3)], pads=[1] * 4)

    case("Slice_focus", focus, 13, SIZES[2:])
    slices = {
        "negative_step": (-1, -(2**31), 3, -1), "negative_step_2": (-1, -(2**63), 2, -2), "negative_start": (-20, 2**63 - 1, 3, 1),
        "negative_end": (3, -2, 2, 1), "step_3": (1, 1000, 3, 3), "backwards": (15, 4, 3, -3), "before_start": (-1000, 9, 3, 1), "negative_axis": (1, 5, -3, 2),
    }
    for name, (start, end, axis, step) in slices.items():
        case(f"Slice_{name}", lambda g, v=(start, end, axis, step): g.op("Slice", [g.stem(), *(g.ints(i) for i in v)]), 13)
    case("Slice_attributes_9", lambda g: g.op("Slice", [g.stem()], axes=[2, 3], starts=[1, -20], ends=[-1, 2**31 - 1]), 9)
    case("Slice_attributes_beyond_9", lambda g: g.op("Slice", [g.stem()], axes=[2], starts=[-1000], ends=[20]), 9)
    case("Slice_no_axes", lambda g: g.op("Slice", [g.stem(), g.ints(0, 1), g.ints(1, 4)]), 13)
    case("Slice_int32", lambda g: g.op("Slice", [g.stem(), g.const([1], np.int32), g.const([9], np.int32), g.const([2], np.int32)]), 13)
    case("roll", lambda g: (s := g.stem(), g.op("Concat", [g.op("Slice", [s, g.ints(3), g.ints(2**40), g.ints(2)]), g.op("Slice", [s, g.ints(0), g.ints(3), g.ints(2)])], axis=2))[1], 13)
    for opset, mode in product((11, 13), ("DCR", "CRD", None)):
        case(f"DepthToSpace_{opset}_{mode}", lambda g, m=mode: g.op("DepthToSpace", [g.stem(16)], blocksize=2, **({"mode": m} if m else {})), opset)
    case("DepthToSpace_3", lambda g: g.op("DepthToSpace", [g.stem(18)], blocksize=3, mode="CRD"), 13)
    for block in (2, 4):
        case(f"SpaceToDepth_{block}", lambda g, b=block: g.op("SpaceToDepth", [g.stem()], blocksize=b), 13, SIZES[2:])

    def shuffle(g: Graph) -> str:
        parts = g.op("Reshape", [g.stem(), g.ints(1, 2, 4, g.height, g.width)])
        return g.op("Reshape", [g.op("Transpose", [parts], perm=[0, 2, 1, 3, 4]), g.ints(1, -1, g.height, g.width)])

    case("channel_shuffle", shuffle, 13)
    case("Reshape_zero", lambda g: g.op("Reshape", [g.stem(), g.ints(0, 4, -1, g.width)]), 13)
    case("Reshape_zeros", lambda g: g.op("Reshape", [g.op("Reshape", [g.stem(), g.ints(0, 0, -1)]), g.ints(0, 0, g.height, g.width)]), 7)
    case("Reshape_allowzero", lambda g: g.op("Reshape", [g.stem(), g.ints(1, 4, -1, g.width)], allowzero=1), 14)
    case("Flatten_2", lambda g: g.op("Reshape", [g.op("Flatten", [g.stem()], axis=2), g.ints(1, 8, g.height, g.width)]), 13)
    case("Flatten_negative", lambda g: g.op("Reshape", [g.op("Flatten", [g.stem()], axis=-1), g.ints(1, 8, g.height, g.width)]), 13)
    case("Transpose_default", lambda g: g.op("Transpose", [g.op("Transpose", [g.stem()])]), 13)
    case("Transpose_sides", lambda g: g.op("Transpose", [g.stem()], perm=[0, 1, 3, 2]), 13)
    paddings = {"plain": [0, 0, 2, 3, 0, 0, 1, 4], "none": [0] * 8, "negative": [0, 0, -2, -3, 0, 0, -1, 0], "mixed": [0, 0, 2, -3, 0, 0, -1, 4], "channels": [0, 1, 0, 0, 0, 2, 0, 0]}
    for opset, mode, (name, pads) in product((11, 18, 19, 23), ("constant", "reflect", "edge", "wrap"), paddings.items()):
        if mode == "wrap" and opset < 19:
            continue
        case(f"Pad_{opset}_{mode}_{name}", lambda g, m=mode, p=pads: g.op("Pad", [g.stem(), g.ints(*p)], mode=m), opset)
    case("Pad_13_value", lambda g: g.op("Pad", [g.stem(), g.ints(0, 0, 2, 3, 0, 0, 1, 4), g.scalar(0.7)]), 13)
    case("Pad_18_axes", lambda g: g.op("Pad", [g.stem(), g.ints(1, 2, 3, 4), "", g.ints(2, 3)], mode="constant"), 18)
    case("Pad_18_axes_turned", lambda g: g.op("Pad", [g.stem(), g.ints(1, 2, 3, 4), g.scalar(0.2), g.ints(-1, 2)], mode="constant"), 18)
    for mode in ("constant", "reflect", "edge"):
        case(f"Pad_2_{mode}", lambda g, m=mode: g.op("Pad", [g.stem()], pads=[0, 0, 2, 3, 0, 0, 1, 4], mode=m, **({"value": 0.3} if m == "constant" else {})), 9)
    case("Pad_2_negative", lambda g: g.op("Pad", [g.stem()], pads=[0, 0, -2, 3, 0, 0, -1, 0]), 9)
    case("Pad_then_Conv", lambda g: g.op("Conv", [g.op("Pad", [g.stem(), g.ints(0, 0, 0, 0, 0, 0, 1, 1)]), g.normal(6, 8, 3, 3)], strides=[2, 2]), 13)
    case("Pad_value_then_Conv", lambda g: g.op("Conv", [g.op("Pad", [g.stem(), g.ints(0, 0, 1, 1, 0, 0, 1, 1), g.scalar(1)]), g.normal(6, 8, 3, 3)]), 13)
    case("Pad_then_MaxPool", lambda g: g.op("MaxPool", [g.op("Pad", [g.stem(), g.ints(0, 0, 1, 1, 0, 0, 1, 1)])], kernel_shape=[3, 3], strides=[2, 2]), 13)
    case("Pad_then_AveragePool", lambda g: g.op("AveragePool", [g.op("Pad", [g.stem(), g.ints(0, 0, 1, 1, 0, 0, 1, 1)])], kernel_shape=[3, 3], strides=[2, 2]), 13)
    case("Expand", lambda g: g.op("Concat", [g.stem(), g.op("Expand", [g.const(np.linspace(-1, 1, g.width, dtype=F32).reshape(1, 1, 1, -1)), g.ints(1, 1, g.height, g.width)])], axis=1))
    case("Where", lambda g: (s := g.stem(), g.op("Where", [g.op("Greater", [s, g.scalar(0)]), s, g.op("Mul", [s, g.scalar(0.1)])]))[1])
    for kind in ("Less", "LessOrEqual", "GreaterOrEqual", "Equal", "Greater"):
        case(f"{kind}_cast", lambda g, k=kind: (s := g.op("Round", [g.stem()]), g.op("Add", [s, g.op("Cast", [g.op(k, [s, g.scalar(0)])], to=TensorProto.FLOAT)]))[1])
    for kind in ("And", "Or", "Xor"):
        case(f"{kind}_masks", lambda g, k=kind: (s := g.stem(), g.op("Where", [g.op(k, [g.op("Greater", [s, g.scalar(0)]), g.op("Less", [s, g.scalar(1)])]), s, g.scalar(0)]))[1])
    case("Not_mask", lambda g: (s := g.stem(), g.op("Where", [g.op("Not", [g.op("Greater", [s, g.scalar(0)])]), s, g.scalar(0)]))[1])
    case("Gather", lambda g: g.op("Gather", [g.stem(), g.ints(7, 0, 3, -2)], axis=1), 13)
    case("Gather_rows", lambda g: g.op("Gather", [g.stem(), g.ints(1, 3, 5, 20)], axis=2), 13)
    case("GatherElements", lambda g: g.op("GatherElements", [g.stem(), g.const(np.tile(np.array([2, -1, 0]).reshape(1, 3, 1, 1), (1, 1, g.height, g.width)))], axis=1), 13)
    case("GatherND", lambda g: g.op("Unsqueeze", [g.op("GatherND", [g.stem(), g.const([[0, 1], [0, 5]], np.int64)]), g.ints(0)]), 13)
    case("ScatterND", lambda g: g.op("ScatterND", [g.stem(), g.const([[0, 1], [0, 5]], np.int64), g.normal(2, g.height, g.width)]), 16)
    for reduction in (None, "add", "mul", "max", "min"):
        at = {"reduction": reduction} if reduction else {}
        case(f"ScatterElements_{reduction}", lambda g, a=at: g.op("ScatterElements", [g.stem(), g.const(np.full((1, 1, g.height, g.width), 3), np.int64), g.normal(1, 1, g.height, g.width)], axis=1, **a), 18)
        case(f"ScatterND_{reduction}", lambda g, a=at: g.op("ScatterND", [g.stem(), g.const([[0, 1], [0, 5]], np.int64), g.normal(2, g.height, g.width)], **a), 18)
    case("GatherND_batch", lambda g: g.op("Unsqueeze", [g.op("GatherND", [g.stem(), g.const([[3]], np.int64)], batch_dims=1), g.ints(1)]), 13)
    case("Tile", lambda g: g.op("Tile", [g.stem(), g.ints(1, 2, 1, 3)]), 13)
    case("Squeeze_Unsqueeze_13", lambda g: g.op("Unsqueeze", [g.op("Squeeze", [g.stem(), g.ints(0)]), g.ints(-4)]), 13)
    case("Squeeze_Unsqueeze_11", lambda g: g.op("Unsqueeze", [g.op("Squeeze", [g.stem()], axes=[0])], axes=[0]), 11)
    case("Squeeze_all", lambda g: g.op("Unsqueeze", [g.op("Squeeze", [g.stem()]), g.ints(0)]), 13)
    case("Concat_negative", lambda g: (s := g.stem(), g.op("Concat", [s, g.op("Relu", [s])], axis=-3))[1], 13)
    case("Concat_rows", lambda g: (s := g.stem(), g.op("Concat", [s, g.op("Relu", [s])], axis=2))[1], 13)
    case("Concat_with_constant", lambda g: g.op("Concat", [g.stem(), g.normal(1, 2, g.height, g.width)], axis=1), 13)
    case("CumSum", lambda g: g.op("CumSum", [g.stem(), g.const(1, np.int64)]), 14)
    for at in ({"exclusive": 1}, {"reverse": 1}, {"exclusive": 1, "reverse": 1}):
        case(f"CumSum_{at}", lambda g, a=at: g.op("CumSum", [g.stem(), g.const(1, np.int64)], **a), 14)
    case("Trilu", lambda g: g.op("Trilu", [g.stem()], upper=0), 14)
    case("Trilu_upper", lambda g: g.op("Trilu", [g.stem(), g.const(2, np.int64)]), 14)
    case("TopK", lambda g: g.op("TopK", [g.stem(), g.ints(3)], 2, axis=1)[0], 13)
    case("TopK_smallest", lambda g: g.op("TopK", [g.stem(), g.ints(3)], 2, axis=1, largest=0)[0], 13)
    case("ReverseSequence", lambda g: g.op("ReverseSequence", [g.stem(), g.ints(4)], batch_axis=0, time_axis=1), 13)
    case("CenterCropPad", lambda g: g.op("CenterCropPad", [g.stem(), g.ints(20, 60)], axes=[2, 3]), 18)
    case("OneHot", lambda g: (s := g.stem(), g.op("Squeeze", [g.op("OneHot", [g.op("ArgMax", [s], axis=1, keepdims=1), g.ints(8), g.const([0.0, 1.0], F32)], axis=1), g.ints(2)]))[1], 13)
    case("NonZero", lambda g: (s := g.stem(), g.op("Mul", [s, g.op("Cast", [g.op("ReduceMax", [g.op("NonZero", [g.op("Relu", [s])])], keepdims=0)], to=TensorProto.FLOAT)]))[1], 13)
    for at in ({}, {"start": 2}, {"start": -2, "end": -1}, {"end": 2}):
        case(f"Shape_{at}", lambda g, a=at: (s := g.stem(), g.op("Mul", [s, g.op("Cast", [g.op("ReduceProd", [g.op("Shape", [s], **a)], keepdims=0)], to=TensorProto.FLOAT)]))[1], 15)
    case("Size", lambda g: (s := g.stem(), g.op("Div", [s, g.op("Cast", [g.op("Size", [s])], to=TensorProto.FLOAT)]))[1])

    def counted(g: Graph) -> str:
        s = g.stem()
        width = g.op("Gather", [g.op("Shape", [s]), g.const(3, np.int64)])
        row = g.op("Cast", [g.op("Range", [g.const(0, np.int64), width, g.const(1, np.int64)])], to=TensorProto.FLOAT)
        return g.op("Add", [s, g.op("Div", [row, g.scalar(10)])])

    case("Range_of_Shape", counted)
    case("ConstantOfShape", lambda g: (s := g.stem(), g.op("Add", [s, g.op("ConstantOfShape", [g.op("Shape", [s])], value=numpy_helper.from_array(np.array([0.3], F32)))]))[1])
    case("EyeLike", lambda g: g.op("Add", [g.stem(), g.op("EyeLike", [g.const(np.zeros((g.height, g.width), F32))])]))
    # Whole numbers: quotients and remainders of negative numbers, and casts.
    for kind, at in (("Div", {}), ("Mod", {}), ("Mod", {"fmod": 1})):
        for a, b in ((-7, 2), (7, -2), (7, 2)):
            case(f"{kind}_whole_{a}_{b}_{at}", lambda g, k=kind, v=(a, b), t=at: g.op("Add", [g.stem(), g.op("Cast", [g.op(k, [g.const(v[0], np.int64), g.const(v[1], np.int64)], **t)], to=TensorProto.FLOAT)]))
    case("Mod_floats", lambda g: g.op("Mod", [g.stem(), g.scalar(0.7)], fmod=1), 13)
    for kind in (TensorProto.INT32, TensorProto.INT64, TensorProto.UINT8, TensorProto.INT8, TensorProto.BOOL, TensorProto.DOUBLE):
        def through(g: Graph, k: int = kind) -> str:
            s = g.op("Clip", [g.op("Mul", [g.stem(), g.scalar(9)]), g.scalar(0 if k == TensorProto.UINT8 else -90), g.scalar(90)])
            return g.op("Cast", [g.op("Cast", [s], to=k)], to=TensorProto.FLOAT)

        case(f"Cast_{kind}", through, 13)
    case("CastLike", lambda g: g.op("CastLike", [g.stem(), g.scalar(1)]), 15)


def sums() -> None:
    for kind in ("Add", "Sub", "Mul", "Div"):
        shapes = {"scalar": (), "one": (1,), "channels": (8, 1, 1), "four": (1, 8, 1, 1), "row": (-1,), "pixels": (1, 1, -2, -1), "all": (8, -2, -1), "column": (-2, 1)}
        for (name, shape), first in product(shapes.items(), (False, True)):
            def built(g: Graph, k: str = kind, s: Any = shape, f: bool = first) -> str:
                sides = {-1: g.width, -2: g.height}
                shape = [sides.get(n, n) for n in s]
                constant = g.const(np.abs(g.random.normal(0, 0.4, shape)) + 0.5, F32)
                value = g.stem()
                if k == "Div" and f:
                    value = g.op("Add", [g.op("Abs", [value]), g.scalar(0.5)])
                return g.op(k, [constant, value] if f else [value, constant])

            case(f"{kind}_{name}_{'first' if first else 'second'}", built, 13)
        case(f"{kind}_same", lambda g, k=kind: (s := g.op("Add", [g.op("Abs", [g.stem()]), g.scalar(0.5)]), g.op(k, [s, s]))[1], 13)
        case(f"{kind}_map", lambda g, k=kind: (s := g.stem(), g.op(k, [s, g.op("GlobalAveragePool", [s])]))[1], 13)
    for opset in (6, 9):
        case(f"Add_{opset}", lambda g: g.op("Add", [g.stem(), g.normal(8, 1, 1)]) if g.opset >= 7 else g.op("Add", [g.stem(), g.normal(8)], axis=1, broadcast=1), opset)
    for kind in ("Sum", "Mean", "Max", "Min"):
        case(f"{kind}_three", lambda g, k=kind: (s := g.stem(), g.op(k, [s, g.op("Relu", [s]), g.op("Neg", [s])]))[1], 13)
        case(f"{kind}_one", lambda g, k=kind: g.op(k, [g.stem()]), 13)
        case(f"{kind}_broadcast", lambda g, k=kind: g.op(k, [g.stem(), g.normal(8, 1, 1), g.scalar(0.1)]), 13)
    case("eight_columns", lambda g: g.op("Mul", [g.op("Slice", [g.stem(), g.ints(0), g.ints(8), g.ints(3)]), g.normal(8)]), 13)
    case("residual", lambda g: (s := g.stem(), g.op("Relu", [g.op("Add", [g.op("Conv", [g.op("Relu", [s]), g.normal(8, 8, 3, 3)], pads=[1] * 4), s])]))[1], 13)
    for a, b in product((0, 1), (0, 1)):
        def gemm(g: Graph, ta: int = a, tb: int = b) -> str:
            s = g.stem()
            mean = g.op("Flatten", [g.op("GlobalAveragePool", [s])])
            if ta:
                mean = g.op("Transpose", [mean])
            gate = g.op("Gemm", [mean, g.normal(8, 8), g.normal(8)], transA=ta, transB=tb, alpha=0.7, beta=1.3)
            return g.op("Mul", [g.op("Reshape", [gate, g.ints(1, 8, 1, 1)]), s])

        case(f"Gemm_{a}_{b}", gemm, 13)
    case("Gemm_no_bias", lambda g: (s := g.stem(), g.op("Mul", [s, g.op("Reshape", [g.op("Gemm", [g.op("Flatten", [g.op("GlobalAveragePool", [s])]), g.normal(8, 8)]), g.ints(1, 8, 1, 1)])]))[1], 13)

    def attention(g: Graph) -> str:
        s = g.op("MaxPool", [g.stem()], kernel_shape=[4, 4], strides=[4, 4])
        height, width = g.height // 4, g.width // 4
        flat = g.op("Reshape", [s, g.ints(1, 8, height * width)])
        weights = g.op("Softmax", [g.op("MatMul", [g.op("Transpose", [flat], perm=[0, 2, 1]), flat])], axis=-1)
        return g.op("Reshape", [g.op("MatMul", [flat, g.op("Transpose", [weights], perm=[0, 2, 1])]), g.ints(1, 8, height, width)])

    case("attention_of_parts", attention, 13)
    case("MatMul_constant", lambda g: g.op("MatMul", [g.stem(), g.normal(g.width, 20)]), 13)
    case("MatMul_broadcast", lambda g: g.op("MatMul", [g.normal(1, 8, 12, g.height), g.stem()]), 13)
    for equation, shape in {"nchw,dc->ndhw": (5, 8), "nchw,c->nchw": (8,), "nchw,cd->ndhw": (8, 4), "nchw,ncHW->nchw": None, "bchw, dc -> bdhw": (5, 8)}.items():
        if shape:
            case(f"Einsum_{equation}", lambda g, e=equation, s=shape: g.op("Einsum", [g.stem(), g.normal(*s)], equation=e), 13)
    case("Einsum_turned", lambda g: g.op("Einsum", [g.stem()], equation="nchw->ncwh"), 13)
    case("Einsum_dots", lambda g: g.op("Einsum", [g.stem(), g.normal(g.width, 10)], equation="...w,wk->...k"), 13)

    def excited(g: Graph) -> str:
        s = g.stem()
        mean = g.op("ReduceMean", [s, g.ints(2, 3)], keepdims=1)
        gate = g.op("Sigmoid", [g.op("Conv", [g.op("Relu", [g.op("Conv", [mean, g.normal(4, 8, 1, 1)])]), g.normal(8, 4, 1, 1)])])
        return g.op("Mul", [s, gate])

    case("squeeze_and_excitation", excited, 18)

    def channels_in_line(g: Graph) -> str:
        s = g.stem()
        line = g.op("Transpose", [g.op("Squeeze", [g.op("GlobalAveragePool", [s]), g.ints(3)])], perm=[0, 2, 1])
        gate = g.op("Transpose", [g.op("Conv", [line, g.normal(1, 1, 3)], pads=[1, 1])], perm=[0, 2, 1])
        return g.op("Mul", [s, g.op("Sigmoid", [g.op("Unsqueeze", [gate, g.ints(3)])])])

    case("convolution_of_one_dimension", channels_in_line, 13)
    for mode, align, padding in product(("bilinear", "nearest", "bicubic"), (0, 1), ("zeros", "border", "reflection")):
        def sampled(g: Graph, m: str = mode, a: int = align, p: str = padding) -> str:
            ys, xs = np.meshgrid(np.linspace(-1.2, 1.2, 30), np.linspace(-1.1, 1.1, 40), indexing="ij")
            grid = np.stack([xs, ys], -1)[None].astype(F32)
            return g.op("GridSample", [g.stem(), g.const(grid)], mode=m, align_corners=a, padding_mode=p)

        case(f"GridSample_{mode}_{align}_{padding}", sampled, 16)
    for mode in ("linear", "nearest", "cubic"):
        case(f"GridSample_20_{mode}", lambda g, m=mode: g.op("GridSample", [g.stem(), g.const(g.random.uniform(-1, 1, (1, 20, 30, 2)), F32)], mode=m), 20)
    case("DeformConv", lambda g: (s := g.stem(), g.op("DeformConv", [s, g.normal(6, 8, 3, 3), g.op("Conv", [s, g.normal(18, 8, 3, 3, deviation=0.05)], pads=[1] * 4)], pads=[1] * 4, kernel_shape=[3, 3]))[1], 19)


def quantised() -> None:
    def rounded(g: Graph, value: str, scale: float, kind: Any, zero: int, **at: Any) -> str:
        inputs = [g.const(F32(scale)), g.const(zero, kind)]
        return g.op("DequantizeLinear", [g.op("QuantizeLinear", [value, *inputs], **at), *inputs], **at)

    for opset, kind, zero in ((13, np.uint8, 128), (13, np.int8, 0), (19, np.int8, 3), (21, np.uint8, 100), (10, np.uint8, 128)):
        case(f"QuantizeLinear_{opset}_{np.dtype(kind)}_{zero}", lambda g, k=kind, z=zero: rounded(g, g.stem(), 0.03, k, z), opset)

    def by_channel(g: Graph) -> str:
        weights = g.const(np.round(g.random.normal(0, 40, (8, 3, 3, 3))).clip(-127, 127), np.int8)
        scales = g.const(g.random.uniform(0.005, 0.02, 8), F32)
        real = g.op("DequantizeLinear", [weights, scales, g.const(np.zeros(8), np.int8)], axis=0)
        return g.op("Conv", [rounded(g, "x", 1 / 40, np.int8, 0), real, g.normal(8)], pads=[1] * 4)

    case("DequantizeLinear_by_channel", by_channel, 13)

    def blocked(g: Graph) -> str:
        weights = g.const(np.round(g.random.normal(0, 40, (8, 8, 1, 1))).clip(-127, 127), np.int8)
        real = g.op("DequantizeLinear", [weights, g.const(g.random.uniform(0.005, 0.02, (8, 2, 1, 1)), F32)], axis=1, block_size=4)
        return g.op("Conv", [g.stem(), real])

    case("DequantizeLinear_blocked", blocked, 21)

    def whole(g: Graph) -> str:
        scale, zero = g.const(F32(1 / 40)), g.const(128, np.uint8)
        weights = g.const(np.round(g.random.normal(0, 40, (8, 3, 3, 3))).clip(-127, 127), np.int8)
        value = g.op("QLinearConv", [g.op("QuantizeLinear", ["x", scale, zero]), scale, zero, weights, g.const(np.full(8, 0.01), F32), g.const(np.zeros(8), np.int8), g.const(F32(0.08)), g.const(100, np.uint8)], pads=[1] * 4)
        return g.op("DequantizeLinear", [value, g.const(F32(0.08)), g.const(100, np.uint8)])

    case("QLinearConv", whole, 13)

    def dynamic(g: Graph) -> str:
        value, scale, zero = g.op("DynamicQuantizeLinear", ["x"], 3)
        weights = g.const(np.round(g.random.normal(0, 40, (8, 3, 3, 3))).clip(-127, 127), np.int8)
        sums = g.op("ConvInteger", [value, weights, zero, g.const(0, np.int8)], pads=[1] * 4)
        return g.op("Mul", [g.op("Cast", [sums], to=TensorProto.FLOAT), g.op("Mul", [scale, g.const(F32(0.01))])])

    case("ConvInteger", dynamic, 13)

    def multiplied(g: Graph) -> str:
        value, scale, zero = g.op("DynamicQuantizeLinear", ["x"], 3)
        weights = g.const(np.round(g.random.normal(0, 40, (g.width, 24))).clip(-127, 127), np.int8)
        sums = g.op("MatMulInteger", [value, weights, zero, g.const(0, np.int8)])
        return g.op("Mul", [g.op("Cast", [sums], to=TensorProto.FLOAT), g.op("Mul", [scale, g.const(F32(0.01))])])

    case("MatMulInteger", multiplied, 13)


def habits() -> None:
    """Habits of exporters."""
    def branch(g: Graph, decided: bool) -> str:
        s = g.stem()
        value = [helper.make_tensor_value_info(n, TensorProto.FLOAT, None) for n in ("t", "e")]
        then = helper.make_graph([helper.make_node("Relu", [s], ["t"])], "then", [], value[:1])
        other = helper.make_graph([helper.make_node("Neg", [s], ["e"])], "else", [], value[1:])
        if decided:
            condition = g.const(True)
        else:
            condition = g.op("Greater", [g.op("ReduceMean", [s], keepdims=0), g.scalar(-100)])
        return g.op("If", [condition], then_branch=then, else_branch=other)

    case("If_constant", lambda g: branch(g, True), 13)
    case("If_of_values", lambda g: branch(g, False), 13)

    def function(g: Graph) -> str:
        body = [helper.make_node("Sigmoid", ["a"], ["q"]), helper.make_node("Mul", ["a", "q"], ["b"])]
        g.functions = [helper.make_function("pkg.torch", "silu", ["a"], ["b"], body, [helper.make_opsetid("", 18)])]
        g.domains = [helper.make_opsetid("pkg.torch", 1)]
        return g.op("silu", [g.stem()], domain="pkg.torch")

    case("function", function, 18)

    def nested(g: Graph) -> str:
        inner = helper.make_function("pkg", "twice", ["a"], ["b"], [helper.make_node("Add", ["a", "a"], ["b"])], [helper.make_opsetid("", 18)])
        body = [helper.make_node("twice", ["p"], ["q"], domain="pkg"), helper.make_node("Sub", ["q", "r"], ["s"])]
        imports = [helper.make_opsetid("", 18), helper.make_opsetid("pkg", 1)]
        g.functions = [inner, helper.make_function("pkg", "twice_less", ["p", "r"], ["s"], body, imports)]
        g.domains = [helper.make_opsetid("pkg", 1)]
        s = g.stem()
        return g.op("twice_less", [g.op("twice_less", [s, g.scalar(0.5)], domain="pkg"), s], domain="pkg")

    case("function_in_a_function", nested, 18)

    def own_value(g: Graph) -> str:
        node = helper.make_node("LeakyRelu", ["a"], ["b"])
        node.attribute.append(onnx.AttributeProto(name="alpha", ref_attr_name="slope", type=onnx.AttributeProto.FLOAT))
        made = helper.make_function("pkg", "leaky", ["a"], ["b"], [node], [helper.make_opsetid("", 18)], [], [helper.make_attribute("slope", 0.7)])
        g.functions, g.domains = [made], [helper.make_opsetid("pkg", 1)]
        return g.op("leaky", [g.stem()], domain="pkg")

    case("function_with_a_value_of_its_own", own_value, 18)

    def function_with_attribute(g: Graph) -> str:
        node = helper.make_node("LeakyRelu", ["a"], ["b"])
        node.attribute.append(onnx.AttributeProto(name="alpha", ref_attr_name="slope", type=onnx.AttributeProto.FLOAT))
        made = helper.make_function("pkg.own", "leaky", ["a"], ["b"], [node], [helper.make_opsetid("", 18)], ["slope"])
        g.functions, g.domains = [made], [helper.make_opsetid("pkg.own", 1)]
        return g.op("leaky", [g.op("leaky", [g.stem()], domain="pkg.own", slope=0.3)], domain="pkg.own", slope=1.5)

    case("function_with_attribute", function_with_attribute, 18)

    def function_named_like_an_operator(g: Graph) -> str:
        made = helper.make_function("pkg.own", "Relu", ["a"], ["b"], [helper.make_node("Neg", ["a"], ["b"])], [helper.make_opsetid("", 18)])
        g.functions, g.domains = [made], [helper.make_opsetid("pkg.own", 1)]
        return g.op("Relu", [g.stem()], domain="pkg.own")

    case("function_named_like_an_operator", function_named_like_an_operator, 18)

    def contributed(g: Graph) -> str:
        g.domains = [helper.make_opsetid("com.microsoft", 1)]
        return g.op("Gelu", [g.stem()], domain="com.microsoft")

    case("com.microsoft_Gelu", contributed, 17)

    def fused(g: Graph) -> str:
        g.domains = [helper.make_opsetid("com.microsoft", 1)]
        return g.op("FusedConv", [g.stem(), g.normal(6, 8, 3, 3), g.normal(6)], domain="com.microsoft", activation="Relu", pads=[1] * 4)

    case("com.microsoft_FusedConv", fused, 17)
    case("Constant_weights", lambda g: g.op("Conv", ["x", g.op("Constant", [], value=numpy_helper.from_array(g.random.normal(0, 0.3, (8, 3, 3, 3)).astype(F32)))], pads=[1] * 4), 13)
    case("Constant_float", lambda g: g.op("Mul", [g.stem(), g.op("Constant", [], value_float=0.3)]), 13)
    case("Constant_ints", lambda g: g.op("Reshape", [g.stem(), g.op("Constant", [], value_ints=[1, 4, -1, g.width])]), 13)

    def data_in_fields(g: Graph) -> onnx.ModelProto:
        model = g.model(g.stem())
        for tensor in model.graph.initializer:
            values = numpy_helper.to_array(tensor)
            tensor.CopyFrom(helper.make_tensor(tensor.name, TensorProto.FLOAT, values.shape, values.ravel().tolist()))
        return model

    case("weights_in_fields", data_in_fields, 13)

    def sparse(g: Graph) -> onnx.ModelProto:
        s = g.stem()
        model = g.model(g.op("Conv", [s, "sparse"], pads=[0] * 4))
        values = helper.make_tensor("sparse", TensorProto.FLOAT, [3], [0.5, -1.0, 2.0])
        indices = helper.make_tensor("sparse_indices", TensorProto.INT64, [3], [0, 9, 30])
        model.graph.sparse_initializer.append(helper.make_sparse_tensor(values, indices, [6, 8, 1, 1]))
        return model

    case("sparse_weights", sparse, 13)

    def listed_inputs(g: Graph) -> onnx.ModelProto:
        model = g.model(g.op("Relu", [g.stem()]))
        for name, values in g.weights.items():
            kind = helper.np_dtype_to_tensor_dtype(values.dtype)
            model.graph.input.append(helper.make_tensor_value_info(name, kind, values.shape))
        model.ir_version = 3
        return model

    case("initializers_as_inputs", listed_inputs, 9)

    def channels_last(g: Graph) -> str:
        g.input_shape = [1, g.height, g.width, 3]
        return g.op("Conv", [g.op("Transpose", ["x"], perm=[0, 3, 1, 2]), g.normal(8, 3, 3, 3)], pads=[1] * 4)

    case("picture_with_channels_last", channels_last, 13)

    def half(g: Graph, kind: int, real: Any) -> onnx.ModelProto:
        g.input_type = kind
        conv = g.op("Conv", ["x", g.const(g.random.normal(0, 0.3, (8, 3, 3, 3)), real), g.const(g.random.normal(0, 0.3, 8), real)], pads=[1] * 4)
        return g.model(g.op("Relu", [conv]), kind)

    case("half_floats", lambda g: half(g, TensorProto.FLOAT16, np.float16), 13)
    case("double_floats", lambda g: half(g, TensorProto.DOUBLE, np.float64), 13)

    def half_inside(g: Graph) -> str:
        x = g.op("Cast", ["x"], to=TensorProto.FLOAT16)
        weights = g.const(g.random.normal(0, 0.3, (8, 3, 3, 3)), np.float16)
        conv = g.op("Conv", [x, weights], pads=[1] * 4)
        norm = g.op("InstanceNormalization", [conv, g.const(np.ones(8), np.float16), g.const(np.zeros(8), np.float16)])
        pool = g.op("MaxPool", [norm], kernel_shape=[2, 2], strides=[2, 2])
        wide = g.op("Resize", [pool, "", g.const([1, 1, 2, 2], F32)], mode="linear")
        return g.op("Cast", [wide], to=TensorProto.FLOAT)

    case("half_floats_inside", half_inside, 17)
    case("half_weights", lambda g: g.op("Conv", ["x", g.op("Cast", [g.const(g.random.normal(0, 0.3, (8, 3, 3, 3)), np.float16)], to=TensorProto.FLOAT)], pads=[1] * 4), 13)

    def bytes_in(g: Graph) -> str:
        g.input_type = TensorProto.UINT8
        return g.op("Conv", [g.op("Div", [g.op("Cast", ["x"], to=TensorProto.FLOAT), g.scalar(255)]), g.normal(8, 3, 3, 3)], pads=[1] * 4)

    case("bytes", bytes_in, 13)
    case("bytes_sub_first", lambda g: (setattr(g, "input_type", TensorProto.UINT8), g.op("Conv", [g.op("DequantizeLinear", ["x", g.scalar(0.02), g.const(114, np.uint8)]), g.normal(8, 3, 3, 3)], pads=[1] * 4))[1], 13)

    def bytes_last(g: Graph) -> str:
        g.input_type, g.input_shape = TensorProto.UINT8, [1, g.height, g.width, 3]
        x = g.op("Transpose", [g.op("Cast", ["x"], to=TensorProto.FLOAT)], perm=[0, 3, 1, 2])
        return g.op("Conv", [g.op("Mul", [x, g.scalar(1 / 255)]), g.normal(8, 3, 3, 3)], pads=[1] * 4)

    case("bytes_with_channels_last", bytes_last, 13)

    def sequence(g: Graph) -> str:
        parts = g.op("SplitToSequence", [g.stem(), g.const(4, np.int64)], axis=1)
        return g.op("SequenceAt", [parts, g.const(1, np.int64)])

    case("sequence", sequence, 13)
    for opset in range(7, 27):
        if opset <= 26:
            case(f"opset_{opset}", lambda g: g.op("MaxPool", [g.op("Relu", [g.stem()])], kernel_shape=[2, 2], strides=[2, 2]), opset)


def chains() -> None:
    """Operators after each other, which tract merges and moves."""
    steps: list[Callable[[Graph, str], str]] = [
        lambda g, v: g.op("Conv", [v, g.normal(8, 8, 3, 3, deviation=0.2), g.normal(8)], pads=[1] * 4),
        lambda g, v: g.op("Conv", [v, g.normal(8, 8, 1, 1)]),
        lambda g, v: g.op("Conv", [v, g.normal(8, 1, 3, 3)], pads=[1] * 4, group=8),
        lambda g, v: g.op("Conv", [v, g.normal(8, 8, 3, 3, deviation=0.2)], pads=[1] * 4, strides=[2, 2]),
        lambda g, v: g.op("ConvTranspose", [v, g.normal(8, 8, 2, 2, deviation=0.2)], strides=[2, 2]),
        lambda g, v: g.op("Relu", [v]),
        lambda g, v: g.op("Sigmoid", [v]),
        lambda g, v: g.op("Mul", [v, g.op("Sigmoid", [v])]),
        lambda g, v: g.op("Sub", [g.normal(8, 1, 1), v]),
        lambda g, v: g.op("Sub", [v, g.normal(8, 1, 1)]),
        lambda g, v: g.op("Mul", [g.normal(1, 8, 1, 1), v]),
        lambda g, v: g.op("Add", [v, g.op("Conv", [v, g.normal(8, 8, 1, 1, deviation=0.2)])]),
        lambda g, v: g.op("Sub", [g.op("Conv", [v, g.normal(8, 8, 1, 1, deviation=0.2)]), v]),
        lambda g, v: g.op("Slice", [v, g.ints(1, 0), g.ints(2**31, 2**31), g.ints(2, 3), g.ints(2, 3)]),
        lambda g, v: g.op("Slice", [v, g.ints(-1), g.ints(-(2**31)), g.ints(3), g.ints(-1)]),
        lambda g, v: g.op("Concat", [g.op("Slice", [v, g.ints(4), g.ints(8), g.ints(1)]), g.op("Slice", [v, g.ints(0), g.ints(4), g.ints(1)])], axis=1),
        lambda g, v: g.op("Transpose", [v], perm=[0, 1, 3, 2]),
        lambda g, v: g.op("Pad", [v, g.ints(0, 0, 1, 0, 0, 0, 0, 2)], mode="edge"),
        lambda g, v: g.op("Pad", [v, g.ints(0, 0, 1, 1, 0, 0, 1, 1)]),
        lambda g, v: g.op("MaxPool", [v], kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4),
        lambda g, v: g.op("AveragePool", [v], kernel_shape=[2, 2], strides=[1, 1], ceil_mode=1),
        lambda g, v: g.op("Resize", [v, "", g.const([1, 1, 2, 2], F32)], mode="linear"),
        lambda g, v: g.op("Resize", [v, "", g.const([1, 1, 2, 2], F32)], mode="nearest", coordinate_transformation_mode="asymmetric", nearest_mode="floor"),
        lambda g, v: g.op("Mul", [v, g.op("Softmax", [g.op("GlobalAveragePool", [v])], axis=1)]),
        lambda g, v: g.op("Div", [v, g.op("Sqrt", [g.op("Add", [g.op("ReduceMean", [g.op("Mul", [v, v])], axes=[1], keepdims=1), g.scalar(1e-3)])])]),
        lambda g, v: g.op("Gather", [v, g.ints(3, 1, 0, 2, 7, 6, 5, 4)], axis=1),
        lambda g, v: g.op("Clip", [v, g.scalar(-0.5), g.scalar(1)]),
        lambda g, v: g.op("LeakyRelu", [v], alpha=0.1),
        lambda g, v: g.op("DepthToSpace", [g.op("Conv", [v, g.normal(32, 8, 1, 1)])], blocksize=2),
        lambda g, v: last_of(g, v),
    ]

    def last_of(g: Graph, v: str) -> str:
        turned = g.op("Transpose", [v], perm=[0, 2, 3, 1])
        return g.op("Transpose", [g.op("MatMul", [turned, g.normal(8, 8, deviation=0.3)])], perm=[0, 3, 1, 2])

    for number in range(150):
        def chained(g: Graph, n: int = number) -> str:
            chosen = np.random.default_rng(n).choice(len(steps), 6)
            value = g.stem()
            for index in chosen:
                value = steps[index](g, value)
            return value

        case(f"chain_{number}", chained, 13)


# What is refused, by the beginning of a graph's name, and what is said.
REFUSED = {
    "Add_6": "operator set 6; wanted 7 to 26",
    "AveragePool_17_kernel_shape=[3,3]_strides=[2,2]_auto_pad=VALID_ceil_mode=1": "ceil_mode and auto_pad VALID",
    "BatchNormalization_15_training": "BatchNormalization (value v1) is not supported: in training mode",
    "CenterCropPad": "operator CenterCropPad",
    "ConvTranspose_8x6x3x3_17_True_strides=[2,2]_output_shape=[51,83]": "beyond the reach of its kernel",
    "DeformConv": "operator DeformConv",
    "DequantizeLinear_blocked": "operator DequantizeLinear (value v0) is not supported: in blocks",
    "Einsum_dots": "Einsum (value v1) is not supported: with dots",
    "GlobalLpPool": "operator GlobalLpPool",
    "GridSample_bicubic_0_border": "bicubic with the padding of a border",
    "GridSample_bicubic_1_border": "bicubic with the padding of a border",
    "LRN_13_size=4": "LRN (value v1) is not supported: with an even size",
    "LpPool": "operator LpPool",
    "MaxPool_17_kernel_shape=[3,3]_strides=[2,2]_auto_pad=SAME_LOWER_dilations": "dilations and auto_pad SAME",
    "MaxPool_17_kernel_shape=[3,3]_strides=[2,2]_auto_pad=SAME_UPPER_dilations": "dilations and auto_pad SAME",
    "MaxPool_17_kernel_shape=[3,3]_strides=[2,2]_auto_pad=VALID_ceil_mode=1": "ceil_mode and auto_pad VALID",
    "MaxUnpool": "operator MaxUnpool",
    "Pad_19_wrap": "with the mode wrap",
    "Pad_23_wrap": "with the mode wrap",
    "Pad_2_negative": "attribute 'pads': expected list of non-negative ints",
    "Resize_13_1x1_mode=cubic_coordinate_transformation_mode=pytorch_half_pixel": "cubic to a single pixel",
    **{
        f"Resize_18_{name}_mode={mode}_coordinate_transformation_mode=align_corners_antialias": "align_corners with antialias"
        for name, mode in product(("half", "x1.3"), ("linear", "cubic"))
    },
    "Resize_18_half_mode=linear_exclude_outside=1": "linear with exclude_outside",
    "Resize_18_x1.3_mode=linear_exclude_outside=1": "linear with exclude_outside",
    "ReverseSequence": "operator ReverseSequence",
    "com.microsoft_": "it is of com.microsoft, not of ONNX",
    "function_with_a_value_of_its_own": "has a value of its own for slope",
    "sequence": "operator SplitToSequence",
    "sparse_weights": "its weights sparse are sparse",
}

FAMILIES = [poolings, convolutions, resizes, activations, normalisations, shapes, sums, quantised, habits, chains]
KINDS = {"tensor(float16)": np.float16, "tensor(double)": np.float64, "tensor(uint8)": np.uint8}


def truth(model: onnx.ModelProto, picture: np.ndarray) -> np.ndarray:
    """The value `y`; raises when neither implementation has it."""
    options = ort.SessionOptions()
    options.log_severity_level = 4
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.intra_op_num_threads = 1
    try:
        session = ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
        described = session.get_inputs()[0]
        kind = KINDS.get(described.type, F32)
        if described.shape[3] == 3:
            picture = picture.transpose(0, 2, 3, 1)
        return np.asarray(session.run(["y"], {"x": picture.astype(kind)})[0])
    except Exception:  # Every kind of refusal.
        return np.asarray(ReferenceEvaluator(model).run(["y"], {"x": picture})[0])


def operators(nodes: Iterable[onnx.NodeProto]) -> set[str]:
    """Names of the operators of nodes, and of those inside them."""
    names: set[str] = set()
    for node in nodes:
        names.add(node.op_type)
        for attribute in node.attribute:
            names |= operators(attribute.g.node)
    return names


def main(out: Path) -> None:
    for family in FAMILIES:
        family()
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, (build, opset, sizes) in CASES.items():
        for size in sizes:
            graph = Graph(size, opset)
            built = build(graph)
            model = graph.model(built) if isinstance(built, str) else built
            is_bytes = model.graph.input[0].type.tensor_type.elem_type == TensorProto.UINT8
            random = np.random.default_rng(11)
            shape = (1, 3, *size)
            picture = random.integers(0, 256, shape).astype(F32) if is_bytes else random.uniform(-2, 2, shape).astype(F32)
            stem = f"{len(rows):05}"
            onnx.save(model, out / f"{stem}.onnx")
            refused = [said for start, said in REFUSED.items() if name.startswith(start)]
            is_half = any(t.data_type == TensorProto.FLOAT16 for t in model.graph.initializer)
            inside = operators(model.graph.node).union(*(operators(f.node) for f in model.functions))
            row: dict[str, Any] = {"refused": refused, "is_half": is_half, "operators": sorted(inside)} | {"name": f"{name} {size[1]}x{size[0]}", "file": f"{stem}.onnx", "truth": f"{stem}.f32", "size": size, "bytes": is_bytes}
            try:
                value = truth(model, picture)
                row |= {"shape": value.shape, "finite": bool(np.isfinite(value).all())}
                value.astype("<f4").tofile(out / f"{stem}.f32")
            except Exception as why:
                row["unknown"] = str(why).strip().splitlines()[0][:200]
            rows.append(row)
            picture.astype("<f4").tofile(out / f"picture-{size[1]}x{size[0]}-{is_bytes}.f32")
    (out / "graphs.json").write_text(json.dumps(rows))
    for start in REFUSED:
        assert any(name.startswith(start) for name in CASES), start
    print(f"{len(rows)} graphs, {sum('unknown' in row for row in rows)} of them without a truth")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
