"""The lane networks: an ENet-SAD encoder, a lite and a small one, and a lane head on top.

Shapes are `[N, C, H, W]`. The encoder hands back four blocks: `e1` at a quarter of the input in
each direction, `e2`, `e3`, `e4` at an eighth; each is the block's output after its ReLU. gapwatch
looks at `e2`, `e3`, `e4`; the lane head looks at some of the four and gives one logit a pixel.

Every convolution is followed by a batch norm (`ConvBn`), so that `fold_batch_norms` can absorb all
of them before export. The activation is ReLU throughout: PReLU costs an interpreter three passes.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

MODELS = ("lite", "small", "enet-sad")
HEADS = ("plain", "deep")
TAPS = ("e2", "e3", "e4")

# First gain of the batch norm that ends each residual branch. Below 1 it keeps the sum over a
# chain of bottlenecks small, and training starts faster: chosen by trial.
RESIDUAL_GAIN = 0.25
# Cells, in each direction, over which `relative` takes its mean, and what keeps it from dividing by nothing.
SURROUNDINGS = 9
RELATIVE_FLOOR = 1e-4
# Median peak energy that `set_tap_gains` gives every tap. The published attention is a softmax at a
# temperature of 10; it keeps a usable number of pixels where 10 is about a fifth of the peak.
PEAK_ENERGY = 50.0


class Blocks(NamedTuple):
    """Outputs of the encoder's four blocks: `e1` `[N, C1, H/4, W/4]`, others `[N, C, H/8, W/8]`."""

    e1: Tensor
    e2: Tensor
    e3: Tensor
    e4: Tensor


class ConvBn(nn.Module):
    """Convolution, batch norm and, unless `relu=False`, a ReLU. Padding keeps `size / stride`."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        kernel: int | tuple[int, int] = 3,
        stride: int = 1,
        dilation: int = 1,
        padding: int | None = None,
        relu: bool = True,
    ) -> None:
        super().__init__()
        kernel = (kernel, kernel) if isinstance(kernel, int) else kernel
        same = tuple(dilation * (k // 2) for k in kernel)
        self.conv = nn.Conv2d(
            inputs,
            outputs,
            kernel,
            stride,
            same if padding is None else padding,
            dilation,
            bias=False,
        )
        self.norm: nn.Module = nn.BatchNorm2d(outputs)
        self.relu: nn.Module = nn.ReLU(inplace=True) if relu else nn.Identity()
        nn.init.kaiming_normal_(self.conv.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        return self.relu(self.norm(self.conv(x)))

    def fold(self) -> None:
        """Absorbs the batch norm into the convolution. Evaluation mode only."""
        if isinstance(self.norm, nn.BatchNorm2d):
            self.conv = fuse_conv_bn_eval(self.conv, self.norm)
            self.norm = nn.Identity()


class Bottleneck(nn.Module):
    """1x1 to `inner` channels, one spatial convolution, 1x1 back, added to the input, ReLU.

    The spatial convolution is a dilated 3x3, or a 5x1 followed by a 1x5 when `asymmetric`.
    """

    def __init__(
        self, channels: int, inner: int, dilation: int = 1, asymmetric: bool = False
    ) -> None:
        super().__init__()
        spatial = (
            [ConvBn(inner, inner, (5, 1)), ConvBn(inner, inner, (1, 5))]
            if asymmetric
            else [ConvBn(inner, inner, 3, dilation=dilation)]
        )
        last = ConvBn(inner, channels, 1, relu=False)
        nn.init.constant_(last.norm.weight, RESIDUAL_GAIN)
        self.branch = nn.Sequential(ConvBn(channels, inner, 1), *spatial, last)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, x: Tensor) -> Tensor:
        return self.relu(x + self.branch(x))


class LiteEncoder(nn.Module):
    """Half of ENet-SAD's channels, half of its bottlenecks, nothing but convolutions and sums.

    Stride-2 3x3 convolutions shrink (no pooling, no concatenation, no padding of channels), and
    every channel count is a multiple of 16.
    """

    channels = (32, 64)
    head_width = 32

    def __init__(self, share_weights: bool = False) -> None:
        super().__init__()
        quarter, eighth = self.channels
        self.e1 = nn.Sequential(
            ConvBn(3, 16, 3, stride=2),
            ConvBn(16, quarter, 3, stride=2),
            Bottleneck(quarter, 16),
            Bottleneck(quarter, 16),
        )
        self.down = ConvBn(quarter, eighth, 3, stride=2)
        blocks = [self._block(eighth) for _ in TAPS]
        if share_weights:
            share_convolutions(blocks)
        self.e2, self.e3, self.e4 = blocks

    @staticmethod
    def _block(channels: int) -> nn.Sequential:
        return nn.Sequential(*(Bottleneck(channels, channels // 4, d) for d in (1, 2, 4, 8)))

    def forward(self, image: Tensor) -> Blocks:
        e1 = self.e1(image)
        e2 = self.e2(self.down(e1))
        e3 = self.e3(e2)
        return Blocks(e1, e2, e3, self.e4(e3))


class SmallEncoder(nn.Module):
    """A quarter of ENet-SAD's channels, three bottlenecks a block.

    The stem cuts the picture into patches of 4x4 pixels: its windows do not overlap, so an inference
    engine that unrolls windows into columns copies every pixel once and not nine times.
    """

    channels = (16, 32)
    head_width = 16

    def __init__(self, share_weights: bool = False) -> None:
        super().__init__()
        quarter, eighth = self.channels
        self.e1 = nn.Sequential(
            ConvBn(3, quarter, 4, stride=4, padding=0), Bottleneck(quarter, quarter)
        )
        self.down = ConvBn(quarter, eighth, 3, stride=2)
        blocks = [
            nn.Sequential(*(Bottleneck(eighth, eighth // 2, d) for d in (1, 2, 4))) for _ in TAPS
        ]
        if share_weights:
            share_convolutions(blocks)
        self.e2, self.e3, self.e4 = blocks

    def forward(self, image: Tensor) -> Blocks:
        e1 = self.e1(image)
        e2 = self.e2(self.down(e1))
        e3 = self.e3(e2)
        return Blocks(e1, e2, e3, self.e4(e3))


class Initial(nn.Module):
    """ENet's first layer: 3x3 stride 2 to 13 channels beside a 3x3 max pooling of the 3 colours."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = ConvBn(3, 13, 3, stride=2, relu=False)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, image: Tensor) -> Tensor:
        return self.relu(torch.cat((self.conv(image), self.pool(image)), dim=1))


class Downsampling(nn.Module):
    """ENet's shrinking bottleneck: max pooling, channels filled up with zeros, plus a branch."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        inner = inputs // 4
        last = ConvBn(inner, outputs, 1, relu=False)
        self.branch = nn.Sequential(
            ConvBn(inputs, inner, 2, stride=2, padding=0), ConvBn(inner, inner, 3), last
        )
        self.pool = nn.MaxPool2d(2)
        self.missing = outputs - inputs
        self.relu = nn.ReLU(inplace=True)

    def forward(self, x: Tensor) -> Tensor:
        main = F.pad(self.pool(x), (0, 0, 0, 0, 0, self.missing))
        return self.relu(main + self.branch(x))


class EnetSadEncoder(nn.Module):
    """ENet-SAD's encoder after Hou et al., ICCV 2019.

    E1: 64 channels at stride 4, four bottlenecks. E2, E3, E4: 128 channels at stride 8, eight
    bottlenecks each. With `share_weights`, as published, E2 to E4 use the same convolutions; each
    block then still keeps batch norms of its own, because the statistics of the three differ.

    Left out: dropout (the scenes are endless) and the pooling indices for MaxUnpool (the lane head
    here does not unpool). ReLU in place of PReLU.
    """

    channels = (64, 128)
    head_width = 32

    def __init__(self, share_weights: bool = True) -> None:
        super().__init__()
        quarter, eighth = self.channels
        self.e1 = nn.Sequential(
            Initial(),
            Downsampling(16, quarter),
            *(Bottleneck(quarter, quarter // 4) for _ in range(4)),
        )
        self.down = Downsampling(quarter, eighth)
        blocks = [self._block(eighth) for _ in TAPS]
        if share_weights:
            share_convolutions(blocks)
        self.e2, self.e3, self.e4 = blocks

    @staticmethod
    def _block(channels: int) -> nn.Sequential:
        inner = channels // 4
        return nn.Sequential(
            Bottleneck(channels, inner),
            Bottleneck(channels, inner, dilation=2),
            Bottleneck(channels, inner, asymmetric=True),
            Bottleneck(channels, inner, dilation=4),
            Bottleneck(channels, inner),
            Bottleneck(channels, inner, dilation=8),
            Bottleneck(channels, inner, asymmetric=True),
            Bottleneck(channels, inner, dilation=16),
        )

    def forward(self, image: Tensor) -> Blocks:
        e1 = self.e1(image)
        e2 = self.e2(self.down(e1))
        e3 = self.e3(e2)
        return Blocks(e1, e2, e3, self.e4(e3))


class LaneHead(nn.Module):
    """Lane logits from `e1` and `e4`: `[N, 1, H, W]`, positive where a marking is seen.

    `e4` is brought to a quarter of the input, added to `e1`, and two 3x3 convolutions predict the
    4x4 pixels of each cell at once (depth to space). A bilinear enlargement of one logit a cell
    cannot draw the markings far ahead, which are one or two pixels wide.
    """

    def __init__(self, quarter: int, eighth: int, width: int) -> None:
        super().__init__()
        self.near = ConvBn(quarter, width, 1, relu=False)
        self.far = ConvBn(eighth, width, 1, relu=False)
        self.relu = nn.ReLU(inplace=True)
        self.mix = ConvBn(width, width, 3)
        self.logits = nn.Conv2d(width, 16, 3, padding=1)
        self.unfold = nn.PixelShuffle(4)
        nn.init.constant_(self.logits.bias, -3.0)  # about the share of marking pixels

    def forward(self, blocks: Blocks) -> Tensor:
        far = F.interpolate(
            self.far(blocks.e4), scale_factor=2.0, mode="bilinear", align_corners=False
        )
        return self.unfold(self.logits(self.mix(self.relu(self.near(blocks.e1) + far))))

    def lower(self, logit: float) -> None:
        """Takes `logit` off every pixel's answer, which moves the point where lane begins."""
        with torch.no_grad():
            self.logits.bias -= logit


class DeepLaneHead(LaneHead):
    """A lane head that looks at all four blocks, half as wide again, with four dilated bottlenecks before its last
    convolutions.

    It learns to find lanes in light and on roads that its encoder was not trained on: the encoder can
    stay as it is, so that what gapwatch sees through it stays the same. What lies in shade excites the
    encoder little; so the head looks at blocks relative to their surroundings (`relative`), and at `e1` as
    it is too.
    """

    def __init__(self, quarter: int, eighth: int, width: int) -> None:
        width += width // 2
        super().__init__(quarter, eighth, width)
        self.near = ConvBn(2 * quarter, width, 1, relu=False)
        self.far = ConvBn(len(TAPS) * eighth, width, 1, relu=False)
        self.body = nn.Sequential(*(Bottleneck(width, width // 2, d) for d in (1, 2, 4, 8)))

    def forward(self, blocks: Blocks) -> Tensor:
        near = self.near(torch.cat((blocks.e1, relative(blocks.e1)), dim=1))
        far = self.far(torch.cat([relative(block) for block in blocks[1:]], dim=1))
        far = F.interpolate(far, scale_factor=2.0, mode="bilinear", align_corners=False)
        return self.unfold(self.logits(self.mix(self.body(self.relu(near + far)))))


def relative(block: Tensor) -> Tensor:
    """Activations over the root mean square of all channels in the surrounding `SURROUNDINGS` cells."""
    square = block.square().mean(dim=1, keepdim=True)
    mean = F.avg_pool2d(square, SURROUNDINGS, 1, SURROUNDINGS // 2, count_include_pad=False)
    return block / (mean + RELATIVE_FLOOR).sqrt()


class LaneNetwork(nn.Module):
    """Encoder and lane head. Input: normalised RGB `[N, 3, H, W]`, H and W multiples of 8."""

    def __init__(self, model: str, share_weights: bool | None = None, head: str = "plain") -> None:
        """`share_weights=None` takes what the model is usually built with."""
        super().__init__()
        kinds = {"lite": LiteEncoder, "small": SmallEncoder, "enet-sad": EnetSadEncoder}
        if model not in kinds:
            raise ValueError(f"no model named {model!r}; there are {', '.join(MODELS)}")
        self.share_weights = (model == "enet-sad") if share_weights is None else share_weights
        self.encoder = kinds[model](self.share_weights)
        heads = {"plain": LaneHead, "deep": DeepLaneHead}
        if head not in heads:
            raise ValueError(f"no lane head named {head!r}; there are {', '.join(HEADS)}")
        self.head = heads[head](*self.encoder.channels, self.encoder.head_width)
        # Factors on the activations of e2, e3, e4 as they leave the network, not as it uses them.
        self.register_buffer("tap_gains", torch.ones(len(TAPS)))

    def forward(self, image: Tensor) -> tuple[Tensor, Blocks]:
        """Lane logits `[N, 1, H, W]` and the encoder's blocks, those of the taps times their gains."""
        blocks = self.encoder(image)
        taps = (block * gain for block, gain in zip(blocks[1:], self.tap_gains, strict=True))
        return self.head(blocks), Blocks(blocks.e1, *taps)

    def set_tap_gains(self, median_peaks: dict[str, float]) -> None:
        """Scales every tap so that a median peak energy as measured becomes `PEAK_ENERGY`."""
        for index, tap in enumerate(TAPS):
            self.tap_gains[index] *= (PEAK_ENERGY / median_peaks[tap]) ** 0.5


class ExportedNetwork(nn.Module):
    """The outputs of the exported file in their order: lane logits, then the taps."""

    def __init__(self, network: LaneNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        lane, blocks = self.network(image)
        return lane, blocks.e2, blocks.e3, blocks.e4


def freeze_encoder(network: LaneNetwork) -> None:
    """Takes the encoder out of training, its batch norms in its convolutions, as an exported file has it."""
    network.eval()
    for module in network.encoder.modules():
        if isinstance(module, ConvBn):
            module.fold()
    network.encoder.requires_grad_(False)


def share_convolutions(blocks: list[nn.Sequential]) -> None:
    """Makes all blocks use the first one's convolutions; batch norms stay their own."""
    first = [m for m in blocks[0].modules() if isinstance(m, ConvBn)]
    for block in blocks[1:]:
        for own, shared in zip(
            (m for m in block.modules() if isinstance(m, ConvBn)), first, strict=True
        ):
            own.conv = shared.conv


def fold_batch_norms(network: LaneNetwork) -> LaneNetwork:
    """A copy for evaluation, on the CPU, in fp32, with its batch norms in the convolutions."""
    folded = copy.deepcopy(network).cpu().float().eval().to(memory_format=torch.contiguous_format)
    for module in list(folded.modules()):
        if isinstance(module, ConvBn):
            module.fold()
    return folded


def count_parameters(module: nn.Module) -> int:
    """Trainable numbers, shared ones once."""
    return sum(p.numel() for p in module.parameters())


def count_multiply_adds(module: nn.Module, width: int, height: int) -> int:
    """Multiply-adds of all convolutions for one image of `width` x `height` pixels."""
    total = 0

    def count(conv: nn.Conv2d, _inputs: tuple[Tensor, ...], output: Tensor) -> None:
        nonlocal total
        total += output[0].numel() * conv.weight[0].numel()

    module = copy.deepcopy(module).cpu().float().eval()
    # A shared convolution is one module called several times, and its hook counts each call.
    convolutions = [m for m in module.modules() if isinstance(m, nn.Conv2d)]
    hooks = [m.register_forward_hook(count) for m in convolutions]
    with torch.no_grad():
        module(torch.zeros(1, 3, height, width))
    for hook in hooks:
        hook.remove()
    return total
