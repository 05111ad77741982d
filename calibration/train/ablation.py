#!/usr/bin/env python3
"""Leaves out the scenes' elements one by one: what does the lane model lose, what does the gap?

    python calibration/train/ablation.py --model calibration/enet-sad-lite-320x160.onnx

Lane model: trained on scenes without the element, judged on full unseen scenes and on real frames.
Three seeds on full scenes give the spread to hold the differences against. Gap: a reference of
drives without the element, and the scores of unseen full drives against it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from runs import Run, Variant, study_parser, train_all
from scenes import SceneError
from train import REPOSITORY
from trials import Monitor, nominal_drives

SEEDS = (1, 2, 3)


@dataclass(frozen=True)
class Gap:
    """Scores of unseen full drives: their median, and the 99th percentile over the frames."""

    median: float
    p99: float


def main() -> int:
    """Runs the study; one line on standard error when it cannot."""
    parser = study_parser(__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path,
                        default=REPOSITORY / "calibration/enet-sad-lite-320x160.onnx",
                        help="whose gap is measured")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "target/train/ablation.json")
    args = parser.parse_args()
    try:
        listed = subprocess.run([str(args.gapwatch), "scene", "--list", "elements"],
                                capture_output=True, text=True, check=True)
        elements = listed.stdout.split()
        full = [Variant(f"full-{seed}", seed) for seed in SEEDS]
        left_out = [Variant(f"without-{element}", 1, ("--without", element)) for element in elements]
        runs = train_all(full + left_out, args)
        gaps = [gap_without(element, args) for element in (None, *elements)]
    except (SceneError, OSError, subprocess.CalledProcessError) as error:
        print(f"ablation: {error}", file=sys.stderr)
        return 2
    text = table(runs[: len(full)], dict(zip(elements, runs[len(full):], strict=True)),
                 dict(zip((None, *elements), gaps, strict=True)))
    args.out.write_text(json.dumps({
        "scenes": args.scenes,
        "epochs": args.epochs,
        "runs": [{"name": run.variant.name, "iou": run.iou, "interval": run.interval,
                  "real_iou": run.real_iou} for run in runs],
        "gap": {element or "full": vars(gap)
                for element, gap in zip((None, *elements), gaps, strict=True)},
    }, indent=1) + "\n", encoding="utf-8")
    print(text)
    return 0


def gap_without(element: str | None, args: object) -> Gap:
    """The gap of full drives against a reference that does not know the element."""
    reference = args.work / f"reference-{element or 'full'}.json"
    monitor = Monitor.calibrated(args.gapwatch, args.model, reference, element)
    scores = np.concatenate(monitor.scores(nominal_drives()))
    print(f"gap without {element or 'nothing'}: median score {np.median(scores):.2f}", flush=True)
    return Gap(float(np.median(scores)), float(np.percentile(scores, 99)))


def table(full: list[Run], left_out: dict[str, Run], gaps: dict[str | None, Gap]) -> str:
    """The Markdown table of the study."""
    rows = [
        "| left out | lane IoU, full scenes | difference | lane IoU, real frames | difference "
        "| score of full drives, median | 99th percentile |",
        "|---|---|---|---|---|---|---|",
    ]
    ious = np.array([run.iou for run in full])
    real = np.array([run.real_iou for run in full]) if full[0].real_iou is not None else None
    spread = f"{ious.min():.4f} to {ious.max():.4f}"
    real_spread = f"{real.min():.3f} to {real.max():.3f}" if real is not None else "left out"
    rows.append(f"| nothing ({len(full)} seeds) | {spread} | | {real_spread} | "
                f"| {gaps[None].median:.2f} | {gaps[None].p99:.2f} |")
    for element, run in left_out.items():
        gap = gaps[element]
        against_real = ("left out", "")
        if real is not None:
            against_real = (f"{run.real_iou:.3f}", f"{run.real_iou - real.mean():+.3f}")
        rows.append(f"| {element} | {run.iou:.4f} | {run.iou - ious.mean():+.4f} "
                    f"| {against_real[0]} | {against_real[1]} "
                    f"| {gap.median:.2f} | {gap.p99:.2f} |")
    return "\n".join(rows)


if __name__ == "__main__":
    sys.exit(main())
