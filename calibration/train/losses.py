"""What training minimises: the lane loss, and the distillation of attention between blocks."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from network import Blocks

# Markings are about 4 % of the pixels; a missed one counts this many times a false one.
LANE_WEIGHT = 2.0
# Temperature of the attention softmax as a share of each map's own peak: gapwatch's own.
ATTENTION_TEMPERATURE = 0.2


def lane_loss(logits: Tensor, lane: Tensor) -> Tensor:
    """Weighted binary cross entropy plus one minus the soft IoU of the whole batch.

    - `logits`: `[N, 1, H, W]`
    - `lane`: `[N, 1, H, W]`, 1 on a marking, 0 elsewhere

    The soft IoU is pooled over the batch, as the measured IoU is pooled over all scenes.
    """
    logits = logits.float()
    weight = torch.tensor(LANE_WEIGHT, device=logits.device)
    entropy = F.binary_cross_entropy_with_logits(logits, lane, pos_weight=weight)
    seen = torch.sigmoid(logits)
    both = (seen * lane).sum()
    either = seen.sum() + lane.sum() - both
    return 4.0 * entropy + 1.0 - (both + 1.0) / (either + 1.0)


def energy(activation: Tensor) -> Tensor:
    """Sum over the channels of the squared activation: `[N, C, h, w]` to `[N, 1, h, w]`."""
    return activation.float().square().sum(dim=1, keepdim=True)


def attention(energies: Tensor) -> Tensor:
    """Spatial softmax of energy maps `[N, 1, h, w]`, times the count of cells, so its mean is 1.

    Each map is first divided by its own peak times `ATTENTION_TEMPERATURE`. Energies of a trained
    network run into the thousands, and a softmax of them as they are puts all of its mass on one
    cell; divided so, the coldest cell still gets exp(-5) of the hottest one's share.
    """
    flat = energies.flatten(1)
    peak = flat.amax(dim=1, keepdim=True).detach()
    scaled = flat / (ATTENTION_TEMPERATURE * peak + 1e-12)
    return (F.softmax(scaled, dim=1) * flat.shape[1]).view_as(energies)


def distillation_loss(blocks: Blocks) -> Tensor:
    """Self-attention distillation: E1 learns from E2, E2 from E3, E3 from E4 (Hou et al. 2019).

    The sum of the three mean squared differences of attention. The teaching map is enlarged
    bilinearly where it is the smaller one (E2 for E1) and receives no gradient. Because attention
    is counted in multiples of its mean, the value does not depend on the size of the maps. It comes
    to 3 to 6 in practice, against a lane loss of 0.2: hence the small weight in `train.py`.
    """
    total = torch.zeros((), device=blocks.e1.device)
    for pupil, teacher in zip(blocks[:-1], blocks[1:], strict=True):
        learned = energy(pupil)
        taught = energy(teacher.detach())
        if taught.shape[-2:] != learned.shape[-2:]:
            taught = F.interpolate(
                taught, size=learned.shape[-2:], mode="bilinear", align_corners=False
            )
        total = total + F.mse_loss(attention(learned), attention(taught))
    return total
