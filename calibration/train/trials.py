"""What gapwatch's monitor says about drives with a given model: references, scores, and how well the
scores of a shift stand out from nominal ones."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes import SceneError

# Drives of a study: those that make the reference, unseen nominal ones, and those with a shift.
REFERENCE_DRIVES = "1001..1060"
REFERENCE_SECONDS = 4
NOMINAL_SEEDS = range(3001, 3021)
NOMINAL_SECONDS = 10
SHIFTED_SEEDS = range(4001, 4005)
SHIFTED_SECONDS = 8


@dataclass(frozen=True)
class Monitor:
    """The program with a model and a reference of its own."""

    program: Path
    model: Path
    reference: Path

    @classmethod
    def calibrated(
        cls, program: Path, model: Path, reference: Path, without: str | None = None
    ) -> Monitor:
        """Makes the reference from nominal drives, an element of the scenes left out if named."""
        source = f"scene:sim?seed={REFERENCE_DRIVES}&seconds={REFERENCE_SECONDS}"
        source += f"&without={without}" if without else ""
        _run([str(program), "calibrate", "--model", str(model), "--sim", source,
              "--out", str(reference)])
        return cls(program, model, reference)

    def scores(self, sources: Iterable[str]) -> list[NDArray[np.float64]]:
        """Of each source, the score of every judged frame after the first second."""
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(self._scores_of, sources))

    def _scores_of(self, source: str) -> NDArray[np.float64]:
        with tempfile.TemporaryDirectory() as folder:
            journal = Path(folder) / "journal.jsonl"
            _run([str(self.program), "replay", source, "--model", str(self.model),
                  "--reference", str(self.reference), "--journal", str(journal)])
            lines = [json.loads(line) for line in journal.read_text().splitlines()]
        judged = [line["score"] for line in lines if line["t_s"] >= 1 and line["score"] is not None]
        return np.array(judged, np.float64)


def nominal_drives() -> list[str]:
    """Unseen nominal drives."""
    return [f"scene:sim?seed={seed}&seconds={NOMINAL_SECONDS}" for seed in NOMINAL_SEEDS]


def shifted_drives(condition: str, severity: int) -> list[str]:
    """Drives that lie under a condition from beginning to end."""
    return [
        f"scene:sim?seed={seed}&seconds={SHIFTED_SECONDS}&condition={condition}:{severity}"
        for seed in SHIFTED_SEEDS
    ]


def each_second(scores: list[NDArray[np.float64]], rate: int = 10) -> NDArray[np.float64]:
    """One score a second of each drive: windows of a second that do not overlap."""
    return np.concatenate([drive[::rate] for drive in scores])


def auroc(shifted: NDArray[np.float64], nominal: NDArray[np.float64]) -> float:
    """Chance that a shifted window scores higher than a nominal one, ties counted half."""
    above = (shifted[:, None] > nominal[None, :]).mean()
    equal = (shifted[:, None] == nominal[None, :]).mean()
    return float(above + 0.5 * equal)


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SceneError(f"{' '.join(command)}: {done.stderr.strip()}")
