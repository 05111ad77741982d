"""Trainings of a study: variants of one small recipe, two at a time, each kept for the next study."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from evaluation import measure
from export import prediction_of_file
from real_frames import real_frames
from scenes import Normalisation, SceneError, Size, World, load, render
from train import EVALUATION_BATCH, REPOSITORY, TEST_SEED, TRAINING_SEED, VALIDATION_SEED

TRAINER = Path(__file__).resolve().parent / "train.py"
SIZE = Size(320, 160)
VALIDATION_SCENES = 200


@dataclass(frozen=True)
class Variant:
    """One training: its name, its seed and what it does differently."""

    name: str
    seed: int
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class Run:
    """A finished training."""

    variant: Variant
    onnx: Path
    iou: float
    interval: tuple[float, float]
    real_iou: float | None


def study_parser(description: str) -> argparse.ArgumentParser:
    """The command line that all studies share."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=2000, help="training scenes of each run")
    parser.add_argument("--epochs", type=int, default=5, help="passes over them")
    parser.add_argument("--test", type=int, default=600, help="unseen scenes for the IoU")
    parser.add_argument("--gapwatch", type=Path, default=REPOSITORY / "target/release/gapwatch",
                        help="the program")
    parser.add_argument("--work", type=Path, default=REPOSITORY / "target/train",
                        help="folder for scenes and runs, kept for the next study")
    return parser


def train_all(variants: list[Variant], args: argparse.Namespace) -> list[Run]:
    """Trains what is not there yet, two runs of one thread at a time, and measures all."""
    program = args.gapwatch.resolve()
    args.work.mkdir(parents=True, exist_ok=True)
    for seed, count in (
        (TRAINING_SEED, args.scenes), (VALIDATION_SEED, VALIDATION_SCENES), (TEST_SEED, args.test)
    ):
        render(program, args.work, seed, count, SIZE, World())
    missing = sum(not finished(onnx_of(variant, args)) for variant in variants)
    print(f"{missing} of {len(variants)} runs are to be trained", flush=True)
    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(lambda variant: train_one(variant, program, args), variants))
    test = load(render(program, args.work, TEST_SEED, args.test, SIZE, World()), TEST_SEED, SIZE, 2)
    real = real_frames(SIZE)
    if real is None:
        print("real frames are left out: GAPWATCH_FIELD is not set", flush=True)
    runs = []
    for variant, onnx in zip(variants, done, strict=True):
        settings = tomllib.loads(onnx.with_suffix(".toml").read_text(encoding="utf-8"))
        normalisation = Normalisation(tuple(settings["mean"]), tuple(settings["std"]))
        predict = prediction_of_file(onnx, 2)
        measurement = measure(predict, test, normalisation, EVALUATION_BATCH)
        runs.append(Run(
            variant,
            onnx,
            measurement.iou(),
            measurement.interval(),
            real.iou(predict, normalisation) if real else None,
        ))
        print(f"{variant.name}: lane IoU {runs[-1].iou:.4f} on {len(test)} unseen scenes"
              + (f", {runs[-1].real_iou:.4f} on {len(real.frames)} real frames" if real else ""),
              flush=True)
    return runs


def onnx_of(variant: Variant, args: argparse.Namespace) -> Path:
    """Where the variant's model lies, trained or not."""
    return args.work / "runs" / f"{args.scenes}x{args.epochs}" / f"{variant.name}.onnx"


def finished(onnx: Path) -> bool:
    """Whether the training of the model came to its end: the card is written last."""
    return onnx.with_suffix(".md").is_file()


def train_one(variant: Variant, program: Path, args: argparse.Namespace) -> Path:
    """The variant's ONNX file; trains it unless an earlier study of the same size did."""
    onnx = onnx_of(variant, args)
    if finished(onnx):
        return onnx
    folder = onnx.parent
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(TRAINER), "--gapwatch", str(program), "--work", str(args.work),
               "--out", str(folder), "--name", variant.name, "--scenes", str(args.scenes),
               "--epochs", str(args.epochs), "--validation", str(VALIDATION_SCENES),
               "--test", str(args.test), "--threads", "1", "--seed", str(variant.seed)]
    print(f"training {variant.name}", flush=True)
    done = subprocess.run(
        [*command, *variant.flags],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    log = folder / f"{variant.name}.log"
    log.write_text(done.stdout + done.stderr, encoding="utf-8")
    if done.returncode != 0:
        raise SceneError(f"{variant.name}: training failed; see {log}")
    print(f"trained {variant.name}", flush=True)
    return onnx
