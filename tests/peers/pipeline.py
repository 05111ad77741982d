"""The whole pipeline of `gapwatch bench` against the one that a user would write: OpenCV to unpack, decode and resize,
onnxruntime for the encoder, NumPy for attention and histograms, OpenCV's compareHist. One thread each, in one run.

    python3 -m venv target/peers && target/peers/bin/pip install -r tests/peers/requirements.txt
    cargo build --release
    target/peers/bin/python tests/peers/pipeline.py [--rounds 3]

First both judge the same pictures, of the encoder's own size, with the same model and the metric `paper`; their
similarities must agree to 0.001 or nothing is timed. Then a frame of 1280x720 goes from a camera's buffer, YUYV or MJPG,
to a verdict. CPU time a frame, the smallest of a few rounds that alternate; ratios above 1 where gapwatch takes less. The
peer resizes by INTER_LINEAR, the cheapest that OpenCV has, which aliases; gapwatch by an antialiased triangle.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from compare import ROOT, cut

# The paper's parameters (its eq. 3): temperature, levels, first level that is counted.
TEMPERATURE, LEVELS, FIRST = 10.0, 256, 101
FRAMES = 60
AGREE = 1e-3
# The models of both, and that of the paper's size for the peer alone.
SAME = "enet-sad-lite-320x160"
PAPER = "enet-sad-800x288"


class Peer:
    """A lane model's encoder with attention histograms behind it."""

    def __init__(self, graph: Path, folder: Path):
        spec = tomllib.loads(graph.with_suffix(".toml").read_text())
        self.size = tuple(int(side) for side in spec["size"].split("x"))
        self.mean = np.float32(spec.get("mean", [0.0] * 3))
        self.std = np.float32(spec.get("std", [1.0] * 3))
        self.taps = spec["taps"]
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
        providers = ["CPUExecutionProvider"]
        self.session = onnxruntime.InferenceSession(cut(graph, folder), options, providers=providers)
        self.image = self.session.get_inputs()[0].name
        self.reference: list[np.ndarray] | None = None

    def histograms(self, rgb: np.ndarray) -> list[np.ndarray]:
        """One a tap, of the counted levels."""
        small = cv2.resize(rgb, self.size, interpolation=cv2.INTER_LINEAR)
        planes = ((small.astype(np.float32) / 255.0 - self.mean) / self.std).transpose(2, 0, 1)
        maps = self.session.run(self.taps, {self.image: np.ascontiguousarray(planes[None])})
        return [self.histogram(of[0]) for of in maps]

    def histogram(self, activations: np.ndarray) -> np.ndarray:
        """Spatial softmax of the energy, scaled to 0..255, counted."""
        energy = np.square(activations).sum(axis=0)
        common = (self.size[0] // 4, self.size[1] // 4)
        energy = cv2.resize(energy, common, interpolation=cv2.INTER_LINEAR).astype(np.float64)
        attention = np.exp((energy - energy.max()) / TEMPERATURE)
        attention /= attention.sum()
        low, high = attention.min(), attention.max()
        levels = ((LEVELS - 1) * ((attention - low) / (high - low))).astype(np.int64)
        return np.bincount(levels.ravel(), minlength=LEVELS)[FIRST:].astype(np.float32)

    def similarities(self, live: list[np.ndarray]) -> list[float]:
        """Correlation with the reference, a number a tap."""
        assert self.reference is not None
        pairs = zip(live, self.reference)
        return [cv2.compareHist(a, b, cv2.HISTCMP_CORREL) for a, b in pairs]


def mean_histograms(peer: Peer, folder: Path) -> list[np.ndarray]:
    pictures = sorted(folder.glob("frames/*.png"))
    all_of = [peer.histograms(cv2.imread(str(p))[:, :, ::-1]) for p in pictures]
    return [np.mean(of, axis=0, dtype=np.float64).astype(np.float32) for of in zip(*all_of)]


def run(program: Path, *words: object) -> str:
    ran = subprocess.run([program, *map(str, words)], check=True, capture_output=True, text=True)
    return ran.stdout


def check_agreement(program: Path, peer: Peer, graph: Path, folder: Path) -> float:
    """Largest difference of similarities on rendered scenes; raises when it is too large."""
    size = "x".join(map(str, peer.size))
    sets = folder / "nominal", folder / "fog"
    run(program, "scene", "--out", sets[0], "--count", 12, "--size", size)
    run(program, "scene", "--out", sets[1], "--count", 12, "--size", size, "--condition", "fog:3")
    frames = [of / "frames" for of in sets]
    words = ["compare", *frames, "--metric", "paper", "--model", graph, "--format", "json"]
    (ours,) = json.loads(run(program, *words))
    peer.reference = mean_histograms(peer, sets[0])
    theirs = peer.similarities(mean_histograms(peer, sets[1]))
    pairs = [(ours[tap], similarity) for tap, similarity in zip(peer.taps, theirs)]
    worst = max(abs(a - b) for a, b in pairs)
    if worst > AGREE:
        raise SystemExit(f"similarities differ by {worst}: {pairs}")
    return worst


def buffers(folder: Path, form: str) -> list[np.ndarray]:
    """What a camera would give of some rendered frames of 1280x720."""
    shown = []
    for path in sorted((folder / "large/frames").glob("*.png")):
        bgr = cv2.imread(str(path))
        if form == "mjpg":
            quality = [cv2.IMWRITE_JPEG_QUALITY, 85]
            shown.append(cv2.imencode(".jpg", bgr, quality)[1])
        else:
            yuv = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV)
            packed = np.empty((*bgr.shape[:2], 2), np.uint8)
            packed[:, :, 0] = yuv[:, :, 0]
            packed[:, 0::2, 1], packed[:, 1::2, 1] = yuv[:, 0::2, 1], yuv[:, 0::2, 2]
            shown.append(packed)
    return shown


def peer_ms(peer: Peer, shown: list[np.ndarray], form: str) -> float:
    """CPU time of a frame from buffer to verdict."""
    window: list[list[np.ndarray]] = []

    def judge(buffer: np.ndarray) -> list[float]:
        if form == "mjpg":
            rgb = cv2.cvtColor(cv2.imdecode(buffer, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        else:
            rgb = cv2.cvtColor(buffer, cv2.COLOR_YUV2RGB_YUYV)
        window.append(peer.histograms(rgb))
        del window[:-10]
        return peer.similarities([np.mean(of, axis=0) for of in zip(*window)])

    for buffer in shown:
        judge(buffer)
    began = time.process_time()
    for n in range(FRAMES):
        judge(shown[n % len(shown)])
    return 1e3 * (time.process_time() - began) / FRAMES


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/gapwatch")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    calibration = ROOT / "calibration"
    graphs = {name: calibration / f"{name}.onnx" for name in (SAME, PAPER)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peers = {}
        for model, graph in graphs.items():
            (folder / model).mkdir()
            peers[model] = Peer(graph, folder)
            worst = check_agreement(args.program, peers[model], graph, folder / model)
            print(f"{model}: similarities agree to {worst:.1e}")
        run(args.program, "scene", "--out", folder / "large", "--count", 4, "--size", "1280x720")
        for form in ("yuyv", "mjpg"):
            shown = buffers(folder, form)
            ours, theirs = [], {model: [] for model in graphs}
            for _ in range(args.rounds):
                words = ["bench", "--pixels", form, "--model", graphs[SAME], "--format", "json"]
                ours.append(json.loads(run(args.program, *words))["cpu_ms"])
                for model, peer in peers.items():
                    theirs[model].append(peer_ms(peer, shown, form))
            own = min(ours)
            for model, took in theirs.items():
                print(
                    f"{form} 1280x720: gapwatch {SAME} {own:.2f} ms, peer {model} {min(took):.2f} ms, "
                    f"ratio {min(took) / own:.1f}"
                )


if __name__ == "__main__":
    main()
