"""What gapwatch's monitor says about drives with a given model: references, scores, and how well the
scores of a shift stand out from nominal ones."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes import SceneError, sha256_of

# Drives of a study: those that make the reference, and unseen ones that are driven in plain day and
# again under each shift, so that a calm drive is compared with itself.
REFERENCE_DRIVES = "1001..1060"
REFERENCE_SECONDS = 4
UNSEEN_SEEDS = range(3001, 3009)
NOMINAL_SECONDS = 20
SHIFTED_SECONDS = 4
UNJUDGED_S = 1  # the monitor's first window is not full before


@dataclass(frozen=True)
class Monitor:
    """The program with a model and a reference of its own."""

    program: Path
    model: Path
    reference: Path

    @classmethod
    def calibrated(cls, program: Path, model: Path, reference: Path) -> Monitor:
        """Makes the reference from nominal drives."""
        source = f"scene:sim?seed={REFERENCE_DRIVES}&seconds={REFERENCE_SECONDS}"
        _run([str(program), "calibrate", "--model", str(model), "--sim", source,
              "--out", str(reference)])
        return cls(program, model, reference)

    def windows(self, sources: list[str]) -> NDArray[np.float64]:
        """Scores of all sources together, one a second, at any frame rate, from the second second."""
        with ThreadPoolExecutor(2) as pool:
            scores = [score for of in pool.map(self._windows_of, sources) for score in of]
        if not scores:
            raise SceneError(f"the monitor judged nothing of {', '.join(sources)}")
        return np.array(scores)

    def _windows_of(self, source: str) -> list[float]:
        """The score of the first judged frame of each second."""
        with tempfile.TemporaryDirectory() as folder:
            journal = Path(folder) / "journal.jsonl"
            _run([str(self.program), "replay", source, "--model", str(self.model),
                  "--reference", str(self.reference), "--journal", str(journal)])
            lines = [json.loads(line) for line in journal.read_text().splitlines()]
        of_second: dict[int, float] = {}
        for line in lines:
            if line["t_s"] >= UNJUDGED_S and line["score"] is not None:
                of_second.setdefault(int(line["t_s"]), line["score"])
        return list(of_second.values())


def nominal_drives() -> list[str]:
    """Unseen nominal drives."""
    return [f"scene:sim?seed={seed}&seconds={NOMINAL_SECONDS}" for seed in UNSEEN_SEEDS]


def shifted_drives(condition: str, severity: int) -> list[str]:
    """Drives that lie under a condition from beginning to end."""
    return [
        f"scene:sim?seed={seed}&seconds={SHIFTED_SECONDS}&condition={condition}:{severity}"
        for seed in UNSEEN_SEEDS
    ]


def auroc(shifted: NDArray[np.float64], nominal: NDArray[np.float64]) -> float:
    """Chance that a shifted window scores higher than a nominal one, ties counted half."""
    above = (shifted[:, None] > nominal[None, :]).mean()
    equal = (shifted[:, None] == nominal[None, :]).mean()
    return float(above + 0.5 * equal)


def kept(file: Path, find: Callable[[], dict], *depends_on: Path) -> dict:
    """What `find` found and `file` keeps; found anew when a file that it depends on has changed."""
    made_with = {
        "files": [sha256_of(path) for path in (Path(__file__), *depends_on)],
        "field": os.environ.get("GAPWATCH_FIELD"),
    }
    try:
        earlier = json.loads(file.read_text(encoding="utf-8"))
        if earlier["made_with"] == made_with:
            return earlier["found"]
    except (OSError, ValueError, KeyError):
        pass
    found = find()
    text = json.dumps({"made_with": made_with, "found": found}, indent=1) + "\n"
    file.write_text(text, encoding="utf-8")
    return found


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SceneError(f"{' '.join(command)}: {done.stderr.strip()}")
