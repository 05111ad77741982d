"""Variations of rendered scenes, so that a lane model trained on them meets real roads better.

Each variation is something that real roads, lights and cameras have and the rendered world has not: other cameras and
curves, hard shade, what stands beside roads, walls along them, other light, exposure and colour, and a lens and sensor
that are not perfect. All are made of random numbers alone: no real picture is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

# Row of the rendered horizon, as a share of the height; rows above it show no road.
HORIZON = 0.44
# Octaves of a random field, each with twice the detail and this share of the one before it.
OCTAVES = 4
ROUGHNESS = 0.6
# Encoded levels to linear light and back.
GAMMA = 2.2


# What can be varied, and how many of the varied scenes it changes.
KINDS = {"camera": 0.8, "clutter": 0.6, "barrier": 0.4, "shade": 0.6, "light": 0.8, "lens": 0.35}


@dataclass(frozen=True)
class Variation:
    """Which share of the scenes is varied (0 to 1), and in which of the `KINDS`."""

    share: float
    kinds: tuple[str, ...]

    def apply(self, images: Tensor, lanes: Tensor, dice: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Varied copies of `images` `[N, 3, H, W]` (0 to 1) and `lanes` `[N, 1, H, W]` (0 or 1)."""
        images, lanes = images.clone(), lanes.clone()
        for index in np.flatnonzero(dice.random(len(images)) < self.share):
            image, lane = images[index], lanes[index]
            if self._happens("camera", dice):
                image, lane = another_camera(image, lane, dice)
            if self._happens("clutter", dice):
                image = clutter(image, lane, dice)
            if self._happens("barrier", dice):
                image = barrier(image, lane, dice)
            if self._happens("shade", dice):
                image = shade(image, dice)
            if self._happens("light", dice):
                image = light(image, dice)
            if self._happens("lens", dice):
                image = lens(image, dice)
            images[index], lanes[index] = image.clamp(0, 1), lane
        return images, lanes

    def _happens(self, kind: str, dice: np.random.Generator) -> bool:
        return kind in self.kinds and bool(dice.random() < KINDS[kind])


def another_camera(image: Tensor, lane: Tensor, dice: np.random.Generator) -> tuple[Tensor, Tensor]:
    """As another camera sees it: focal lengths of 0.70 to 1.35 and 0.70 to 1.42 times, vanishing point moved by up to a
    fifth of the width and a thirteenth of the height, rolled (2 degrees), on a road with another curve."""
    height, width = image.shape[-2:]
    scale_x = math.exp(dice.uniform(-0.35, 0.30))
    scale_y = math.exp(dice.uniform(-0.35, 0.35))
    middle_x = width * (0.5 + dice.uniform(-0.19, 0.19))
    middle_y = height * (HORIZON + dice.uniform(-0.075, 0.075))
    roll = math.radians(dice.normal(0, 2.0))
    curve = width * dice.normal(0, 0.11) if dice.random() < 0.6 else 0.0
    rows = torch.arange(height, device=image.device, dtype=torch.float32)[:, None] + 0.5
    columns = torch.arange(width, device=image.device, dtype=torch.float32)[None, :] + 0.5
    across, down = columns - middle_x, rows - middle_y
    # Nothing moves at the foot of the picture, and everything above the horizon moves alike.
    far = 1.0 - (down / (height - middle_y)).clamp(0, 1)
    across = across - curve * far.square()
    turned_x = across * math.cos(roll) + down * math.sin(roll)
    turned_y = down * math.cos(roll) - across * math.sin(roll)
    source_x = width / 2 + turned_x / scale_x
    source_y = height * HORIZON + turned_y / scale_y
    grid = torch.stack((2 * source_x / width - 1, 2 * source_y / height - 1), dim=-1)[None]
    # What the rendered picture does not show is filled from its edge, and nothing there is a lane.
    seen = F.grid_sample(image[None], grid, "bilinear", "border", align_corners=False)
    labels = F.grid_sample(lane[None], grid, "nearest", "zeros", align_corners=False)
    return seen[0], labels[0]


def clutter(image: Tensor, lane: Tensor, dice: np.random.Generator) -> Tensor:
    """With textures, poles and beams above and beside the road, never near a lane."""
    height, width = image.shape[-2:]
    free = F.max_pool2d(lane[None], 9, 1, 4)[0] == 0
    with_lane = torch.nonzero(lane[0].any(dim=1))
    top = int(with_lane[0]) if len(with_lane) else height // 2
    rows = torch.arange(height, device=image.device)[None, :, None]
    field = random_field(height, width, dice.uniform(4, 24), dice).to(image.device)
    contrast = dice.uniform(2, 8)
    mixed = ((field - 0.5) * contrast + 0.5).clamp(0, 1)
    one, other = (
        torch.tensor(dice.random(3) * 0.8, dtype=torch.float32, device=image.device)[:, None, None]
        for _ in range(2)
    )
    patches = random_field(height, width, dice.uniform(2, 6), dice).to(image.device)
    where = (patches > dice.uniform(0.35, 0.7)) & free & (rows < top + height * dice.uniform(-0.06, 0.25))
    image = torch.where(where, one + (other - one) * mixed, image)
    for _ in range(dice.integers(0, 4)):
        start = np.array([dice.uniform(0, width), dice.uniform(0, top + height / 8)])
        along = np.array([dice.normal(0, width / 13), dice.normal(0, height / 4)])
        beam = near_line(height, width, start, along, dice.uniform(0.5, 3.0)).to(image.device)
        colour = torch.tensor(dice.random(3), dtype=torch.float32, device=image.device)
        image = torch.where(beam & free, colour[:, None, None], image)
    return image


def barrier(image: Tensor, lane: Tensor, dice: np.random.Generator) -> Tensor:
    """With a wall or a kerb along one side of the road, whose foot is a line towards the vanishing point that is no lane."""
    height, width = image.shape[-2:]
    there = torch.nonzero(lane[0])
    if len(there) == 0:
        return image
    top = there[:, 0].min()
    middle_x = there[there[:, 0] <= top + 1, 1].float().mean() + 0.5
    middle_y = float(top) - dice.uniform(0, 4)
    side = 1.0 if dice.random() < 0.5 else -1.0
    rows = torch.arange(height, device=image.device, dtype=torch.float32)[:, None] + 0.5
    columns = torch.arange(width, device=image.device, dtype=torch.float32)[None, :] + 0.5
    out = (columns - middle_x) * side
    angle = torch.atan2(rows - middle_y, out)
    # The outermost line on that side bounds the foot; near the vanishing point all lines are close together.
    lines = angle[(lane[0] > 0) & (rows > middle_y + height / 8) & (out > 0)]
    limit = float(lines.min()) if len(lines) else 0.6
    foot = limit * dice.uniform(0.3, 0.95)
    head = foot * dice.uniform(-0.6, 0.85)
    free = F.max_pool2d(lane[None], 5, 1, 2)[0] == 0
    where = ((angle < foot) & (angle > head) & (out > 0))[None] & free
    colour = torch.tensor(dice.random(3) * 0.2 + dice.uniform(0.0, 0.75), dtype=torch.float32, device=image.device)
    field = random_field(height, width, dice.uniform(2, 12), dice).to(image.device)
    face = colour[:, None, None] * (1 + dice.uniform(0, 0.6) * (field - 0.5))
    return torch.where(where, face, image)


def shade(image: Tensor, dice: np.random.Generator) -> Tensor:
    """Under shadows of any size, soft or hard, that take 30 to 92 % of the light, and are bluer than it. Every third time,
    almost the whole road is in one shadow, as in a forest, which takes 75 to 98.5 %."""
    height, width = image.shape[-2:]
    field = random_field(height, width, dice.uniform(1.5, 10), dice).to(image.device)
    taken = dice.uniform(0.3, 0.92)
    if dice.random() < 1 / 3:
        rows = torch.arange(height, device=image.device)[None, :, None] / height
        field = field * 0.6 + (rows - HORIZON + dice.uniform(-0.05, 0.3)) * dice.uniform(2, 8)
        taken = 1 - math.exp(dice.uniform(math.log(0.015), math.log(0.25)))
    dark = ((field - dice.uniform(0.3, 0.65)) * dice.uniform(3, 30)).clamp(0, 1)
    kept = (1 - taken * dark).repeat(3, 1, 1)
    kept[2] = kept[2] * (1 + 0.25 * dice.random() * dark[0])
    return (image.clamp(min=0).pow(GAMMA) * kept).clamp(min=0).pow(1 / GAMMA)


def light(image: Tensor, dice: np.random.Generator) -> Tensor:
    """In another light: gamma 0.55 to 2.2, exposure 0.55 to 1.42, colours by 17 %, black by 6 %, and sometimes paler."""
    gamma = math.exp(dice.uniform(-0.6, 0.8))
    gain = math.exp(dice.uniform(-0.6, 0.35)) * np.exp(dice.uniform(-0.18, 0.18, 3))
    gain = torch.tensor(gain, dtype=torch.float32, device=image.device)[:, None, None]
    image = image.clamp(0, 1).pow(gamma) * gain + dice.uniform(-0.06, 0.06)
    if dice.random() < 0.3:
        grey = image.mean(dim=0, keepdim=True)
        image = grey + (image - grey) * dice.uniform(0.2, 1.2)
    return image


def lens(image: Tensor, dice: np.random.Generator) -> Tensor:
    """Through a lens and a sensor that are not perfect: blurred by 0.3 to 0.9 pixels, noise of 0.003 to 0.02."""
    noise = torch.from_numpy(dice.standard_normal(image.shape, np.float32)).to(image.device)
    return soften(image, dice.uniform(0.3, 0.9)) + noise * dice.uniform(0.003, 0.02)


def soften(image: Tensor, sigma: float) -> Tensor:
    """Blurred with a standard deviation of `sigma` pixels."""
    reach = torch.arange(-3, 4, device=image.device, dtype=torch.float32)
    weights = torch.exp(-0.5 * (reach / sigma) ** 2)
    weights = (weights / weights.sum()).repeat(3, 1)
    padded = F.pad(image[None], (3, 3, 3, 3), mode="reflect")
    rows = F.conv2d(padded, weights[:, None, None, :], groups=3)
    return F.conv2d(rows, weights[:, None, :, None], groups=3)[0]


def random_field(height: int, width: int, detail: float, dice: np.random.Generator) -> Tensor:
    """A smooth random field `[1, H, W]`, 0 to 1, with about `detail` blobs from top to bottom."""
    field = torch.zeros(1, 1, height, width)
    for octave in range(OCTAVES):
        cells = detail * 2**octave
        down, across = max(2, int(cells)), max(2, int(cells * width / height))
        coarse = torch.from_numpy(dice.random((1, 1, down, across), np.float32))
        fine = F.interpolate(coarse, (height, width), mode="bicubic", align_corners=False)
        field = field + ROUGHNESS**octave * fine
    low, high = field.amin(), field.amax()
    return ((field - low) / (high - low + 1e-6))[0]


def near_line(
    height: int, width: int, start: np.ndarray, along: np.ndarray, half: float
) -> Tensor:
    """Pixels `[1, H, W]` that lie within `half` pixels of a line from `start` (x, y) along `along`."""
    rows = torch.arange(height, dtype=torch.float32)[:, None] + 0.5 - float(start[1])
    columns = torch.arange(width, dtype=torch.float32)[None, :] + 0.5 - float(start[0])
    x, y = float(along[0]), float(along[1])
    share = ((columns * x + rows * y) / (x * x + y * y + 1e-9)).clamp(0, 1)
    return ((columns - share * x).square() + (rows - share * y).square() <= half * half)[None]
