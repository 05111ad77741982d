"""Checks gapwatch with networks that it was not made for, against an independent computation.

Writes ONNX files of other people's shape (residual blocks, two branches joined, PReLU with a slope
for each channel, batch normalisation, pooling, a decoder with ConvTranspose and Resize, several
outputs, another input size and normalisation, a crop) with seeded random weights, and checks:

- `calibrate` with all options as flags, and the reference file that it writes;
- `compare` with the options from the .toml beside the ONNX file: values inside the network at
  strides 2, 4 and 8, values of the decoder, with a batch of any size and of one;
- `replay` with that reference: the gap of every frame's window;
- refusals, with exit code 2 and one line on standard error: a tap that does not exist, another
  model, another normalisation, ONNX files cut off, weights that are zero or no numbers;
- sets whose activations are infinite, not a number or the same everywhere: null with a reason.

Prints tables and one last line `foreign models agree with the oracle: ...`. Exit code 1 with one
line at the first failure, 2 when the check cannot be made.

Needs: pip install -r tests/requirements.txt
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper
from PIL import Image, ImageDraw

import check_compare
import oracle
from check_compare import Answer, CannotCheck, Disagreement, PictureSet
from oracle import ModelOptions, TappedModel

# A third of a single source is held out by `calibrate`, which wants 20 frames there.
IMAGES_MIN = 60
OTHER_MIN = 10
# Pictures that are painted over; more would only take time.
PAINTED = 20
CHANNELS = (12, 20, 24)
WIDTH, HEIGHT = 256, 96
OPTIONS = ModelOptions(
    taps=("/stage1/Relu_output_0", "/stage2/PRelu_output_0", "/stage3/Add_output_0"),
    width=WIDTH,
    height=HEIGHT,
    mean=(0.5, 0.45, 0.4),
    std=(0.25, 0.3, 0.5),
    crop=(0.0, 0.25, 1.0, 0.75),
)
DECODER_TAPS = ("/decoder/ConvTranspose_output_0", "/decoder/Resize_output_0", "mask")


@dataclass
class Network:
    """An ONNX graph being written, with seeded weights."""

    random: np.random.Generator
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    weights: dict[str, npt.NDArray[Any]] = field(default_factory=dict)

    def node(self, kind: str, name: str, inputs: Sequence[str], **attributes: Any) -> str:
        """Adds a node; returns the name of its value."""
        value = f"/{name}/{kind}_output_0"
        self.nodes.append(helper.make_node(kind, inputs, [value], f"/{name}/{kind}", **attributes))
        return value

    def weight(self, name: str, values: npt.NDArray[Any]) -> str:
        """Adds constant values; returns their name."""
        self.weights[name] = values
        return name

    def normal(self, name: str, shape: Sequence[int], deviation: float, mean: float = 0.0) -> str:
        """Adds normally distributed weights."""
        values = self.random.normal(mean, deviation, shape)
        return self.weight(name, values.astype(np.float32))

    def convolution(
        self, name: str, x: str, channels: tuple[int, int], kernel: int, **attributes: Any
    ) -> str:
        """Convolution with bias; `channels` are those in and out."""
        fan_in = channels[0] // attributes.get("group", 1)
        deviation = math.sqrt(2.0 / (fan_in * kernel * kernel))
        shape = (channels[1], fan_in, kernel, kernel)
        inputs = [x, self.normal(f"{name}.weight", shape, deviation)]
        inputs.append(self.normal(f"{name}.bias", shape[:1], 0.1))
        padding = attributes.get("dilations", [1])[0] * (kernel // 2)
        return self.node(
            "Conv", name, inputs, kernel_shape=[kernel, kernel], pads=4 * [padding], **attributes
        )

    def batch_norm(self, name: str, x: str, channels: int) -> str:
        """Batch normalisation as at inference."""
        inputs = [x, self.normal(f"{name}.gamma", [channels], 0.2, 1.0)]
        inputs.append(self.normal(f"{name}.beta", [channels], 0.2))
        inputs.append(self.normal(f"{name}.running_mean", [channels], 0.2))
        variance = self.random.uniform(0.5, 2.0, channels).astype(np.float32)
        inputs.append(self.weight(f"{name}.running_var", variance))
        return self.node("BatchNormalization", name, inputs, epsilon=1e-5)

    def prelu(self, name: str, x: str, channels: int) -> str:
        """PReLU with a slope for each channel."""
        slopes = self.random.uniform(0.05, 0.4, (channels, 1, 1)).astype(np.float32)
        return self.node("PRelu", name, [x, self.weight(f"{name}.slope", slopes)])

    def residual(self, name: str, x: str, channels: int, **attributes: Any) -> str:
        """Two convolutions beside the value itself."""
        inner = self.convolution(f"{name}/conv1", x, (channels, channels), 3, **attributes)
        inner = self.batch_norm(f"{name}/bn1", inner, channels)
        inner = self.prelu(f"{name}/act1", inner, channels)
        inner = self.convolution(f"{name}/conv2", inner, (channels, channels), 3)
        inner = self.batch_norm(f"{name}/bn2", inner, channels)
        return self.node("Add", name, [inner, x])

    def model(self, outputs: dict[str, list[int | str]], batch: int | str) -> onnx.ModelProto:
        """The model, with one input `picture`."""
        shape = [batch, 3, HEIGHT, WIDTH]
        graph = helper.make_graph(
            self.nodes,
            "network",
            [helper.make_tensor_value_info("picture", TensorProto.FLOAT, shape)],
            [
                helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, *shape])
                for name, shape in outputs.items()
            ],
            [numpy_helper.from_array(values, name) for name, values in self.weights.items()],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        onnx.checker.check_model(model, full_check=True)
        return model


def lane_network(
    seed: int,
    batch: int | str,
    change: Callable[[str, npt.NDArray[Any]], npt.NDArray[Any]] = lambda _, values: values,
) -> onnx.ModelProto:
    """A lane network with an encoder, a decoder and a second head.

    `change` is made to all weights, which it is given by name.
    """
    net = Network(np.random.default_rng(seed))
    first, second, third = CHANNELS
    x = net.convolution("stem/conv", "picture", (3, first), 5, strides=[2, 2])
    x = net.batch_norm("stem/bn", x, first)
    x = net.prelu("stem", x, first)
    stage1 = net.node("Relu", "stage1", [net.residual("stage1", x, first)])

    x = net.node(
        "MaxPool", "stage2", [stage1], kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1]
    )
    narrow = net.convolution("stage2/narrow", x, (first, second - first), 1)
    wide = net.convolution("stage2/wide", x, (first, first), 3, dilations=[2, 2])
    x = net.node("Concat", "stage2", [narrow, wide], axis=1)
    stage2 = net.prelu("stage2", net.batch_norm("stage2/bn", x, second), second)

    x = net.convolution("stage3/down", stage2, (second, third), 3, strides=[2, 2])
    x = net.batch_norm("stage3/bn", x, third)
    stage3 = net.residual("stage3", x, third, group=4)

    up = net.normal("decoder/up.weight", (third, second, 4, 4), 0.1)
    x = net.node(
        "ConvTranspose",
        "decoder",
        [stage3, up],
        kernel_shape=[4, 4],
        strides=[2, 2],
        pads=[1, 1, 1, 1],
    )
    x = net.node("Concat", "decoder", [x, stage2], axis=1)
    x = net.prelu("decoder", net.convolution("decoder/conv", x, (2 * second, first), 3), first)
    scales = net.weight("decoder/scales", np.array([1, 1, 2, 2], dtype=np.float32))
    x = net.node(
        "Resize",
        "decoder",
        [x, "", scales],
        mode="linear",
        coordinate_transformation_mode="half_pixel",
    )
    x = net.convolution("mask/conv", x, (first, 1), 1)
    net.nodes.append(helper.make_node("Sigmoid", [x], ["mask"], "/mask/Sigmoid"))

    x = net.node("Flatten", "existence", [net.node("GlobalAveragePool", "existence", [stage3])])
    gemm = net.normal("existence.weight", (4, third), 0.2)
    net.nodes.append(helper.make_node("Gemm", [x, gemm], ["existence"], transB=1))
    scales_kept = net.weights["decoder/scales"]
    net.weights = {name: change(name, values) for name, values in net.weights.items()}
    net.weights["decoder/scales"] = scales_kept
    return net.model({"mask": [1, HEIGHT // 2, WIDTH // 2], "existence": [4]}, batch)


def peculiar_network() -> onnx.ModelProto:
    """A network whose values are infinite or not a number where a picture is magenta.

    Its value `colour` is zero everywhere in a grey picture.
    """
    net = Network(np.random.default_rng(3))
    kept = net.convolution("kept", "picture", (3, 8), 5, strides=[4, 4])
    # 2 in pure magenta, 1.5 is subtracted: only pictures made for this check have more than that.
    # Squared twice, the rest of 5e9 is more than a 32-bit float holds.
    magenta = 1e10 * np.array([1, -2, 1], dtype=np.float32).reshape(1, 3, 1, 1)
    inputs = ["picture", net.weight("magenta.weight", magenta)]
    inputs.append(net.weight("magenta.bias", np.array([-1.5e10], dtype=np.float32)))
    x = net.node("Conv", "magenta", inputs, kernel_shape=[1, 1], strides=[4, 4])
    x = net.node("Relu", "magenta", [x])
    large = net.node("Mul", "large", [x, x])
    huge = net.node("Mul", "huge", [large, large])
    nothing = net.node("Sub", "nothing", [huge, huge])
    differences = np.array([[1, -1, 0], [0, 1, -1]], dtype=np.float32).reshape(2, 3, 1, 1)
    inputs = ["picture", net.weight("colour.weight", differences)]
    x = net.node("Conv", "colour", inputs, kernel_shape=[1, 1], strides=[4, 4])
    net.nodes.append(helper.make_node("Add", [kept, huge], ["infinite"]))
    net.nodes.append(helper.make_node("Add", [kept, nothing], ["not_a_number"]))
    net.nodes.append(helper.make_node("Identity", [x], ["colour"]))
    size: list[int | str] = [HEIGHT // 4, WIDTH // 4]
    return net.model({"infinite": [8, *size], "not_a_number": [8, *size], "colour": [2, *size]}, 1)


def write_model(folder: Path, model: onnx.ModelProto, options: ModelOptions | None) -> Path:
    """Writes an ONNX file, with its options beside it unless there are none."""
    folder.mkdir(parents=True)
    path = folder / "network.onnx"
    onnx.save(model, path)
    if options is not None:
        path.with_suffix(".toml").write_text(options.to_toml())
    return path


def numbered(folder: Path, scratch: Path) -> Path:
    """A folder with the same pictures as PNG, numbered: one order for everybody."""
    pictures = oracle.pictures_in(folder)
    if not pictures:
        raise CannotCheck(f"{folder}: no PNG or JPEG picture in this folder")
    copies = Path(tempfile.mkdtemp(dir=scratch, prefix=f"{folder.name}-"))
    for number, picture in enumerate(pictures):
        copy = copies / f"{number:06}.png"
        if check_compare.is_jpeg(picture):
            oracle.decoded(picture).save(copy)
        else:
            copy.symlink_to(picture.resolve())
    return copies


def repainted(
    folder: Path, scratch: Path, name: str, paint: Callable[[int, Image.Image], Image.Image]
) -> Path:
    """A folder with changed copies of the first pictures."""
    copies = scratch / name
    copies.mkdir()
    for number, picture in enumerate(oracle.pictures_in(folder)[:PAINTED]):
        paint(number, oracle.decoded(picture)).save(copies / picture.name)
    return copies


def with_magenta(picture: Image.Image) -> Image.Image:
    """The picture with a magenta field over a quarter of it."""
    width, height = picture.size
    corners = (width // 4, height // 4, width * 3 // 4, height * 3 // 4)
    ImageDraw.Draw(picture).rectangle(corners, fill=(255, 0, 255))
    return picture


ONE_NODE = ModelOptions(
    taps=("y",), width=64, height=32, mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0)
)


def impossible_nodes() -> list[tuple[str, onnx.NodeProto, list[npt.NDArray[Any]]]]:
    """Nodes that cannot be computed, or only with memory that no machine has; with their constants.

    The constants are the node's inputs after the picture.
    """
    make = onnx.helper.make_node
    kernel = np.ones((4, 3, 3, 3), np.float32)
    pads = np.array([0, 0, 0, 0, 0, 0, 1 << 30, 1 << 30])
    tiles = np.array([1, 100_000, 1_000, 100])
    return [
        ("stride_0", make("Conv", ["x", "c0"], ["y"], strides=[0, 0]), [kernel]),
        ("padding", make("Conv", ["x", "c0"], ["y"], pads=[1 << 28] * 4), [kernel]),
        ("pool", make("MaxPool", ["x"], ["y"], kernel_shape=[2, 2], strides=[0, 0]), []),
        ("axes", make("Transpose", ["x"], ["y"], perm=[0, 1, 2, 9]), []),
        ("pad", make("Pad", ["x", "c0"], ["y"]), [pads]),
        ("tile", make("Tile", ["x", "c0"], ["y"]), [tiles]),
        ("gather", make("Gather", ["x", "c0"], ["y"], axis=1), [np.array([9, 99])]),
    ]


def one_node_network(node: onnx.NodeProto, constants: list[npt.NDArray[Any]]) -> onnx.ModelProto:
    """A graph of one node on a picture `x` of 64x32, with output `y` of no stated shape."""
    picture = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1, 3, 32, 64])
    output = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, None)
    values = [onnx.numpy_helper.from_array(c, f"c{i}") for i, c in enumerate(constants)]
    graph = onnx.helper.make_graph([node], "one", [picture], [output], values)
    opset = [onnx.helper.make_opsetid("", 13)]
    return onnx.helper.make_model(graph, opset_imports=opset, ir_version=8)


def refusal(program: Path, arguments: Sequence[str], words: Sequence[str]) -> str:
    """Runs gapwatch, which must refuse with exit code 2 and one line that holds the words."""
    run = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    what = f"gapwatch {' '.join(arguments)}"
    said = " ".join((run.stdout + run.stderr).split())[:300]
    if run.returncode != 2 or run.stdout:
        raise Disagreement(
            f"{what}: exit code {run.returncode}, wanted 2 and nothing on standard output: {said}"
        )
    lines = run.stderr.splitlines()
    missing = [word for word in words if word not in run.stderr]
    if len(lines) != 1 or not lines[0].strip() or missing:
        raise Disagreement(f"{what}: wanted one line with {missing or 'text'}: {said}")
    return lines[0]


@dataclass(frozen=True)
class Check:
    """What all parts of the check work with."""

    program: Path
    scratch: Path
    images: PictureSet
    other: PictureSet
    dynamic: Path
    """ONNX file with a batch of any size; its options beside it."""
    fixed: Path
    """One with other weights and a batch of one; its options beside it."""

    def calibrate(self) -> dict[str, Any]:
        """Makes a reference with all options as flags and checks it; returns its content."""
        onnx_file = write_model(self.scratch / "flags", onnx.load(self.dynamic), None)
        flags = ["--model", str(onnx_file), *OPTIONS.flags(), "--out", str(self.reference)]
        flags += ["--metric", "log-energy-js"]
        check_compare.answer_of(self.program, ["calibrate", "--sim", self.images.name, *flags])
        reference: dict[str, Any] = check_compare.strict_json(self.reference.read_text())
        fitted = self.images.images - self.images.images // 3
        maps = {tap: maps[:fitted] for tap, maps in self.images.maps.items()}
        seen = replace(self.images, images=fitted, maps=maps)
        metric = reference["metric"]
        taps = reference["components"][0]["taps"]
        if [one["tap"] for one in taps] != list(OPTIONS.taps):
            raise Disagreement("the reference holds other taps than asked for")
        records = {
            (seen.name, metric, one["tap"]): one | one["nominal"]["histogram"] for one in taps
        }
        check_compare.check_answer(Answer((metric,), "10", {}, records), [seen])
        return reference

    @property
    def reference(self) -> Path:
        """The reference file."""
        return self.scratch / "reference.json"

    def compare(self, temperature: str) -> float:
        """Checks comparisons by values inside the network; returns the largest difference."""
        sets = [self.images, self.other]
        model_flags = ["--model", str(self.dynamic)]
        results = check_compare.check_sets(self.program, model_flags, sets, temperature)
        for onnx_file, taps in ((self.dynamic, DECODER_TAPS), (self.fixed, OPTIONS.taps)):
            model = TappedModel(onnx_file, replace(OPTIONS, taps=taps))
            sets = [self.seen(model, one) for one in (self.images, self.other)]
            flags = ["--model", str(onnx_file), "--taps", ",".join(taps)]
            answer = check_compare.compare(self.program, flags, sets, "all", "10")
            results.append((answer, check_compare.check_answer(answer, sets)))
        check_compare.print_table(results)
        return max(one.difference_without_edges for _, found in results for one in found)

    @staticmethod
    def seen(model: TappedModel, one: PictureSet) -> PictureSet:
        """The same pictures seen by another model."""
        return replace(one, maps=model.energies_of(oracle.pictures_in(Path(one.name))))

    def replay(self, reference: dict[str, Any]) -> int:
        """Checks the gap of every frame of a replay; returns how many there were."""
        journal = self.scratch / "journal.jsonl"
        flags = ["--reference", str(self.reference), "--model", str(self.dynamic)]
        flags += ["--journal", str(journal)]
        check_compare.answer_of(self.program, ["replay", self.other.name, *flags])
        # The first line says what the run was made with.
        lines = [check_compare.strict_json(line) for line in journal.read_text().splitlines()[1:]]
        if len(lines) != self.other.images:
            raise Disagreement(f"the journal has {len(lines)} lines for {self.other.images} frames")
        for tap in reference["components"][0]["taps"]:
            maps = self.other.maps[tap["tap"]]
            histogram = tap["nominal"]["histogram"]
            nominal = np.array(histogram["counts"], dtype=np.float64)
            binning = histogram["binning"]
            epsilon, edges = binning["epsilon"], np.array(binning["edges"])
            for last, line in enumerate(lines):
                # A window is open at its old end; frame times are exact to less than 1 us.
                begin = line["t_s"] - reference["window_s"] + 1e-6
                inside = [i for i in range(last + 1) if lines[i]["t_s"] > begin]
                window = oracle.log_energy_histogram(maps[inside], epsilon, edges)
                wanted = oracle.jensen_shannon_bits(window.average, nominal)
                gap, similarity = line["tap_gap"][tap["tap"]], line["tap_similarity"][tap["tap"]]
                # A pixel in the bin beside the oracle's moves the divergence by less than this.
                pixels = int(window.counts.sum())
                edge_pixels = int((window.above_most - window.above_least).sum())
                allowed = check_compare.TOLERANCE + edge_pixels * math.log2(pixels) / pixels
                what = f"replay, frame {last}, tap {tap['tap']}"
                if wanted is None or gap is None or not abs(gap - wanted) <= allowed:
                    raise Disagreement(f"{what}: gap {gap}, the oracle says {wanted}")
                if not abs(gap + similarity - 1.0) <= check_compare.TOLERANCE:
                    raise Disagreement(f"{what}: gap {gap} and similarity {similarity}")
        return len(lines)

    def refusals(self) -> int:
        """Checks what must be refused; returns how many commands."""
        compare = ["compare", self.images.name, self.other.name]
        taps = [OPTIONS.taps[0], "/stage2/Softmax_output_0"]
        flags = ["--model", str(self.dynamic), "--taps", ",".join(taps)]
        said = [refusal(self.program, [*compare, *flags], [taps[1], *OPTIONS.taps])]

        replay = ["replay", self.other.name, "--reference", str(self.reference)]
        other_model = [*replay, "--model", str(self.fixed)]
        said.append(refusal(self.program, other_model, ["reference", "model"]))
        mean = ["--model", str(self.dynamic), "--mean", "0.5,0.5,0.5"]
        said.append(refusal(self.program, [*replay, *mean], ["reference", "preprocessing"]))

        whole = self.dynamic.read_bytes()
        for share in (0.0, 0.01, 0.4, 0.8, 0.99):
            cut = self.scratch / f"cut-{share}" / "network.onnx"
            cut.parent.mkdir()
            cut.write_bytes(whole[: int(share * len(whole))])
            cut.with_suffix(".toml").write_text(OPTIONS.to_toml())
            said.append(refusal(self.program, [*compare, "--model", str(cut)], [str(cut)]))
        for name, node, constants in impossible_nodes():
            path = write_model(self.scratch / name, one_node_network(node, constants), ONE_NODE)
            said.append(refusal(self.program, [*compare, "--model", str(path)], []))
        for line in said:
            self.report(line)
        return len(said)

    def broken_networks(self) -> None:
        """Checks networks that give no value for any picture, not even for the reference."""

        def zeros(_: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.zeros_like(values)

        def no_numbers(_: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.full_like(values, np.nan)

        def no_number_in_one_channel(name: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            # A ReLU after it must not make a zero of it.
            if name == "stage1/bn2.gamma":
                values[0] = np.nan
            return values

        for change, reason in (
            (zeros, "energy map is constant"),
            (no_numbers, "finite"),
            (no_number_in_one_channel, "finite"),
        ):
            folder = self.scratch / change.__name__
            path = write_model(folder, lane_network(1, 1, change), OPTIONS)
            arguments = ["compare", self.images.name, self.other.name, "--model", str(path)]
            self.report(refusal(self.program, [*arguments, "--format", "json"], [reason]))

    def report(self, line: str) -> None:
        """Prints the beginning of a refusal."""
        print(f"refused: {line.replace(str(self.scratch), '')[:110]}")

    def peculiar_pictures(self) -> None:
        """Checks sets that have no value against a reference that has one."""
        everything = replace(OPTIONS, mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0))
        folder = Path(self.other.name)
        plain = repainted(folder, self.scratch, "plain", lambda _, one: one)
        magenta = repainted(folder, self.scratch, "magenta", lambda _, one: with_magenta(one))
        mixed = repainted(
            folder, self.scratch, "mixed", lambda i, one: with_magenta(one) if i % 2 else one
        )
        grey = repainted(
            folder, self.scratch, "grey", lambda _, one: one.convert("L").convert("RGB")
        )
        names = {tap: (tap,) for tap in ("infinite", "not_a_number", "colour")}
        path = write_model(
            self.scratch / "peculiar", peculiar_network(), replace(everything, taps=names["colour"])
        )
        for tap, folders, reason in (
            ("infinite", [plain, magenta, mixed], "activation of infinite is not a finite number"),
            (
                "not_a_number",
                [plain, magenta, mixed],
                "activation of not_a_number is not a finite",
            ),
            ("colour", [plain, grey], "energy map is constant"),
        ):
            model = TappedModel(path, replace(everything, taps=names[tap]))
            sets = check_compare.seen_by_oracle(model, folders, folders)
            flags = ["--model", str(path), "--taps", tap]
            answer = check_compare.compare(self.program, flags, sets, "all", "10")
            for (name, metric), row in answer.rows.items():
                what = f"{Path(name).name}: {metric}, tap {tap}"
                if name == str(mixed):
                    if row["judged"] != row["images"] // 2 + row["images"] % 2:
                        raise Disagreement(f"{what}: {row['judged']} of {row['images']} judged")
                elif row[tap] is not None or reason not in row.get("reasons", {}).get(tap, ""):
                    raise Disagreement(f"{what}: {json.dumps(row)}, wanted null: {reason}")
            check_compare.check_answer(answer, sets)
            print(f"{tap}: null where a set has no value, the oracle's value where it has one")


def check(arguments: argparse.Namespace) -> None:
    """Does all that the command line asks for."""
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        dynamic = write_model(scratch / "dynamic", lane_network(1, "batch"), OPTIONS)
        fixed = write_model(scratch / "fixed", lane_network(2, 1), OPTIONS)
        folders = [arguments.images, arguments.other]
        names = [numbered(one, scratch) for one in folders]
        sets = check_compare.seen_by_oracle(TappedModel(dynamic, OPTIONS), folders, names)
        for one in sets:
            if len(one.maps[OPTIONS.taps[0]]) != one.images:
                raise CannotCheck(f"{one.title}: a picture that shows nothing")
        for one, wanted in zip(sets, (IMAGES_MIN, OTHER_MIN), strict=True):
            if one.images < wanted:
                raise CannotCheck(f"{one.title}: {one.images} images, wanted at least {wanted}")
        checks = Check(arguments.gapwatch, scratch, sets[0], sets[1], dynamic, fixed)
        reference = checks.calibrate()
        difference = checks.compare(arguments.temperature)
        frames = checks.replay(reference)
        refused = checks.refusals()
        checks.broken_networks()
        checks.peculiar_pictures()
    print(
        f"foreign models agree with the oracle: {sets[0].images} and {sets[1].images} images, "
        f"largest difference {difference:.1e}, {frames} frames replayed, {refused} commands refused"
    )


def main() -> int:
    """Reads the command line, checks, prints; returns the exit code."""
    parser = argparse.ArgumentParser(
        description="Checks gapwatch with networks that it was not made for.",
        epilog="example: check_foreign_model.py --gapwatch target/release/gapwatch "
        "clean/frames fog/frames",
    )
    parser.add_argument("images", type=Path, metavar="IMAGES_DIR", help="60 pictures or more")
    parser.add_argument("other", type=Path, metavar="OTHER_DIR", help="10 pictures or more")
    parser.add_argument("--gapwatch", type=Path, required=True, metavar="PROGRAM")
    parser.add_argument(
        "--temperature",
        default="1peak",
        metavar="T",
        help="of the second comparison by the metric paper (default: %(default)s)",
    )
    try:
        check(parser.parse_args())
    except Disagreement as found:
        print(f"foreign model: {found}", file=sys.stderr)
        return 1
    except KeyError as key:
        print(f"foreign model: key {key} is missing in what gapwatch wrote", file=sys.stderr)
        return 1
    except (CannotCheck, OSError, ValueError) as why:
        print(f"{parser.prog}: cannot check: {why}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
