"""Lane IoU and peak energies, of a network in training or of an exported file alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from network import TAPS, LaneNetwork
from scenes import Normalisation, SceneSet

# Encoder input [N, 3, H, W] to lane logits [N, 1, H, W] and, by name, taps [N, C, H/8, W/8].
Predict = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], dict[str, NDArray]]]


@dataclass(frozen=True)
class Measurement:
    """Counts per scene; everything reported is pooled from them.

    - `both`, `either`: `[N]`, pixels of the intersection and of the union of lane and answer
    - `peaks`: by tap, `[N]`, the largest energy of each scene
    """

    both: NDArray[np.int64]
    either: NDArray[np.int64]
    peaks: dict[str, NDArray[np.float64]]

    def iou(self) -> float:
        """Intersection over union of all pixels of all scenes; 0 when there is no lane at all."""
        return float(self.both.sum() / max(self.either.sum(), 1))

    def interval(self, rounds: int = 2000, seed: int = 0) -> tuple[float, float]:
        """95 % percentile interval of the IoU over `rounds` bootstraps of whole scenes."""
        dice = np.random.default_rng(seed)
        count = len(self.both)
        ious = np.empty(rounds)
        for index in range(rounds):
            drawn = dice.integers(0, count, count)
            ious[index] = self.both[drawn].sum() / max(self.either[drawn].sum(), 1)
        low, high = np.percentile(ious, (2.5, 97.5))
        return float(low), float(high)

    def median_peaks(self) -> dict[str, float]:
        """Median over the scenes of the peak energy, by tap."""
        return {tap: float(np.median(values)) for tap, values in self.peaks.items()}


def measure(
    predict: Predict, scenes: SceneSet, normalisation: Normalisation, batch: int
) -> Measurement:
    """Asks `predict` about all `scenes`, `batch` at a time. Lane is where the logit is above 0."""
    both, either = [], []
    peaks: dict[str, list[NDArray]] = {}
    for start in range(0, len(scenes), batch):
        logits, taps = predict(normalisation.apply(scenes.frames[start : start + batch]))
        answer = logits[:, 0] > 0
        lane = scenes.masks[start : start + batch] == 1
        both.append((answer & lane).sum(axis=(1, 2)))
        either.append((answer | lane).sum(axis=(1, 2)))
        for tap, values in taps.items():
            energies = np.square(values, dtype=np.float32).sum(axis=1)
            peaks.setdefault(tap, []).append(energies.max(axis=(1, 2)).astype(np.float64))
    return Measurement(
        np.concatenate(both),
        np.concatenate(either),
        {tap: np.concatenate(values) for tap, values in peaks.items()},
    )


def prediction_of(network: LaneNetwork) -> Predict:
    """The network as a `Predict`, in evaluation mode and fp32, on whatever device it lives."""
    device = next(network.parameters()).device

    def predict(inputs: NDArray[np.float32]) -> tuple[NDArray[np.float32], dict[str, NDArray]]:
        network.eval()
        with torch.inference_mode():
            image = torch.from_numpy(inputs).to(device)
            lane, blocks = network(image.contiguous(memory_format=torch.channels_last))
        return lane.cpu().numpy(), {tap: getattr(blocks, tap).cpu().numpy() for tap in TAPS}

    return predict


def best_lane_logit(
    predict: Predict, scenes: SceneSet, normalisation: Normalisation, batch: int
) -> float:
    """The logit above which calling a pixel lane gives the best pooled IoU on `scenes`."""
    edges = np.linspace(-6.0, 6.0, 241)
    lane_counts = np.zeros(len(edges) + 1)
    other_counts = np.zeros(len(edges) + 1)
    for start in range(0, len(scenes), batch):
        logits, _ = predict(normalisation.apply(scenes.frames[start : start + batch]))
        bins = np.digitize(logits[:, 0], edges)
        lane = scenes.masks[start : start + batch] == 1
        lane_counts += np.bincount(bins[lane], minlength=len(edges) + 1)
        other_counts += np.bincount(bins[~lane], minlength=len(edges) + 1)
    # Above edge k lie the bins k + 1 and up.
    hit = lane_counts[::-1].cumsum()[::-1][1:]
    false = other_counts[::-1].cumsum()[::-1][1:]
    ious = hit / np.maximum(lane_counts.sum() + false, 1)
    if ious.max() <= 0:
        return 0.0
    return float(edges[ious.argmax()])
