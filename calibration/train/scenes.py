"""Rendered scenes: made once by the gapwatch program, kept on disk, held in memory as bytes."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from variation import Variation

# Written last into a rendered set; a set without it was cut short and is rendered again.
NOTE = "rendered.json"


class SceneError(Exception):
    """Scenes could not be rendered or read; the message says what would mend it."""


@dataclass(frozen=True)
class Size:
    """Width and height in pixels; both multiples of 8, the encoder's stride."""

    width: int
    height: int

    @classmethod
    def parse(cls, text: str) -> Size:
        """From `WxH`. Raises `ValueError` on any other form."""
        try:
            width, height = (int(part) for part in text.lower().split("x"))
        except ValueError:
            raise ValueError(f"{text!r} is not a size; write it as 320x160") from None
        if width < 64 or height < 64 or width % 8 or height % 8:
            raise ValueError(f"{text}: width and height must be multiples of 8, 64 at least")
        return cls(width, height)

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True)
class SceneSet:
    """Scenes of one seed.

    - `frames`: uint8 `[N, H, W, 3]`, RGB
    - `masks`: uint8 `[N, H, W]`, 1 on a lane marking, 0 elsewhere
    """

    seed: int
    frames: NDArray[np.uint8]
    masks: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.frames)

    def first(self, count: int) -> SceneSet:
        """The first `count` scenes, or all where there are fewer."""
        return SceneSet(self.seed, self.frames[:count], self.masks[:count])

    def varied(self, variation: Variation, seed: int) -> SceneSet:
        """These scenes, varied; themselves where nothing is varied."""
        if variation.share == 0:
            return self
        dice = np.random.default_rng(seed)
        frames, masks = self.frames.copy(), self.masks.copy()
        for index in range(len(self)):
            image = torch.from_numpy(frames[index : index + 1]).permute(0, 3, 1, 2).float() / 255.0
            lane = torch.from_numpy(masks[index : index + 1]).unsqueeze(1).float()
            image, lane = variation.apply(image, lane, dice)
            frames[index] = (image[0] * 255.0).round().byte().permute(1, 2, 0).numpy()
            masks[index] = lane[0, 0].byte().numpy()
        return SceneSet(self.seed, frames, masks)

    def lane_share(self) -> float:
        """Share of pixels that lie on a marking, 0 to 1."""
        return float(self.masks.mean(dtype=np.float64))


@dataclass(frozen=True)
class Normalisation:
    """Mean and standard deviation per colour (R, G, B), of values scaled to 0..1."""

    mean: tuple[float, float, float]
    std: tuple[float, float, float]

    @classmethod
    def of(cls, scenes: SceneSet) -> Normalisation:
        """Measured on `scenes` and rounded to four digits, as written beside the model."""
        levels = np.arange(256) / 255.0
        mean, std = [], []
        for colour in range(3):
            counts = np.zeros(256)
            for frame in scenes.frames:
                counts += np.bincount(frame[..., colour].ravel(), minlength=256)
            share = counts / counts.sum()
            middle = float(share @ levels)
            mean.append(round(middle, 4))
            std.append(max(round(float(share @ (levels - middle) ** 2) ** 0.5, 4), 0.01))
        return cls(tuple(mean), tuple(std))

    def apply(self, frames: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Encoder input `[N, 3, H, W]` of `frames` `[N, H, W, 3]`."""
        mean = np.asarray(self.mean, np.float32)
        std = np.asarray(self.std, np.float32)
        inputs = (frames.astype(np.float32) / np.float32(255.0) - mean) / std
        return np.ascontiguousarray(inputs.transpose(0, 3, 1, 2))


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class World:
    """What scenes are rendered of: a look, and the elements left out of it."""

    look: str = "sim"
    without: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "-without-".join((self.look, *self.without))


def render(
    program: Path, folder: Path, seed: int, count: int, size: Size, world: World
) -> Path:
    """Renders `count` scenes below `folder`, or finds them there; returns the set's own folder.

    A set is used again only when it is complete and came from the same program (by SHA-256), seed,
    count, size and world.
    """
    wanted = {
        "program_sha256": sha256_of(program),
        "seed": seed,
        "count": count,
        "size": str(size),
        "world": str(world),
    }
    target = folder / f"{world}-{size}-seed{seed}-{count}"
    if _note(target) == wanted and _count(target) == (count, count):
        print(f"scenes  {target}: {count} of seed {seed}, rendered earlier", flush=True)
        return target
    shutil.rmtree(target, ignore_errors=True)
    command = [str(program), "scene", "--out", str(target), "--count", str(count)]
    command += ["--seed", str(seed), "--size", str(size), "--look", world.look]
    command += [word for element in world.without for word in ("--without", element)]
    print(f"scenes  {target}: rendering {count} of seed {seed}", flush=True)
    try:
        done = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    except OSError as error:
        raise SceneError(f"{program} could not be run: {error}") from error
    if done.returncode != 0:
        raise SceneError(f"`{' '.join(command)}` ended with exit code {done.returncode}")
    if _count(target) != (count, count):
        frames, masks = _count(target)
        raise SceneError(
            f"{target}: {frames} frames and {masks} masks after rendering, {count} wanted"
        )
    (target / NOTE).write_text(json.dumps(wanted, indent=1) + "\n")
    return target


def load(folder: Path, seed: int, size: Size, threads: int) -> SceneSet:
    """All PNG files of a rendered set as one array; `SceneError` names the first bad file."""
    files = sorted((folder / "frames").glob("*.png"))
    frames = np.empty((len(files), size.height, size.width, 3), np.uint8)
    masks = np.empty((len(files), size.height, size.width), np.uint8)

    def read(index: int) -> None:
        frame_file = files[index]
        mask_file = folder / "masks" / frame_file.name
        frame = _pixels(frame_file, "RGB", size)
        mask = _pixels(mask_file, "L", size)
        if not np.isin(mask, (0, 255)).all():
            raise SceneError(f"{mask_file}: a mask holds 0 and 255 alone")
        frames[index] = frame
        masks[index] = mask == 255

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(read, range(len(files))):
            pass
    return SceneSet(seed, frames, masks)


def refuse_shared_frames(training: SceneSet, *unseen: SceneSet) -> None:
    """`SceneError` when a frame of an unseen set is one of the training frames."""
    known = {hashlib.blake2b(frame.tobytes()).digest() for frame in training.frames}
    for scenes in unseen:
        same = sum(hashlib.blake2b(frame.tobytes()).digest() in known for frame in scenes.frames)
        if same:
            raise SceneError(
                f"{same} of {len(scenes)} frames of seed {scenes.seed} are also frames of seed "
                f"{training.seed}: seeds must not share scenes, or the measured IoU means nothing"
            )


@dataclass(frozen=True)
class Batch:
    """Normalised RGB `[N, 3, H, W]` (channels last in memory) and lane `[N, 1, H, W]`, 0 or 1."""

    image: Tensor
    lane: Tensor


def training_batches(
    scenes: SceneSet,
    normalisation: Normalisation,
    size: int,
    jitter: float,
    variation: Variation,
    dice: np.random.Generator,
    device: torch.device,
) -> Iterator[Batch]:
    """One pass over `scenes` in random order, batches of `size`, the odd rest left out.

    Half of the scenes are mirrored, and a share is varied (`variation.py`). Brightness, contrast and
    the balance of colours move by up to `jitter` (0.1 = 10 %). No fog, night, rain, dirt or glare:
    they are what gapwatch is to detect, so the network must not be taught to ignore them.
    """
    mean = np.asarray(normalisation.mean, np.float32)
    std = np.asarray(normalisation.std, np.float32)
    order = dice.permutation(len(scenes))
    size = min(size, len(scenes))
    for start in range(0, len(order) - size + 1, size):
        chosen = np.sort(order[start : start + size])
        frames = scenes.frames[chosen]
        masks = scenes.masks[chosen]
        mirrored = dice.random(size) < 0.5
        frames[mirrored] = frames[mirrored, :, ::-1]
        masks[mirrored] = masks[mirrored, :, ::-1]
        # value = gain * level + shift, and normalisation on top: one multiply-add a pixel.
        gain = 1.0 + dice.uniform(-jitter, jitter, (size, 1)) / 2
        gain = gain * (1.0 + dice.uniform(-jitter, jitter, (size, 3)) / 2)
        shift = dice.uniform(-jitter, jitter, (size, 1)) / 2
        scale = torch.from_numpy((gain / (255.0 * std)).astype(np.float32))
        offset = torch.from_numpy(((shift - mean) / std).astype(np.float32))
        image = torch.from_numpy(frames).to(device).permute(0, 3, 1, 2).float()
        lane = torch.from_numpy(masks).to(device).unsqueeze(1).float()
        if variation.share > 0:
            varied, lane = variation.apply(image / 255.0, lane, dice)
            image = varied * 255.0
        image.mul_(scale.to(device)[:, :, None, None]).add_(offset.to(device)[:, :, None, None])
        yield Batch(image, lane)


def ahead(batches: Iterator[Batch]) -> Iterator[Batch]:
    """The same batches; the next one is made while one is trained on."""
    with ThreadPoolExecutor(1) as pool:
        following = pool.submit(next, batches, None)
        while (batch := following.result()) is not None:
            following = pool.submit(next, batches, None)
            yield batch


def _note(folder: Path) -> object:
    try:
        return json.loads((folder / NOTE).read_text())
    except (OSError, ValueError):
        return None


def _count(folder: Path) -> tuple[int, int]:
    return (
        sum(1 for _ in (folder / "frames").glob("*.png")),
        sum(1 for _ in (folder / "masks").glob("*.png")),
    )


def _pixels(file: Path, mode: str, size: Size) -> NDArray[np.uint8]:
    try:
        with Image.open(file) as image:
            if image.mode != mode or image.size != (size.width, size.height):
                raise SceneError(
                    f"{file}: {image.mode} {image.size[0]}x{image.size[1]}, wanted {mode} {size}"
                )
            return np.asarray(image)
    except OSError as error:
        raise SceneError(f"{file}: {error}") from error
