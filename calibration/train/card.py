"""The two files beside the model: what gapwatch needs to run it and people need to trust it."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path

from evaluation import Measurement
from export import OPSET, Agreement
from network import PEAK_ENERGY, TAPS
from scenes import Normalisation, Size, World


@dataclass(frozen=True)
class SceneSetNote:
    """A rendered set, and the hash of its list, which holds the hash of every scene's pixels."""

    use: str
    seed: int
    count: int
    sha256: str


@dataclass(frozen=True)
class Card:
    """Everything the model card says; all of it comes from the run itself."""

    name: str
    model: str
    size: Size
    command: str
    scene_sets: list[SceneSetNote]
    world: World
    init_sha256: str | None
    kept_encoder: tuple[str, str] | None
    head: str
    lane_share: float
    seed: int
    epochs: int
    steps: int
    batch: int
    learning_rate: float
    jitter: float
    varied: float
    variation: tuple[str, ...]
    sad_weight: float
    share_weights: bool
    lane_logit: float
    train_seconds: float
    machine: str
    measurement: Measurement
    encoder_parameters: int
    head_parameters: int
    encoder_multiply_adds: int
    total_multiply_adds: int
    channels: tuple[int, int]
    agreement: Agreement
    onnx_sha256: str
    onnx_bytes: int

    def text(self) -> str:
        """The card in Markdown."""
        low, high = self.measurement.interval()
        peaks = self.measurement.median_peaks()
        quarter, eighth = self.channels
        height, width = self.size.height, self.size.width
        kind = {
            "enet-sad": "ENet-SAD encoder (Hou et al., ICCV 2019), ReLU in place of PReLU",
            "small": "small ENet-SAD encoder: a stem of 4x4 patches, a quarter of the channels, three "
            "bottlenecks a block with dilations 1, 2, 4",
            "lite": "lite ENet-SAD encoder: stride-2 convolutions in place of pooling, half the "
            "channels, four bottlenecks a block with dilations 1, 2, 4, 8",
        }[self.model]
        sharing = (
            "shared by E2, E3 and E4, with batch norms of their own"
            if self.share_weights
            else "not shared between E2, E3 and E4"
        )
        sad = (
            f"on, weight {self.sad_weight:g}, in the second half of training"
            if self.sad_weight > 0
            else "off"
        )
        varied = (
            f";\n  {self.varied * 100:g} % of the scenes varied towards real roads (`variation.py`: {', '.join(self.variation)})"
            if self.varied > 0
            else ""
        )
        sets = "\n".join(
            f"| {of.use} | {of.seed} | {of.count} | `{of.sha256}` |" for of in self.scene_sets
        )
        start = (
            "the weights of an earlier run, which its own command must make first; their file has "
            f"SHA-256\n  `{self.init_sha256}`"
            if self.init_sha256
            else "random weights"
        )
        gains = (
            ""
            if self.kept_encoder
            else f", and the factor on each tap that brings its\nmedian peak energy to {PEAK_ENERGY:g}"
        )
        if self.kept_encoder:
            kept_file, kept_sha256 = self.kept_encoder
            start = (
                f"the encoder of `{kept_file}`, kept as it is, and a new lane head; its own command must "
                f"make that\n  file first, and it has SHA-256\n  `{kept_sha256}`"
            )
        alike = ", varied like those for training," if self.varied > 0 else ""
        light = "plain daylight, no fog, night, blur or noise"
        if self.kept_encoder and self.varied > 0:
            light = f"its encoder in {light}, and\nits lane head on scenes varied towards real roads"
        head = {"plain": "", "deep": ", which looks at all blocks through four dilated bottlenecks"}[self.head]
        peak_rows = "\n".join(f"| {tap} | {peaks[tap]:.4g} |" for tap in TAPS)
        differences = ", ".join(
            f"`{name}` {value:.1e}" for name, value in self.agreement.relative.items()
        )
        return f"""# {self.name}

Lane model whose encoder gapwatch watches the road through. It marks lane markings in an image and
was trained on gapwatch's own rendered scenes alone: {light}.

- File: `{self.name}.onnx`, {self.onnx_bytes / 1e6:.2f} MB, SHA-256
  `{self.onnx_sha256}`
- Kind: {kind}
- Weights: {sharing}
- Input: `image` `[1, 3, {height}, {width}]`, RGB, normalised as in `{self.name}.toml`
- Outputs: `lane` `[1, 1, {height}, {width}]` (a logit, lane where it is above 0); taps `e2`, `e3`,
  `e4` `[1, {eighth}, {height // 8}, {width // 8}]` (after the ReLU)
- Opset {OPSET}, fp32, batch norms folded

## Measured on unseen scenes, on the exported file

| | |
|---|---|
| lane IoU | **{self.measurement.iou():.4f}** |
| 95 % interval, bootstrap over scenes | {low:.4f} to {high:.4f} |
| scenes | {len(self.measurement.both)} |

The IoU is the intersection over the union of all pixels of all scenes at the full input size.

| tap | median peak energy |
|---|---|
{peak_rows}

## Size

| | parameters | multiply-adds |
|---|---|---|
| encoder (E1: {quarter} channels, E2 to E4: {eighth}) | {self.encoder_parameters:,} | {self.encoder_multiply_adds / 1e6:.1f} M |
| lane head{head}, dropped by the monitor | {self.head_parameters:,} | {(self.total_multiply_adds - self.encoder_multiply_adds) / 1e6:.1f} M |

Parameters are counted before folding, shared ones once.

## Data

Rendered by `gapwatch scene` at {self.size}; training scenes of the world `{self.world}`, the others of
`sim`. {self.lane_share * 100:.2f} % of the training pixels lie on a marking. The hash is that of a set's
`scenes.jsonl`, which has the hash of every frame and mask: it is the same on every machine.

| use | seed | scenes | SHA-256 |
|---|---|---|---|
{sets}

Validation scenes gave the progress lines and{alike} the point where lane begins (the head's last
bias was moved by {-self.lane_logit:+.2f} so that it lies at a logit of 0){gains}; test scenes were used once, for the tables above.

## Training

```
{self.command}
```

- From {start}
- Seed {self.seed}, {self.epochs} epochs, {self.steps} steps of {self.batch} scenes, AdamW, peak
  learning rate {self.learning_rate:g}, cosine to 0
- Augmentation: mirror, brightness, contrast and colour within {self.jitter * 100:g} %{varied}
- Self-attention distillation: {sad}
- {self.train_seconds / 60:.1f} minutes on {self.machine}

## Check

onnxruntime against PyTorch on {self.agreement.images} test scenes, largest difference as a share of the largest
value: {differences}.
"""


def write_settings(file: Path, size: Size, normalisation: Normalisation) -> None:
    """Writes the TOML that gapwatch reads beside the ONNX file."""
    mean = ", ".join(f"{value:.4f}" for value in normalisation.mean)
    std = ", ".join(f"{value:.4f}" for value in normalisation.std)
    taps = ", ".join(f'"{tap}"' for tap in TAPS)
    file.write_text(
        f'taps = [{taps}]\nlane = "lane"\nsize = "{size}"\nmean = [{mean}]\nstd = [{std}]\n',
        encoding="utf-8",
    )


def processor_name() -> str:
    """The CPU's model as the system names it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return " ".join(line.split(":", 1)[1].split())
    except OSError:
        pass
    return platform.processor() or platform.machine()
