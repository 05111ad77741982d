#!/usr/bin/env python3
"""Trains with and without self-attention distillation, three seeds each: does it help?

    python calibration/train/sad_study.py

Each run is judged as a lane model (IoU on unseen scenes and real frames) and as the eye of a monitor
(a reference of its own, then AUROC of telling windows of shifted drives from unseen nominal ones).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from runs import Run, Variant, study_parser, train_all
from scenes import SceneError
from train import REPOSITORY
from trials import Monitor, auroc, kept, nominal_drives, shifted_drives

SEEDS = (1, 2, 3)
SEVERITIES = (1, 2, 3)
# Image sets below GAPWATCH_FIELD that are not the domain of the scenes.
FIELD = {
    "California highway": "real/california_highway/solidWhiteRight.mp4",
    "CARLA town 05": "sim/carla_town05",
    "BeamNG": "sim/beamng",
}


def main() -> int:
    """Runs the study; one line on standard error when it cannot."""
    parser = study_parser(__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=REPOSITORY / "target/train/sad_study.json")
    args = parser.parse_args()
    try:
        listed = subprocess.run([str(args.gapwatch), "scene", "--list", "conditions"],
                                capture_output=True, text=True, check=True)
        variants = {
            "with SAD": [Variant(f"full-{seed}", seed) for seed in SEEDS],
            "without SAD": [Variant(f"no-sad-{seed}", seed, ("--no-sad",)) for seed in SEEDS],
        }
        runs = train_all([variant for some in variants.values() for variant in some], args)
        judged = {run.variant.name: judge(run, listed.stdout.split(), args) for run in runs}
    except (SceneError, OSError, subprocess.CalledProcessError) as error:
        print(f"sad_study: {error}", file=sys.stderr)
        return 2
    args.out.write_text(json.dumps(judged, indent=1) + "\n", encoding="utf-8")
    kinds = {kind: [judged[variant.name] for variant in some] for kind, some in variants.items()}
    print(table(kinds), differences(*kinds.values()), sep="\n\n")
    return 0


def judge(run: Run, conditions: list[str], args: argparse.Namespace) -> dict[str, float]:
    """Every figure of one run, by name; what the monitor says is kept beside the model."""
    figures = {"lane IoU, unseen scenes": run.iou}
    if run.real_iou is not None:
        figures["lane IoU, real frames"] = run.real_iou
    figures |= kept(run.onnx.with_suffix(".judged.json"),
                    lambda: watched(run.onnx, conditions, args.gapwatch),
                    Path(__file__), args.gapwatch, run.onnx)
    print(f"{run.variant.name}: judged", flush=True)
    return figures


def watched(onnx: Path, conditions: list[str], program: Path) -> dict[str, float]:
    """The figures of a monitor that looks through the model, with a reference of its own."""
    monitor = Monitor.calibrated(program, onnx, onnx.with_suffix(".json"))
    nominal = monitor.windows(nominal_drives())
    figures = {"nominal windows above threshold": float((nominal > 1).mean())}
    for severity in SEVERITIES:
        by_condition = []
        for condition in conditions:
            scores = monitor.windows(shifted_drives(condition, severity))
            by_condition.append(auroc(scores, nominal))
            figures[f"AUROC, {condition} {severity}"] = by_condition[-1]
        figures[f"AUROC, all conditions, severity {severity}"] = float(np.mean(by_condition))
    field = os.environ.get("GAPWATCH_FIELD")
    for name, source in FIELD.items() if field else ():
        scores = monitor.windows([str(Path(field) / source)])
        figures[f"AUROC, {name}"] = auroc(scores, nominal)
        figures[f"median score, {name}"] = float(np.median(scores))
    return figures


def table(kinds: dict[str, list[dict[str, float]]]) -> str:
    """The Markdown table of the study: mean and range over the seeds."""
    rows = ["| | " + " | ".join(kinds) + " |", "|---|" + "---|" * len(kinds)]
    for name in next(iter(kinds.values()))[0]:
        cells = []
        for runs in kinds.values():
            values = np.array([run[name] for run in runs])
            cells.append(f"{values.mean():.3f} ({values.min():.3f} to {values.max():.3f})")
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def differences(on: list[dict[str, float]], off: list[dict[str, float]]) -> str:
    """A line for each main figure: what distillation changes, beside what the seed alone changes."""
    lines = []
    for name in on[0]:
        if name.startswith("lane IoU") or "all conditions" in name:
            first, second = (np.array([run[name] for run in runs]) for runs in (on, off))
            lines.append(f"- {name}: distillation changes it by {first.mean() - second.mean():+.3f}; "
                         f"seeds alone by up to {max(np.ptp(first), np.ptp(second)):.3f}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
