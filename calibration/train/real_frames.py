"""Real frames with lane lines drawn by hand: the judge of what training on rendered scenes is worth.

The pictures are not part of the project. `real_lanes.json` names them below a folder that the
environment variable GAPWATCH_FIELD names, and holds the lines in pixels of the pictures.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from evaluation import Predict
from scenes import Normalisation, SceneError, Size

LINES = Path(__file__).resolve().parents[1] / "real_lanes.json"
# The set of the studies: pictures of one highway.
SET = "california_highway stills"
# Half the width of a label, pixels in a picture 320 wide: that of the rendered scenes' labels.
HALF_WIDTH = 2.0


@dataclass(frozen=True)
class RealFrames:
    """Frames at a model's size.

    - `frames`: uint8 `[N, H, W, 3]`, RGB
    - `lane`: bool `[N, H, W]`
    - `judged`: bool `[N, H, W]`, the rows between the farthest and the nearest drawn point; farther
      lines are not drawn, and the bonnet lies nearer
    """

    frames: NDArray[np.uint8]
    lane: NDArray[np.bool_]
    judged: NDArray[np.bool_]

    def iou(self, predict: Predict, normalisation: Normalisation) -> float:
        """Intersection over union of all judged pixels of all frames."""
        logits, _ = predict(normalisation.apply(self.frames))
        answer = (logits[:, 0] > 0) & self.judged
        lane = self.lane & self.judged
        return float((answer & lane).sum() / (answer | lane).sum())


def real_frames(size: Size) -> RealFrames | None:
    """The frames at `size`, or `None` when GAPWATCH_FIELD is not set. `SceneError` for a bad file."""
    field = os.environ.get("GAPWATCH_FIELD")
    if not field:
        return None
    frames, lanes, judged = [], [], []
    for entry in json.loads(LINES.read_text(encoding="utf-8"))["frames"]:
        if entry["set"] != SET:
            continue
        file = Path(field) / entry["image"]
        wanted = (entry["width"], entry["height"])
        try:
            with Image.open(file) as image:
                found = image.size
                picture = image.convert("RGB").resize(
                    (size.width, size.height), Image.Resampling.BILINEAR
                )
        except OSError as error:
            raise SceneError(f"{file}: {error}") from error
        if found != wanted:
            raise SceneError(f"{file}: {found[0]}x{found[1]} pixels, wanted {wanted[0]}x{wanted[1]}")
        scale = np.array([size.width / wanted[0], size.height / wanted[1]])
        lines = [np.array(line) * scale for line in entry["lines"]]
        rows = np.concatenate(lines)[:, 1]
        middle = np.arange(size.height) + 0.5
        frames.append(np.asarray(picture))
        lanes.append(drawn(lines, size))
        inside = (middle >= rows.min()) & (middle <= rows.max())
        judged.append(np.repeat(inside[:, None], size.width, axis=1))
    return RealFrames(np.stack(frames), np.stack(lanes), np.stack(judged))


def drawn(lines: list[NDArray[np.float64]], size: Size) -> NDArray[np.bool_]:
    """Mask `[H, W]` of pixels whose middle lies within a label's half width of a line."""
    x, y = np.meshgrid(np.arange(size.width) + 0.5, np.arange(size.height) + 0.5)
    points = np.stack((x, y), axis=-1)
    nearest = np.full((size.height, size.width), np.inf)
    for line in lines:
        for start, end in zip(line[:-1], line[1:], strict=True):
            along = end - start
            share = np.clip(((points - start) @ along) / (along @ along), 0.0, 1.0)
            distance = np.linalg.norm(points - (start + share[..., None] * along), axis=-1)
            nearest = np.minimum(nearest, distance)
    return nearest <= HALF_WIDTH * size.width / 320
