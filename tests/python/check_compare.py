"""Checks `gapwatch compare` against an independent computation (oracle.py).

Compares the folders with gapwatch by all metrics and by the metric `paper` at a temperature that
counts many pixels, and computes the same from the pictures and the ONNX file:

- histograms, bin by bin: every pixel must be counted in the oracle's bin; one within 1e-4 of a
  bin's edge may be counted in the bin beside it;
- similarities and divergences, to 1e-4. A single such pixel moves a correlation of few pixels by
  more than that, so the oracle's correlation is taken with these pixels counted as gapwatch
  counted them; how far the values lie apart without that is printed beside it;
- median peak energies, to 1e-4 of them;
- the bin edges of `log-energy-js`: they must cut the reference into bins of nearly equal mass;
- that the taps can be told from each other, and that this check notices when two are swapped.

JPEG decoders may differ by rounding: pictures in JPEG are first decoded by Pillow and given to both
sides as PNG, and gapwatch's own decoding is checked by comparing the two.

Prints a table, one JSON line and one last line `compare agrees with the oracle: ...`. Exit code 1
with one line at the first disagreement, 2 when the check cannot be made.

Needs: pip install -r tests/requirements.txt
"""

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

import oracle
from oracle import Binned, Counts, Floats, ModelOptions, TappedModel

TOLERANCE = 1e-4
IMAGES_MIN = 20
COUNTED_PIXELS_MIN = 50
# The bin edges of log-energy metrics lie on a grid; this is several of its cells.
EDGE_GRID = 1e-3
# Divergence in bits that the decoding of JPEG may make: ten times what rounding makes; channels
# swapped or another range of values make far more.
JPEG_DIVERGENCE_MAX = 1e-3
DIVERGENCES = {
    "pearson": oracle.correlation,
    "chi2": oracle.chi_square,
    "js": oracle.jensen_shannon_bits,
    "hellinger": oracle.hellinger,
    "w1": oracle.wasserstein,
}
# Metrics on histograms, then those on channels, whose values the library's own tests work out by hand.
METRICS = (
    "paper",
    *(f"attention-{name}" for name in DIVERGENCES),
    *(f"log-energy-{name}" for name in DIVERGENCES),
)
CHANNEL_METRICS = ("frechet", "mahalanobis")


class Disagreement(Exception):
    """What gapwatch and the oracle do not agree on."""


class CannotCheck(Exception):
    """Why there is nothing to check."""


@dataclass(frozen=True)
class PictureSet:
    """A folder of pictures seen by the oracle."""

    name: str
    """As gapwatch is given it."""
    title: str
    """For people."""
    images: int
    maps: Mapping[str, Floats]
    """By tap, `[judged images, h, w]`."""


@dataclass(frozen=True)
class Answer:
    """What `gapwatch compare` said."""

    metrics: tuple[str, ...]
    temperature: str
    """Of the metric paper, as typed."""
    rows: Mapping[tuple[str, str], Mapping[str, Any]]
    """By set and metric."""
    histograms: Mapping[tuple[str, str, str], Mapping[str, Any]]
    """By set, metric and tap."""


@dataclass
class Agreement:
    """How near gapwatch and the oracle are by one metric on one tap."""

    metric: str
    tap: str
    difference: float = 0.0
    """Largest of the sets."""
    difference_without_edges: float = 0.0
    """The same with pixels near a bin's edge counted as gapwatch counted them."""
    edge_pixels: int = 0
    """Pixels that gapwatch counted in the bin beside the oracle's."""
    counted_pixels: float = 0.0
    """Average of all images."""
    peak_difference: float = 0.0
    """Of the median peak energy, relative."""
    mass_deviation: float | None = None
    """Of bins of equal mass on the reference: the largest, relative to their mean."""


def strict_json(text: str) -> Any:
    """Reads JSON without NaN and Infinity, which are not part of it."""

    def refuse(constant: str) -> NoReturn:
        raise Disagreement(f"gapwatch wrote {constant}, which is no JSON")

    return json.loads(text, parse_constant=refuse)


def answer_of(program: Path, arguments: Sequence[str]) -> str:
    """Standard output of a run that must succeed."""
    run = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if run.returncode != 0:
        said = run.stderr.strip() or "nothing on standard error"
        raise Disagreement(
            f"gapwatch {' '.join(arguments)}: exit code {run.returncode}, wanted 0: {said}"
        )
    return run.stdout


def compare(
    program: Path,
    model_flags: Sequence[str],
    sets: Sequence[PictureSet],
    metric: str,
    temperature: str,
) -> Answer:
    """Runs `gapwatch compare`; the first set is the reference."""
    with tempfile.TemporaryDirectory() as folder:
        histograms = Path(folder) / "histograms.json"
        arguments = ["compare", *(one.name for one in sets), *model_flags, "--metric", metric]
        arguments += ["--temperature", temperature, "--format", "json"]
        arguments += ["--histograms", str(histograms)]
        rows = strict_json(answer_of(program, arguments))
        records = strict_json(histograms.read_text())
    metrics = METRICS if metric == "all" else (metric,)
    by_row = {(row["set"], row["metric"]): row for row in rows}
    by_record = {(one["set"], one["metric"], one["tap"]): one for one in records}
    names = [one.name for one in sets]
    on_channels = CHANNEL_METRICS if metric == "all" else ()
    wanted_rows = set(itertools.product(names[1:], (*metrics, *on_channels)))
    wanted_records = set(itertools.product(names, metrics, sets[0].maps))
    if len(rows) != len(wanted_rows) or by_row.keys() != wanted_rows:
        raise Disagreement(f"gapwatch compare gives rows for {sorted(by_row)}")
    if len(records) != len(wanted_records) or by_record.keys() != wanted_records:
        raise Disagreement(f"gapwatch compare writes histograms of {sorted(by_record)}")
    return Answer(metrics, temperature, by_row, by_record)


def near(what: str, found: float, wanted: float) -> float:
    """The relative difference of two numbers, which must be small."""
    difference = abs(found / wanted - 1.0)
    if not difference <= TOLERANCE:
        raise Disagreement(f"{what} is {found}, the oracle says {wanted}")
    return difference


def paper_temperature(typed: str, peak: float) -> float:
    """A temperature as typed, in energy units."""
    share = typed.removesuffix("peak")
    return float(share) if share == typed else float(share) * peak


def expected(
    answer: Answer, reference: PictureSet, one: PictureSet, metric: str, tap: str
) -> Binned:
    """The oracle's histogram, with its own peak energy and gapwatch's bin edges."""
    peak = oracle.median_peak(reference.maps[tap])
    binning = answer.histograms[one.name, metric, tap]["binning"]
    what = f"{one.title}: {metric}, tap {tap}"
    if metric.startswith("log-energy"):
        epsilon = oracle.EPSILON_SHARE * peak
        near(f"{what}: epsilon", binning["epsilon"], epsilon)
        return oracle.log_energy_histogram(one.maps[tap], epsilon, np.array(binning["edges"]))
    published = metric == "paper"
    first_level = oracle.PAPER_FIRST_LEVEL if published else 0
    temperature = paper_temperature(
        answer.temperature if published else f"{oracle.TEMPERATURE_SHARE}peak", peak
    )
    near(f"{what}: temperature", binning["temperature"], temperature)
    if (binning["levels"], binning["first"]) != (oracle.LEVELS, first_level):
        raise Disagreement(f"{what}: levels {binning['levels']}, the first {binning['first']}")
    return oracle.attention_histogram(one.maps[tap], temperature, first_level)


def check_counts(what: str, record: Mapping[str, Any], wanted: Binned) -> tuple[Counts, int]:
    """Checks a histogram bin by bin; returns it and how many pixels lie across a bin's edge."""
    counts = np.array(record["counts"], dtype=np.int64)
    if record["images"] != wanted.images:
        raise Disagreement(f"{what}: {record['images']} images counted, wanted {wanted.images}")
    if counts.shape != wanted.counts.shape:
        raise Disagreement(f"{what}: {counts.size} bins, wanted {wanted.counts.size}")
    above = counts[::-1].cumsum()[::-1]
    outside = (above < wanted.above_least) | (above > wanted.above_most)
    if outside.any():
        place = int(outside.argmax())
        raise Disagreement(
            f"{what}: {above[place]} pixels in bin {place} of {counts.size} and above, the oracle "
            f"allows {wanted.above_least[place]} to {wanted.above_most[place]}"
        )
    exact = wanted.counts[::-1].cumsum()[::-1]
    return counts, int(np.abs(above - exact).sum())


def check_value(what: str, row: Mapping[str, Any], tap: str, wanted: float | None) -> float | None:
    """Checks that a value is there exactly when it is defined, and returns it."""
    found = row[tap]
    reason = row.get("reasons", {}).get(tap)
    if (found is None) != (wanted is None) or (found is None) != bool(reason):
        raise Disagreement(f"{what} is {found} (reason {reason}), the oracle says {wanted}")
    return None if found is None else float(found)


def compared(metric: str, a: Floats, b: Floats) -> float | None:
    """The metric's value for two histograms."""
    name = "pearson" if metric == "paper" else metric.rsplit("-", 1)[1]
    return DIVERGENCES[name](a, b)


def check_edges(what: str, logarithms: Floats, edges: Floats) -> float:
    """Checks that edges cut the reference's pixels into bins of equal mass.

    A bin may differ from its share by the pixels beside its edges: edges lie on a grid, and where
    many pixels have one energy no edge can part them. Returns the largest relative deviation.
    """
    if not (np.diff(edges) > 0.0).all() or edges.size >= oracle.LOG_ENERGY_BINS:
        raise Disagreement(f"{what}: {edges.size} bin edges that do not rise or are too many")
    share = logarithms.size / oracle.LOG_ENERGY_BINS
    above = np.concatenate([[logarithms.size], oracle.pixels_above(logarithms, edges), [0]])
    masses = above[:-1] - above[1:]
    beside = oracle.pixels_above(logarithms, edges - EDGE_GRID) - oracle.pixels_above(
        logarithms, edges + EDGE_GRID
    )
    beside = np.concatenate([[0], beside, [0]])
    excess = np.abs(masses - share) - (beside[:-1] + beside[1:])
    if excess.max() > 1.0:
        place = int(excess.argmax())
        raise Disagreement(
            f"{what}: bin {place} of {masses.size} holds {masses[place]} pixels of the reference, "
            f"an equal share is {share:.1f}"
        )
    return float(np.abs(masses / share - 1.0).max())


def check_tap(answer: Answer, sets: Sequence[PictureSet], metric: str, tap: str) -> Agreement:
    """Checks one metric on one tap of all sets."""
    agreement = Agreement(metric, tap)
    reference = sets[0]
    found: dict[str, Floats] = {}
    wanted: dict[str, Binned] = {}
    pixels = images = 0
    for one in sets:
        what = f"{one.title}: {metric}, tap {tap}"
        record = answer.histograms[one.name, metric, tap]
        peak = oracle.median_peak(reference.maps[tap])
        difference = near(f"{what}: median peak energy", record["median_peak_energy"], peak)
        agreement.peak_difference = max(agreement.peak_difference, difference)
        histogram = expected(answer, reference, one, metric, tap)
        if metric.startswith("log-energy") and one is reference:
            logarithms = oracle.log_energy(one.maps[tap], oracle.EPSILON_SHARE * peak)
            edges = np.array(record["binning"]["edges"])
            agreement.mass_deviation = check_edges(what, logarithms, edges)
        counts, edge_pixels = check_counts(what, record, histogram)
        agreement.edge_pixels += edge_pixels
        found[one.name] = counts / max(histogram.images, 1)
        wanted[one.name] = histogram
        pixels += int(counts.sum())
        images += histogram.images
    agreement.counted_pixels = pixels / images
    for one in sets[1:]:
        what = f"{one.title}: {metric}, tap {tap}"
        row = answer.rows[one.name, metric]
        if (row["images"], row["judged"]) != (one.images, wanted[one.name].images):
            raise Disagreement(
                f"{what}: {row['judged']} of {row['images']} images judged, the oracle judges "
                f"{wanted[one.name].images} of {one.images}"
            )
        exact = compared(metric, wanted[one.name].average, wanted[reference.name].average)
        as_counted = compared(metric, found[one.name], found[reference.name])
        value = check_value(what, row, tap, as_counted)
        if value is None or as_counted is None or exact is None:
            continue
        if not abs(value - as_counted) <= TOLERANCE:
            raise Disagreement(f"{what} is {value}, the oracle says {as_counted}")
        agreement.difference = max(agreement.difference, abs(value - exact))
        agreement.difference_without_edges = max(
            agreement.difference_without_edges, abs(value - as_counted)
        )
    # Correlations follow single pixels across an edge; counts have been checked edge by edge.
    correlates = metric == "paper" or metric.endswith("pearson")
    if not correlates and agreement.difference > TOLERANCE:
        raise Disagreement(f"{metric}, tap {tap}: {agreement.difference:.1e} from the oracle")
    return agreement


def check_answer(answer: Answer, sets: Sequence[PictureSet]) -> list[Agreement]:
    """Checks an answer whole; raises Disagreement."""
    return [
        check_tap(answer, sets, metric, tap) for metric in answer.metrics for tap in sets[0].maps
    ]


def check_taps_differ(answers: Sequence[Answer], sets: Sequence[PictureSet]) -> None:
    """Checks that no two taps say the same, and that the check notices when two are swapped."""
    for a, b in itertools.combinations(sets[0].maps, 2):
        apart = max(
            abs(row[a] - row[b])
            for answer in answers
            for row in answer.rows.values()
            if row[a] is not None and row[b] is not None
        )
        if not apart > 10.0 * TOLERANCE:
            raise Disagreement(f"taps {a} and {b} agree to {apart:.1e} in every metric")
        swap = {a: b, b: a}
        swapped = [
            PictureSet(
                one.name,
                one.title,
                one.images,
                {tap: one.maps[swap.get(tap, tap)] for tap in one.maps},
            )
            for one in sets
        ]
        for answer in answers:
            try:
                check_answer(answer, swapped)
            except Disagreement:
                continue
            raise Disagreement(f"the check does not notice when taps {a} and {b} are swapped")


def is_jpeg(path: Path) -> bool:
    """Whether the name ends like that of a JPEG picture."""
    return path.suffix.lower() in (".jpg", ".jpeg")


def without_jpeg(folder: Path, scratch: Path) -> Path:
    """The folder, or a copy of its pictures decoded by Pillow when some are JPEG."""
    pictures = oracle.pictures_in(folder)
    if not pictures:
        raise CannotCheck(f"{folder}: no PNG or JPEG picture in this folder")
    if not any(map(is_jpeg, pictures)):
        return folder
    copies = Path(tempfile.mkdtemp(dir=scratch, prefix=f"{folder.name}-"))
    for number, picture in enumerate(pictures):
        oracle.decoded(picture).save(copies / f"{number:06}.png")
    return copies


def check_jpeg(program: Path, model_flags: Sequence[str], folder: Path, copies: Path) -> float:
    """Checks gapwatch's decoding of JPEG against Pillow's; the largest divergence in bits."""
    arguments = ["compare", str(copies), str(folder), *model_flags, "--format", "json"]
    rows = strict_json(answer_of(program, [*arguments, "--metric", "log-energy-js"]))
    if rows[0]["judged"] != rows[0]["images"]:
        raise Disagreement(f"{folder}: {rows[0]['judged']} of {rows[0]['images']} images judged")
    named = ("set", "metric", "images", "judged")
    divergence = max(float(value) for key, value in rows[0].items() if key not in named)
    if not divergence <= JPEG_DIVERGENCE_MAX:
        raise Disagreement(f"{folder}: JPEG decoded otherwise than by Pillow, {divergence} bits")
    return divergence


def seen_by_oracle(
    model: TappedModel, folders: Sequence[Path], names: Sequence[Path]
) -> list[PictureSet]:
    """Runs the oracle's network on every picture of the folders."""
    sets = []
    for folder, name in zip(folders, names, strict=True):
        pictures = oracle.pictures_in(name)
        sets.append(PictureSet(str(name), str(folder), len(pictures), model.energies_of(pictures)))
    images = sum(one.images for one in sets)
    if images < IMAGES_MIN:
        raise CannotCheck(f"{images} images in all sets together, wanted at least {IMAGES_MIN}")
    return sets


def check_enough_counted(agreements: Sequence[Agreement], temperature: str) -> None:
    """Checks that the metric paper counts so many pixels that its bins can be checked."""
    if min(one.counted_pixels for one in agreements) < COUNTED_PIXELS_MIN:
        counted = ", ".join(f"{one.tap} {one.counted_pixels:.1f}" for one in agreements)
        raise CannotCheck(
            f"paper at T = {temperature} counts too few pixels an image: {counted}; wanted at "
            f"least {COUNTED_PIXELS_MIN} in every tap, which a higher --temperature gives"
        )


def print_table(results: Sequence[tuple[Answer, Sequence[Agreement]]]) -> None:
    """Prints how near both sides are, a line for each metric and tap."""
    print(
        f"{'metric':22} {'tap':30} {'difference':>10} {'edges aside':>11} {'edge pixels':>11} "
        f"{'pixels/image':>12} {'peak':>8} {'bin mass':>8}"
    )
    for answer, agreements in results:
        for one in agreements:
            metric = one.metric
            if metric == "paper":
                metric += f" T = {answer.temperature}"
            mass = "" if one.mass_deviation is None else f"{one.mass_deviation:8.1%}"
            print(
                f"{metric:22} {one.tap:30} {one.difference:10.1e} "
                f"{one.difference_without_edges:11.1e} {one.edge_pixels:11} "
                f"{one.counted_pixels:12.1f} {one.peak_difference:8.0e} {mass}"
            )


def summary(
    sets: Sequence[PictureSet], results: Sequence[tuple[Answer, Sequence[Agreement]]]
) -> dict[str, Any]:
    """The table for programs."""
    return {
        "sets": {one.title: one.images for one in sets},
        "results": [
            {
                "metric": one.metric,
                "temperature": answer.temperature if one.metric == "paper" else None,
                "tap": one.tap,
                "largest_difference": one.difference,
                "largest_difference_edge_pixels_aside": one.difference_without_edges,
                "edge_pixels": one.edge_pixels,
                "counted_pixels_per_image": one.counted_pixels,
                "median_peak_relative_difference": one.peak_difference,
                "largest_bin_mass_deviation": one.mass_deviation,
            }
            for answer, agreements in results
            for one in agreements
        ],
    }


def check_sets(
    program: Path, model_flags: Sequence[str], sets: Sequence[PictureSet], temperature: str
) -> list[tuple[Answer, Sequence[Agreement]]]:
    """Runs and checks both comparisons; raises Disagreement or CannotCheck."""
    answers = [
        compare(program, model_flags, sets, "all", f"{oracle.PAPER_TEMPERATURE:g}"),
        compare(program, model_flags, sets, "paper", temperature),
    ]
    results = [(answer, check_answer(answer, sets)) for answer in answers]
    check_enough_counted(results[1][1], temperature)
    check_taps_differ(answers, sets)
    return [*results]


def check(arguments: argparse.Namespace) -> None:
    """Does all that the command line asks for."""
    options = ModelOptions.from_toml(arguments.options)
    model_flags = [] if arguments.built_in else ["--model", str(arguments.model), *options.flags()]
    folders = [arguments.reference, *arguments.sets]
    if len(set(folders)) != len(folders):
        raise CannotCheck("wanted each folder once")
    with tempfile.TemporaryDirectory() as scratch:
        names = [without_jpeg(folder, Path(scratch)) for folder in folders]
        sets = seen_by_oracle(TappedModel(arguments.model, options), folders, names)
        results = check_sets(arguments.gapwatch, model_flags, sets, arguments.temperature)
        jpeg = {
            str(folder): check_jpeg(arguments.gapwatch, model_flags, folder, name)
            for folder, name in zip(folders, names, strict=True)
            if folder != name
        }
    for one in sets:
        judged = len(one.maps[options.taps[0]])
        role = "reference" if one is sets[0] else "set"
        print(f"{role:9} {one.images:5} images, {judged:5} judged  {one.title}")
    for title, divergence in jpeg.items():
        print(f"JPEG decoded by gapwatch against Pillow: {divergence:.1e} bits  {title}")
    print_table(results)
    print(json.dumps({**summary(sets, results), "jpeg_divergence_bits": jpeg}))
    agreements = [one for _, found in results for one in found]
    worst = max(one.difference_without_edges for one in agreements)
    print(
        f"compare agrees with the oracle: {sum(one.images for one in sets)} images, "
        f"{len(options.taps)} taps, {len(METRICS)} metrics, largest difference {worst:.1e}"
    )


def main() -> int:
    """Reads the command line, checks, prints; returns the exit code."""
    parser = argparse.ArgumentParser(
        description="Checks gapwatch compare against an independent computation.",
        epilog="example: check_compare.py --gapwatch target/release/gapwatch --built-in "
        "--model calibration/enet-sad-lite-320x160.onnx "
        "--options calibration/enet-sad-lite-320x160.toml clean/frames fog/frames night/frames",
    )
    parser.add_argument("reference", type=Path, metavar="REFERENCE_DIR", help="folder of pictures")
    parser.add_argument("sets", type=Path, nargs="+", metavar="SET_DIR", help="folders to compare")
    parser.add_argument("--gapwatch", type=Path, required=True, metavar="PROGRAM")
    parser.add_argument("--model", type=Path, required=True, metavar="ONNX")
    parser.add_argument("--options", type=Path, required=True, metavar="TOML")
    parser.add_argument(
        "--built-in",
        action="store_true",
        help="let gapwatch use its built-in model; --model and --options must be the same one",
    )
    parser.add_argument(
        "--temperature",
        default="0.2peak",
        metavar="T",
        help="of the second comparison by the metric paper (default: %(default)s)",
    )
    try:
        check(parser.parse_args())
    except Disagreement as found:
        print(f"compare disagrees with the oracle: {found}", file=sys.stderr)
        return 1
    except KeyError as key:
        print(f"compare disagrees with the oracle: key {key} is missing", file=sys.stderr)
        return 1
    except (CannotCheck, OSError, ValueError) as why:
        print(f"{parser.prog}: cannot check: {why}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
