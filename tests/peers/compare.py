"""The encoder of `gapwatch bench`, in its own executor and in tract, against onnxruntime: same graphs, one thread, one
after the other.

    python3 -m venv target/peers && target/peers/bin/pip install -r tests/peers/requirements.txt
    cargo build --release
    target/peers/bin/python tests/peers/compare.py [--rounds 3] [GRAPH.onnx ...]

Every graph is cut to its taps, so that all do the same work. Rounds alternate between the three; the ratios are those of
the smallest medians, above 1 where gapwatch's own executor is faster. Input to onnxruntime is noise: no operator of these graphs takes
longer for one picture than for another. Whether both compute the same is not checked here.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
import onnx
import onnx.utils
import onnxruntime

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 2.0


def cut(graph: Path, folder: Path) -> Path:
    """The graph with its taps as the only outputs."""
    taps = tomllib.loads(graph.with_suffix(".toml").read_text())["taps"]
    image = onnx.load(graph).graph.input[0].name
    file = folder / graph.name
    onnx.utils.extract_model(str(graph), str(file), [image], taps)
    return file


def onnxruntime_ms(session: onnxruntime.InferenceSession) -> float:
    """Median time of a run."""
    (image,) = session.get_inputs()
    picture = np.random.default_rng(1).standard_normal(image.shape, dtype=np.float32)
    for _ in range(5):
        session.run(None, {image.name: picture})
    took = []
    end = time.perf_counter() + SECONDS
    while time.perf_counter() < end:
        began = time.perf_counter()
        session.run(None, {image.name: picture})
        took.append(1e3 * (time.perf_counter() - began))
    return statistics.median(took)


def gapwatch_ms(program: Path, graph: Path, executor: str) -> tuple[float, str]:
    """Median time of the encoder, and what ran it."""
    words = [program, "bench", "--model", graph, "--frame", "320x160", "--format", "json"]
    words += ["--executor", executor]
    ran = subprocess.run(words, check=True, capture_output=True, text=True)
    bench = json.loads(ran.stdout)
    speed = bench["encoder_gflops"]
    of_peak = f"{speed:.0f} of {bench['peak_gflops']:.0f} GFLOP/s" if speed else ""
    return bench["encoder_ms"], f"{bench['executor']}, {of_peak}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("graphs", nargs="*", type=Path)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/gapwatch")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    ratios = []
    print(f"{'graph':<24}{'own ms':>9}{'tract ms':>10}{'onnxruntime ms':>16}{'/tract':>8}{'/onnx':>7}")
    with tempfile.TemporaryDirectory() as folder:
        for graph in args.graphs or sorted((ROOT / "calibration").glob("*.onnx")):
            peer = onnxruntime.InferenceSession(
                cut(graph, Path(folder)), options, providers=["CPUExecutionProvider"]
            )
            rounds = [
                (
                    gapwatch_ms(args.program, graph, "fastest"),
                    gapwatch_ms(args.program, graph, "tract"),
                    onnxruntime_ms(peer),
                )
                for _ in range(args.rounds)
            ]
            ours, how = min(own for own, _, _ in rounds)
            tract = min(tract for _, (tract, _), _ in rounds)
            theirs = min(theirs for _, _, theirs in rounds)
            ratios.append(theirs / ours)
            print(
                f"{graph.stem:<24}{ours:>9.2f}{tract:>10.2f}{theirs:>16.2f}"
                f"{tract / ours:>8.2f}{ratios[-1]:>7.2f}  {how}",
                flush=True,
            )
    mean = math.exp(statistics.fmean(math.log(ratio) for ratio in ratios))
    print(f"geometric mean of the ratios to onnxruntime {mean:.2f}")


if __name__ == "__main__":
    main()
