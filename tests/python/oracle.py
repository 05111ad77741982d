"""An independent computation of what `gapwatch compare` measures.

Picture -> encoder input -> activations -> energy maps -> histograms -> similarity, each step in its
textbook form and by other libraries than gapwatch's own: Pillow decodes and resizes, onnxruntime
runs the network, OpenCV correlates the histograms; the rest is NumPy in 64-bit floats.

The network runs in 32-bit floats on both sides, so energies differ by their rounding, and a pixel
that lies beside a bin's edge may be counted on the other side of it. Histograms therefore come with
bounds; see `Binned`.

Needs: pip install -r tests/requirements.txt
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime  # type: ignore[import-untyped]
from PIL import Image

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

PAPER_TEMPERATURE = 10.0
LEVELS = 256
PAPER_FIRST_LEVEL = 101
TEMPERATURE_SHARE = 0.2
EPSILON_SHARE = 1e-6
LOG_ENERGY_BINS = 64
PICTURES = (".png", ".jpg", ".jpeg")
# A picture whose brightest value is at most this is black.
BLACK_MAX = 8

# A pixel within this distance of a bin's edge may be counted in either bin: of the scaled
# attention, 0 to 1, and of the logarithm of the energy.
EDGE_SLACK = 1e-4
# Relative rounding of energies from 32-bit activations. A softmax multiplies it by energy / T,
# which only exceeds EDGE_SLACK where T is far below the energies.
ENERGY_ROUNDING = 2e-6


@dataclass(frozen=True)
class ModelOptions:
    """How a model is fed and where it is tapped."""

    taps: tuple[str, ...]
    width: int
    height: int
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    crop: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    @classmethod
    def from_toml(cls, path: Path) -> "ModelOptions":
        """Reads the file of options that lies beside an ONNX file."""
        with path.open("rb") as file:
            options = tomllib.load(file)
        width, height = options["size"].split("x")
        left, top, wide, high = options.get("crop", cls.crop)
        red, green, blue = options["mean"]
        red_std, green_std, blue_std = options["std"]
        return cls(
            taps=tuple(options["taps"]),
            width=int(width),
            height=int(height),
            mean=(red, green, blue),
            std=(red_std, green_std, blue_std),
            crop=(left, top, wide, high),
        )

    def flags(self) -> list[str]:
        """The same options as flags of gapwatch."""
        listed = {
            "--taps": self.taps,
            "--mean": self.mean,
            "--std": self.std,
            "--crop": self.crop,
        }
        flags = ["--size", f"{self.width}x{self.height}"]
        for flag, values in listed.items():
            flags += [flag, ",".join(str(value) for value in values)]
        return flags

    def to_toml(self) -> str:
        """The same options as the text of a file beside an ONNX file."""
        taps = ", ".join(f'"{tap}"' for tap in self.taps)
        lists = {"mean": self.mean, "std": self.std, "crop": self.crop}
        lines = [f"taps = [{taps}]", f'size = "{self.width}x{self.height}"']
        lines += [f"{name} = {list(map(float, values))}" for name, values in lists.items()]
        return "\n".join(lines) + "\n"


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder, in the order of their names."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES)


def decoded(path: Path) -> Image.Image:
    """The picture in 8-bit RGB."""
    with Image.open(path) as picture:
        return picture.convert("RGB")


def shows_something(picture: Image.Image) -> bool:
    """Whether the picture is neither black nor of one colour."""
    values = np.asarray(picture).reshape(-1, 3)
    return bool(values.max() > BLACK_MAX and (values != values[0]).any())


def encoder_input(picture: Image.Image, options: ModelOptions) -> npt.NDArray[np.float32]:
    """Crops, resizes (antialiased bilinear) and normalises a picture: `[1, 3, h, w]`."""
    left, top, wide, high = options.crop
    width, height = picture.size
    box = (left * width, top * height, (left + wide) * width, (top + high) * height)
    size = (options.width, options.height)
    planes = []
    for band, mean, std in zip(picture.split(), options.mean, options.std, strict=True):
        small = band.convert("F").resize(size, Image.Resampling.BILINEAR, box=box)
        planes.append((np.asarray(small, dtype=np.float64) / 255.0 - mean) / std)
    return np.stack(planes)[np.newaxis].astype(np.float32)


def energy(activations: npt.NDArray[np.float32]) -> Floats:
    """Sum of squares over the channels of `[1, C, h, w]`."""
    return np.asarray(np.square(activations[0].astype(np.float64)).sum(axis=0))


def interpolation_matrix(old: int, new: int) -> Floats:
    """`[new, old]`: linear interpolation between the centres of cells (half-pixel centres)."""
    centres = (np.arange(new) + 0.5) * (old / new) - 0.5
    unit_responses = [np.interp(centres, np.arange(old), unit) for unit in np.eye(old)]
    return np.stack(unit_responses, axis=1)


def resample(energy_map: Floats, height: int, width: int) -> Floats:
    """Bilinear resampling with half-pixel centres."""
    rows = interpolation_matrix(energy_map.shape[0], height)
    columns = interpolation_matrix(energy_map.shape[1], width)
    return rows @ energy_map @ columns.T


class TappedModel:
    """A copy of an ONNX model whose outputs are the taps."""

    def __init__(self, onnx_file: Path, options: ModelOptions) -> None:
        """Loads the file and taps it."""
        model = onnx.load(onnx_file)
        del model.graph.output[:]
        for tap in options.taps:
            model.graph.output.append(
                onnx.helper.make_tensor_value_info(tap, onnx.TensorProto.FLOAT, None)
            )
        settings = onnxruntime.SessionOptions()
        settings.intra_op_num_threads = 1
        settings.inter_op_num_threads = 1
        settings.log_severity_level = 3
        self.options = options
        self.session = onnxruntime.InferenceSession(
            model.SerializeToString(), settings, providers=["CPUExecutionProvider"]
        )
        self.input = self.session.get_inputs()[0].name

    def activations(self, picture: Image.Image) -> list[npt.NDArray[np.float32]]:
        """Activations of the taps, each `[1, C, h, w]`."""
        feed = {self.input: encoder_input(picture, self.options)}
        return list(self.session.run(list(self.options.taps), feed))

    def energies(self, path: Path) -> Floats | None:
        """Energy maps of a picture at a quarter of the input's size: `[taps, h, w]`.

        None for a picture that cannot be judged: it shows nothing, an activation is not a finite
        number, or a map is constant.
        """
        picture = decoded(path)
        if not shows_something(picture):
            return None
        activations = self.activations(picture)
        if not all(np.isfinite(one).all() for one in activations):
            return None
        maps = [energy(one) for one in activations]
        if any(np.ptp(one) == 0.0 for one in maps):
            return None
        height, width = self.options.height // 4, self.options.width // 4
        return np.stack([resample(one, height, width) for one in maps])

    def energies_of(self, pictures: Sequence[Path]) -> dict[str, Floats]:
        """Energy maps of the pictures that can be judged, by tap, each `[images, h, w]`."""
        judged = [maps for maps in map(self.energies, pictures) if maps is not None]
        none = np.empty((0, len(self.options.taps), 0, 0))
        maps = np.stack(judged) if judged else none
        return {tap: maps[:, index] for index, tap in enumerate(self.options.taps)}


def median_peak(maps: Floats) -> float:
    """Median over the images of the largest energy."""
    return float(np.median(maps.max(axis=(1, 2))))


def scaled_attention(energy_map: Floats, temperature: float) -> Floats:
    """Softmax over all pixels, then scaled so that the least attention is 0 and the greatest 1."""
    # A softmax is unchanged when a constant is taken off all its exponents.
    exponentials = np.exp((energy_map - energy_map.max()) / temperature)
    attention = exponentials / exponentials.sum()
    least, greatest = attention.min(), attention.max()
    return np.asarray((attention - least) / (greatest - least))


@dataclass(frozen=True)
class Binned:
    """Pixels of a set counted in bins, and how far another's counts may differ.

    A pixel near a bin's edge may be counted on either side of it. The bounds are for the pixels of
    a bin and all higher ones together, which is stricter than bounds for each bin.
    """

    images: int
    counts: Counts
    """`[bins]`, pixels summed over the images."""
    average: Floats
    """`[bins]`, the average of the images' histograms."""
    above_least: Counts
    """`[bins]`, pixels that surely lie in this bin or a higher one."""
    above_most: Counts
    """`[bins]`, pixels that may lie in this bin or a higher one."""


def pixels_above(values: Floats, lower_edges: Floats) -> Counts:
    """Pixels at or above each edge."""
    rising = np.sort(values, axis=None)
    return np.asarray(rising.size - np.searchsorted(rising, lower_edges, side="left"))


def binned(values: Floats, bins: Counts, lower_edges: Floats, slack: float | Floats) -> Binned:
    """Counts pixels whose bins are known.

    - `values`, `bins`: `[images, h, w]`; a negative bin is not counted
    - `lower_edges`: `[bins]`, rising
    - `slack`: in the unit of the values, one for all or one an image
    """
    size = lower_edges.size
    histograms = np.zeros((len(bins), size), dtype=np.int64)
    for index, one in enumerate(bins):
        histograms[index] = np.bincount(one[one >= 0], minlength=size)
    counts = histograms.sum(axis=0)
    return Binned(
        images=len(bins),
        counts=counts,
        average=histograms.mean(axis=0) if len(bins) else counts.astype(np.float64),
        above_least=pixels_above(values - slack, lower_edges),
        above_most=pixels_above(values + slack, lower_edges),
    )


def attention_histogram(maps: Floats, temperature: float, first_level: int) -> Binned:
    """Levels `floor(255 a)` of the scaled attention `a`, from the first counted one on."""
    attention = np.array([scaled_attention(one, temperature) for one in maps])
    levels = np.floor((LEVELS - 1) * attention).astype(np.int64)
    lower_edges = np.arange(first_level, LEVELS) / (LEVELS - 1)
    if first_level == 0:
        lower_edges[0] = -np.inf
    # Both the pixel's energy and the greatest one are rounded.
    peaks = np.array([one.max() for one in maps]).reshape(-1, 1, 1)
    slack = np.maximum(EDGE_SLACK, 2.0 * ENERGY_ROUNDING * peaks / temperature)
    return binned(attention, levels - first_level, lower_edges, slack)


def log_energy(maps: Floats, epsilon: float) -> Floats:
    """Natural logarithm of the energy, kept above that of `epsilon`."""
    return np.asarray(np.log(maps + epsilon))


def log_energy_histogram(maps: Floats, epsilon: float, inner_edges: Floats) -> Binned:
    """Bins of the logarithm of the energy between given edges; the outer bins are open."""
    logarithms = log_energy(maps, epsilon)
    bins = np.digitize(logarithms, inner_edges)
    lower_edges = np.concatenate([[-np.inf], inner_edges])
    return binned(logarithms, bins, lower_edges, EDGE_SLACK)


def correlation(a: Floats, b: Floats) -> float | None:
    """Pearson's correlation of two histograms; None where it has no value (OpenCV answers 1)."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return None
    pair = [histogram.astype(np.float32) for histogram in (a, b)]
    return float(cv2.compareHist(pair[0], pair[1], cv2.HISTCMP_CORREL))


def entropy_bits(shares: Floats) -> float:
    """Entropy of a distribution, bits."""
    positive = shares[shares > 0.0]
    return float(-(positive * np.log2(positive)).sum())


def jensen_shannon_bits(a: Floats, b: Floats) -> float | None:
    """Entropy of the mixture less the mean entropy of the parts; None for an empty histogram."""
    if a.sum() == 0.0 or b.sum() == 0.0:
        return None
    p, q = a / a.sum(), b / b.sum()
    return entropy_bits((p + q) / 2.0) - (entropy_bits(p) + entropy_bits(q)) / 2.0


def chi_square(a: Floats, b: Floats) -> float | None:
    """Half the sum of squared differences over sums, of shares; None for an empty histogram."""
    if a.sum() == 0.0 or b.sum() == 0.0:
        return None
    p, q = a / a.sum(), b / b.sum()
    filled = p + q > 0.0
    return float(0.5 * ((p - q)[filled] ** 2 / (p + q)[filled]).sum())


def hellinger(a: Floats, b: Floats) -> float | None:
    """Root of one less the Bhattacharyya coefficient; None for an empty histogram."""
    if a.sum() == 0.0 or b.sum() == 0.0:
        return None
    p, q = a / a.sum(), b / b.sum()
    return float(np.sqrt(max(0.0, 1.0 - np.sqrt(p * q).sum())))


def wasserstein(a: Floats, b: Floats) -> float | None:
    """Area between the cumulated shares, bins evenly spaced from 0 to 1; None for an empty histogram."""
    if a.sum() == 0.0 or b.sum() == 0.0:
        return None
    apart = np.cumsum(a / a.sum()) - np.cumsum(b / b.sum())
    return float(np.abs(apart).sum() / (a.size - 1))
