#!/usr/bin/env python3
"""Renders scenes, trains a lane model on them, measures it, exports it and writes its card.

One command, from the repository root:

    python calibration/train/train.py

README.md beside this file says how long it takes and what comes out.
"""

from __future__ import annotations

import argparse
import math
import os
import pickle
import shlex
import shutil
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError

from card import Card, SceneSetNote, processor_name, write_settings
from evaluation import best_lane_logit, measure, prediction_of
from export import ExportError, compare, export, prediction_of_file
from losses import distillation_loss, lane_loss
from network import (
    HEADS,
    MODELS,
    TAPS,
    LaneNetwork,
    count_multiply_adds,
    count_parameters,
    freeze_encoder,
)
from scenes import (
    Normalisation,
    SceneError,
    SceneSet,
    Size,
    World,
    ahead,
    load,
    refuse_shared_frames,
    render,
    sha256_of,
    training_batches,
)
from variation import KINDS, Variation

REPOSITORY = Path(__file__).resolve().parents[2]
# Seeds of the rendered sets. Nothing else in gapwatch may use the first one and call it unseen.
TRAINING_SEED, VALIDATION_SEED, TEST_SEED = 1001, 2002, 3003
WARM_UP = 0.1  # share of training over which the learning rate rises
WEIGHT_DECAY = 1e-4
EVALUATION_BATCH = 16


class SettingsError(Exception):
    """The command line cannot be carried out as typed."""


@dataclass(frozen=True)
class Trained:
    """What `train` hands back beside the network, which it changes in place."""

    epochs: int
    steps: int
    seconds: float


def main() -> int:
    """The program: 0 = all done and checked, 2 = not, with one line on standard error."""
    args = parse_arguments()
    try:
        run(args)
    except (SettingsError, SceneError, ExportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if args.smoke:
        print("smoke run passed: rendered, trained, measured, exported, checked")
    return 0


def parse_arguments() -> argparse.Namespace:
    """The command line as typed; `--smoke` then shrinks what it does not name."""
    parser = argparse.ArgumentParser(
        description="Renders scenes, trains a lane model, measures, exports and describes it.",
        epilog="example: python calibration/train/train.py --model lite --size 320x160",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--model", choices=MODELS, default="lite", help="which encoder")
    parser.add_argument("--size", type=size_argument, default="320x160", help="input, WxH pixels")
    parser.add_argument("--look", default="sim", help="of the training scenes' world")
    parser.add_argument("--without", action="append", default=[], metavar="ELEMENT",
                        help="left out of the training scenes; may be repeated")
    parser.add_argument("--init", type=Path, metavar="FILE.pt",
                        help="weights to start from: NAME.pt that an earlier run of the same model "
                        "left in --work, of any size")
    parser.add_argument("--encoder", type=Path, metavar="FILE.onnx",
                        help="exported file of the same model whose encoder and normalisation are kept "
                        "as they are; a lane head alone is trained over it")
    parser.add_argument("--head", choices=HEADS, default="plain", help="which lane head")
    parser.add_argument("--scenes", type=count_argument, default=6000, help="training scenes")
    parser.add_argument("--validation", type=count_argument, default=200, help="scenes an epoch")
    parser.add_argument("--test", type=count_argument, default=1000, help="scenes for the IoU")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--epochs", type=count_argument, default=8, help="passes over the scenes")
    length.add_argument(
        "--minutes", type=float, help="train so long instead; not repeatable to the bit"
    )
    parser.add_argument("--batch", type=count_argument, default=16, help="scenes a step")
    parser.add_argument("--learning-rate", type=float, default=4e-3, help="at its peak")
    parser.add_argument("--sad", action=argparse.BooleanOptionalAction, default=True,
                        help="self-attention distillation in the second half")
    parser.add_argument("--sad-weight", type=float, default=0.02, help="its weight in the loss")
    parser.add_argument("--share-weights", action=argparse.BooleanOptionalAction, default=None,
                        help="one set of convolutions for E2 to E4; default: enet-sad yes, lite no")
    parser.add_argument("--jitter", type=float, default=0.1, help="of brightness and colour")
    parser.add_argument("--varied", type=float, default=0.0,
                        help="share of the scenes that are varied towards real roads; 0 = none")
    parser.add_argument("--variation", nargs="+", choices=KINDS, default=["camera", "clutter"],
                        help="what is varied in them")
    parser.add_argument("--seed", type=int, default=1, help="of weights, order and augmentation")
    parser.add_argument("--threads", type=count_argument, default=os.cpu_count() or 1,
                        help="CPU threads")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto",
                        help="auto = cuda where there is one")
    parser.add_argument("--precision", choices=("auto", "fp32", "bf16"), default="auto",
                        help="of the training steps; auto = bf16 where the hardware multiplies it")
    parser.add_argument("--gapwatch", type=Path, default=REPOSITORY / "target/release/gapwatch",
                        help="the program that renders the scenes")
    parser.add_argument("--work", type=Path, default=REPOSITORY / "target/train",
                        help="folder for rendered scenes, kept for the next run")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "calibration",
                        help="folder for NAME.onnx, NAME.toml and NAME.md")
    parser.add_argument("--name", help="default: enet-sad-WxH, enet-sad-lite-WxH or enet-sad-small-WxH")
    parser.add_argument("--smoke", action="store_true",
                        help="the whole way in a minute, on a few scenes, below --work")
    args = parser.parse_args()
    if args.smoke:
        args.scenes, args.validation, args.test = 96, 16, 32
        args.epochs, args.minutes, args.batch = 2, None, 8
        args.out = args.work / "smoke"
    stem = "enet-sad" if args.model == "enet-sad" else f"enet-sad-{args.model}"
    args.name = args.name or f"{stem}-{args.size}"
    return args


def size_argument(text: str) -> Size:
    """`WxH`, for argparse."""
    try:
        return Size.parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def count_argument(text: str) -> int:
    """A whole number above 0, for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def run(args: argparse.Namespace) -> None:
    """The whole way from scenes to card."""
    check_settings(args)
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    encoder_sha256 = sha256_of(args.encoder) if args.encoder else ""
    device = torch.device(
        "cuda" if args.device == "cuda" or (args.device == "auto" and torch.cuda.is_available())
        else "cpu"
    )
    half = args.precision == "bf16" or (args.precision == "auto" and multiplies_bf16(device))

    world = World(args.look, tuple(args.without))
    sets, notes = [], []
    for use, seed, count, of in (
        ("training", TRAINING_SEED, args.scenes, world),
        ("validation", VALIDATION_SEED, args.validation, World()),
        ("test", TEST_SEED, args.test, World()),
    ):
        folder = render(args.gapwatch, args.work, seed, count, args.size, of)
        sets.append(load(folder, seed, args.size, args.threads))
        notes.append(SceneSetNote(use, seed, count, sha256_of(folder / "scenes.jsonl")))
    training, validation, test = sets
    refuse_shared_frames(training, validation, test)
    normalisation = (normalisation_beside(args.encoder) if args.encoder
                     else Normalisation.of(training))
    print(f"scenes  {len(training)} to train on, {training.lane_share() * 100:.2f} % marking; "
          f"mean {normalisation.mean}, std {normalisation.std}", flush=True)

    network = LaneNetwork(args.model, args.share_weights, args.head)
    encoder_parameters = count_parameters(network.encoder)
    if args.init:
        start_from(args.init, network, args.model)
    if args.encoder:
        keep_encoder_of(args.encoder, network, args.model)
    network.to(device=device, memory_format=torch.channels_last)
    multiply_adds = count_multiply_adds(network.encoder, args.size.width, args.size.height)
    machine = (f"{processor_name()}, {args.threads} threads" if device.type == "cpu"
               else torch.cuda.get_device_name(device))
    machine += f", {'bf16' if half else 'fp32'} training steps, PyTorch {torch.__version__}"
    print(f"network {args.name}: encoder {encoder_parameters:,} parameters, "
          f"{multiply_adds / 1e6:.1f} M multiply-adds; {machine}", flush=True)

    trained = train(network, training, validation, normalisation, args, device, half)
    predict = prediction_of(network)
    # The point where lane begins is that of scenes like those that were trained on.
    alike = validation.varied(Variation(args.varied, tuple(args.variation)), args.seed)
    lane_logit = best_lane_logit(predict, alike, normalisation, EVALUATION_BATCH)
    network.head.lower(lane_logit)
    if not args.encoder:
        seen = measure(predict, validation, normalisation, EVALUATION_BATCH)
        network.set_tap_gains(seen.median_peaks())
    torch.save({"model": args.model, "weights": network.state_dict()},
               args.work / f"{args.name}.pt")

    onnx_file = args.out / f"{args.name}.onnx"
    export(network, args.size, onnx_file)
    write_settings(args.out / f"{args.name}.toml", args.size, normalisation)
    exported = prediction_of_file(onnx_file, args.threads)
    network.cpu()
    agreement = compare(prediction_of(network), exported,
                        normalisation.apply(test.first(8).frames))
    print("export  " + ", ".join(f"{k} {v:.1e}" for k, v in agreement.relative.items())
          + " relative difference from PyTorch", flush=True)

    measurement = measure(exported, test, normalisation, EVALUATION_BATCH)
    low, high = measurement.interval()
    peaks = measurement.median_peaks()
    print(f"test    lane IoU {measurement.iou():.4f} ({low:.4f} to {high:.4f}) on {len(test)} "
          f"unseen scenes; median peak energy "
          + ", ".join(f"{tap} {peaks[tap]:.4g}" for tap in TAPS), flush=True)

    card = Card(
        name=args.name,
        model=args.model,
        size=args.size,
        command=command_of(args),
        scene_sets=notes,
        world=world,
        init_sha256=sha256_of(args.init) if args.init else None,
        kept_encoder=(args.encoder.name, encoder_sha256) if args.encoder else None,
        head=args.head,
        lane_share=training.lane_share(),
        seed=args.seed,
        epochs=trained.epochs,
        steps=trained.steps,
        batch=min(args.batch, len(training)),
        learning_rate=args.learning_rate,
        jitter=args.jitter,
        varied=args.varied,
        variation=tuple(args.variation),
        sad_weight=args.sad_weight if args.sad and not args.encoder else 0.0,
        share_weights=network.share_weights,
        lane_logit=lane_logit,
        train_seconds=trained.seconds,
        machine=machine,
        measurement=measurement,
        encoder_parameters=encoder_parameters,
        head_parameters=count_parameters(network.head),
        encoder_multiply_adds=multiply_adds,
        total_multiply_adds=count_multiply_adds(network, args.size.width, args.size.height),
        channels=network.encoder.channels,
        agreement=agreement,
        onnx_sha256=sha256_of(onnx_file),
        onnx_bytes=onnx_file.stat().st_size,
    )
    card_file = args.out / f"{args.name}.md"
    card_file.write_text(card.text(), encoding="utf-8")
    check_outputs(args, card.onnx_sha256)
    print(f"wrote   {onnx_file}, {args.name}.toml and {args.name}.md", flush=True)


def start_from(file: Path, network: LaneNetwork, model: str) -> None:
    """Loads the weights of an earlier run; tap gains are measured anew.

    Raises `SettingsError` when `file` holds something else, or weights of another model.
    """
    try:
        saved = torch.load(file, weights_only=True)
        kind, weights = saved["model"], saved["weights"]
    except (OSError, EOFError, KeyError, TypeError, RuntimeError, pickle.UnpicklingError) as error:
        raise SettingsError(
            f"--init {file}: not the NAME.pt that a run of train.py leaves in --work"
        ) from error
    if kind != model:
        raise SettingsError(f"--init {file}: weights of {kind}, wanted {model}")
    try:
        network.load_state_dict(weights)
    except (RuntimeError, TypeError) as error:
        raise SettingsError(
            f"--init {file}: its weights do not fit the {model} network as it is now; train them anew"
        ) from error
    network.tap_gains.fill_(1.0)


def keep_encoder_of(file: Path, network: LaneNetwork, model: str) -> None:
    """Takes the encoder of an exported file, with the factors on its taps, and freezes it.

    Raises `SettingsError` when `file` is not an exported file of the same model.
    """
    freeze_encoder(network)
    try:
        tensors = {
            tensor.name: torch.from_numpy(onnx.numpy_helper.to_array(tensor).copy())
            for tensor in onnx.load(str(file)).graph.initializer
        }
        weights = {
            name: tensors[f"encoder.{name}"] for name in network.encoder.state_dict()
        }
        network.encoder.load_state_dict(weights)
        gains = [tensors[name] for name in ("Squeeze", "Squeeze_1", "Squeeze_2")]
        network.tap_gains.copy_(torch.stack([gain.reshape(()) for gain in gains]))
    except (KeyError, RuntimeError, ValueError, OSError, DecodeError) as error:
        raise SettingsError(f"--encoder {file}: not an exported {model} model of train.py") from error


def normalisation_beside(file: Path) -> Normalisation:
    """The normalisation in the TOML file beside an exported file; `SettingsError` when it has none."""
    settings_file = file.with_suffix(".toml")
    try:
        settings = tomllib.loads(settings_file.read_text(encoding="utf-8"))
        return Normalisation(tuple(settings["mean"]), tuple(settings["std"]))
    except (OSError, KeyError, tomllib.TOMLDecodeError) as error:
        raise SettingsError(f"--encoder: no normalisation in {settings_file}") from error


def check_settings(args: argparse.Namespace) -> None:
    """Finds what is missing before any time is spent, and says what would mend it."""
    if not args.gapwatch.is_file() or not os.access(args.gapwatch, os.X_OK):
        raise SettingsError(
            f"no program {args.gapwatch}: run `cargo build --release` in the repository root, or "
            "name the program with --gapwatch"
        )
    args.gapwatch = args.gapwatch.resolve()
    if args.init and not args.init.is_file():
        raise SettingsError(f"--init {args.init}: no such file; its own training comes first")
    if args.encoder and args.init:
        raise SettingsError("--encoder keeps an encoder and --init trains one further: name one of them")
    if args.encoder and not args.encoder.is_file():
        raise SettingsError(f"--encoder {args.encoder}: no such file; its own training comes first")
    written = args.out / f"{args.name}.onnx"
    if args.encoder and written.exists() and written.samefile(args.encoder):
        raise SettingsError(f"--encoder {args.encoder}: the file that is written; name another with --name")
    if args.minutes is not None and not args.minutes > 0:
        raise SettingsError("--minutes must be above 0")
    if not 0 <= args.varied <= 1:
        raise SettingsError("--varied is a share, 0 to 1")
    if not 0 <= args.jitter < 1:
        raise SettingsError("--jitter is a share, 0 to below 1")
    if args.device == "cuda" and not torch.cuda.is_available():
        raise SettingsError("--device cuda: PyTorch finds no CUDA device; use --device cpu")
    for option, folder in (("--work", args.work), ("--out", args.out)):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SettingsError(f"{option} {folder}: {error.strerror}") from error
        if not os.access(folder, os.W_OK):
            raise SettingsError(f"{option} {folder}: the folder cannot be written to")
    # Frame and mask as PNG take less than 2 bytes a pixel.
    scenes = args.scenes + args.validation + args.test
    needed = 2 * scenes * args.size.width * args.size.height
    free = shutil.disk_usage(args.work).free
    if free < needed:
        raise SettingsError(
            f"--work {args.work}: {free / 1e9:.1f} GB free, the scenes may need {needed / 1e9:.1f}"
        )


def multiplies_bf16(device: torch.device) -> bool:
    """Whether matrix units for bfloat16 make training faster there (CPU: AMX)."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    amx = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return bool(amx and amx())


def learning_rate_at(progress: float, peak: float) -> float:
    """Linear rise over the first tenth, then half a cosine down to 0; `progress` runs 0 to 1."""
    if progress < WARM_UP:
        return peak * (0.02 + 0.98 * progress / WARM_UP)
    return peak * 0.5 * (1.0 + math.cos(math.pi * min((progress - WARM_UP) / (1 - WARM_UP), 1.0)))


def train(
    network: LaneNetwork,
    training: SceneSet,
    validation: SceneSet,
    normalisation: Normalisation,
    args: argparse.Namespace,
    device: torch.device,
    half: bool,
) -> Trained:
    """Trains in place, for `args.epochs` or `args.minutes`; one line an epoch."""
    dice = np.random.default_rng(args.seed)
    learned = [weight for weight in network.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(learned, weight_decay=WEIGHT_DECAY, fused=True)
    total_steps = args.epochs * max(len(training) // args.batch, 1)
    began = time.monotonic()

    def progress() -> float:
        if args.minutes is None:
            return step / total_steps
        return (time.monotonic() - began) / (60 * args.minutes)

    step = epoch = 0
    while progress() < 1:
        epoch += 1
        epoch_began = time.monotonic()
        lane_losses, sad_losses = [], []
        network.train()
        batches = training_batches(
            training, normalisation, args.batch, args.jitter,
            Variation(args.varied, tuple(args.variation)), dice, device
        )
        for batch in ahead(batches):
            done = progress()
            if done >= 1:
                break
            for group in optimiser.param_groups:
                group["lr"] = learning_rate_at(done, args.learning_rate)
            with torch.autocast(device.type, torch.bfloat16, enabled=half):
                logits, blocks = network(batch.image)
            loss = lane_loss(logits, batch.lane)
            lane_losses.append(loss.item())
            if args.sad and not args.encoder and done >= 0.5:
                sad = distillation_loss(blocks)
                sad_losses.append(sad.item())
                loss = loss + args.sad_weight * sad
            if not torch.isfinite(loss):
                raise SettingsError(
                    f"the loss is no number in epoch {epoch}; try half of --learning-rate"
                )
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
            step += 1
        if not lane_losses:
            break
        iou = measure(prediction_of(network), validation, normalisation, EVALUATION_BATCH).iou()
        sad_text = f" SAD {np.mean(sad_losses):.3f}" if sad_losses else ""
        of = f"/{args.epochs}" if args.minutes is None else f" ({min(progress(), 1) * 100:.0f} %)"
        print(f"epoch   {epoch}{of}: lane loss {np.mean(lane_losses):.4f}{sad_text}, lane IoU "
              f"{iou:.4f} on {len(validation)} validation scenes, "
              f"{time.monotonic() - epoch_began:.1f} s", flush=True)
    return Trained(epoch, step, time.monotonic() - began)


def command_of(args: argparse.Namespace) -> str:
    """The command that repeats this training, all defaults spelled out, folders left out."""
    words = ["python", "calibration/train/train.py", "--model", args.model]
    words += ["--look", args.look] if args.look != "sim" else []
    words += [word for element in args.without for word in ("--without", element)]
    words += ["--init", str(args.init.name)] if args.init else []
    words += ["--encoder", str(args.encoder.name)] if args.encoder else []
    words += ["--head", args.head] if args.head != "plain" else []
    words += ["--size", str(args.size), "--scenes", str(args.scenes)]
    words += ["--validation", str(args.validation), "--test", str(args.test)]
    words += (["--epochs", str(args.epochs)] if args.minutes is None
              else ["--minutes", f"{args.minutes:g}"])
    words += ["--batch", str(args.batch), "--learning-rate", f"{args.learning_rate:g}"]
    words += ["--sad", "--sad-weight", f"{args.sad_weight:g}"] if args.sad else ["--no-sad"]
    if args.share_weights is not None:
        words.append("--share-weights" if args.share_weights else "--no-share-weights")
    words += ["--varied", f"{args.varied:g}", "--variation", *args.variation] if args.varied else []
    words += ["--jitter", f"{args.jitter:g}", "--seed", str(args.seed)]
    words += ["--threads", str(args.threads), "--device", args.device]
    words += ["--precision", args.precision, "--name", args.name]
    return shlex.join(words) if not args.smoke else "python calibration/train/train.py --smoke"


def check_outputs(args: argparse.Namespace, onnx_sha256: str) -> None:
    """Reads the written files back; `ExportError` when they are not what gapwatch expects."""
    settings = tomllib.loads((args.out / f"{args.name}.toml").read_text(encoding="utf-8"))
    if list(settings) != ["taps", "lane", "size", "mean", "std"] or settings["taps"] != list(TAPS):
        raise ExportError(f"{args.name}.toml holds {settings}")
    if settings["size"] != str(args.size):
        raise ExportError(f"{args.name}.toml: size {settings['size']}, wanted {args.size}")
    if onnx_sha256 not in (args.out / f"{args.name}.md").read_text(encoding="utf-8"):
        raise ExportError(f"{args.name}.md does not name the file it describes")


if __name__ == "__main__":
    sys.exit(main())
