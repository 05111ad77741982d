#!/usr/bin/env python3
"""Leaves out the scenes' elements one by one: what does the lane model lose, what does the gap?

    python calibration/train/ablation.py --model calibration/enet-sad-lite-320x160.onnx

Lane model: trained on scenes without the element, judged on full unseen scenes and on real frames.
Three seeds on full scenes give the spread to hold the differences against. Gap: between the same
drives with and without the element, pooled, held against the gap to other drives of the same world.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from runs import Run, Variant, study_parser, train_all
from scenes import SceneError
from train import REPOSITORY
from network import TAPS

SEEDS = (1, 2, 3)
# Drives that are rendered with and without an element, and the other ones of the yardstick.
DRIVES = "scene:sim?seed=1001..1060&seconds=2&fps=5"
OTHER_DRIVES = (
    "scene:sim?seed=1101..1160&seconds=2&fps=5",
    "scene:sim?seed=1201..1260&seconds=2&fps=5",
)
# These have an effect only in drives that change along the way, which the scenes of this study do not.
OF_CHANGES = {"scenery", "surface", "markings", "sunlight", "canopy", "bridges", "haze"}


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
        elements = [name for name in listed.stdout.split() if name not in OF_CHANGES]
        full = [Variant(f"full-{seed}", seed) for seed in SEEDS]
        left_out = [Variant(f"without-{element}", 1, ("--without", element)) for element in elements]
        runs = train_all(full + left_out, args)
        others, gaps = gaps_of(elements, args)
    except (SceneError, OSError, subprocess.CalledProcessError) as error:
        print(f"ablation: {error}", file=sys.stderr)
        return 2
    args.out.write_text(json.dumps({
        "scenes": args.scenes,
        "epochs": args.epochs,
        "runs": [{"name": run.variant.name, "iou": run.iou, "interval": run.interval,
                  "real_iou": run.real_iou} for run in runs],
        "gap_to_other_drives": others,
        "gap_without": gaps,
    }, indent=1) + "\n", encoding="utf-8")
    print(table(runs[: len(full)], dict(zip(elements, runs[len(full):], strict=True)), others, gaps))
    return 0


def gaps_of(
    elements: list[str], args: argparse.Namespace
) -> tuple[list[list[float]], dict[str, list[float]]]:
    """Jensen-Shannon divergences in bits, by tap: to other drives, and of each element left out."""
    left_out = [f"{DRIVES}&without={element}" for element in elements]
    command = [str(args.gapwatch), "compare", DRIVES, *OTHER_DRIVES, *left_out,
               "--model", str(args.model), "--metric", "log-energy-js", "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SceneError(f"compare: {done.stderr.strip()}")
    rows = [[row[tap] for tap in TAPS] for row in json.loads(done.stdout)]
    # The reference itself may head the list.
    rows = rows[-len(OTHER_DRIVES) - len(elements):]
    return rows[: len(OTHER_DRIVES)], dict(zip(elements, rows[len(OTHER_DRIVES):], strict=True))


def table(
    full: list[Run],
    left_out: dict[str, Run],
    others: list[list[float]],
    gaps: dict[str, list[float]],
) -> str:
    """The Markdown table of the study; gaps as a share of that to other drives, the largest tap's."""
    ious = np.array([run.iou for run in full])
    real = np.array([run.real_iou for run in full]) if full[0].real_iou is not None else None
    yardstick = np.mean(others, axis=0)
    real_spread = f"{real.min():.3f} to {real.max():.3f}" if real is not None else "left out"
    rows = [
        "| left out | lane IoU, full scenes | difference | lane IoU, real frames | difference "
        "| gap, share of that to other drives |",
        "|---|---|---|---|---|---|",
        f"| nothing ({len(full)} seeds) | {ious.min():.4f} to {ious.max():.4f} | | {real_spread} | | |",
    ]
    for element, run in left_out.items():
        against_real = ("left out", "")
        if real is not None:
            against_real = (f"{run.real_iou:.3f}", f"{run.real_iou - real.mean():+.3f}")
        share = np.max(np.array(gaps[element]) / yardstick)
        rows.append(f"| {element} | {run.iou:.4f} | {run.iou - ious.mean():+.4f} "
                    f"| {against_real[0]} | {against_real[1]} | {share:.2f} |")
    yard = ", ".join(f"{tap} {value:.5f}" for tap, value in zip(TAPS, yardstick, strict=True))
    return "\n".join(rows) + f"\n\nGap to other drives, bits: {yard}."


if __name__ == "__main__":
    sys.exit(main())
