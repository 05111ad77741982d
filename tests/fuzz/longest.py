"""Time that the slowest pictures take, by size: longest.py [PROGRAM], which is target/release/gapwatch.

Each line gives milliseconds a frame of the whole `replay`, from the difference between long and short replays of the same
picture, at half a megapixel, at 2 and at 8. Needs what tests/requirements.txt names.
"""

import io
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile

ImageFile.MAXBLOCK = 1 << 28
SIZES = [(960, 540), (1920, 1080), (3840, 2160)]
SHORT, LONG = 4, 16
# Scans of which a JPEG image may have most.
SCANS = 20


def pixels(width: int, height: int, block: int) -> np.ndarray:
    """Random colours, each over `block` x `block` pixels."""
    coarse = np.random.default_rng(1).integers(0, 256, (height // block, width // block, 3), np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((width, height)))


def jpeg(picture: np.ndarray, **settings) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", **settings)
    return file.getvalue()


def with_scans(file: bytes, wanted: int) -> bytes:
    """The file with its last scan repeated, until it has `wanted`."""
    scans = file.count(b"\xff\xda")
    last = file.rindex(b"\xff\xda")
    return file[:-2] + file[last:-2] * (wanted - scans) + file[-2:]


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(width: int, height: int, kind: tuple[int, int, int], rows: bytes, more: bytes = b"") -> bytes:
    """`kind`: bits, colour type, interlace."""
    bits, colour, interlace = kind
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlace)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + more + chunk(b"IDAT", zlib.compress(rows, 1))
            + chunk(b"IEND", b""))


def rows(width: int, height: int, pixel: int) -> bytes:
    """Random rows of `pixel` bytes a pixel, each of the filter that takes longest."""
    values = np.random.default_rng(1).integers(0, 256, (height, 1 + pixel * width), np.uint8)
    values[:, 0] = 4
    return values.tobytes()


def interlaced(width: int, height: int, pixel: int) -> bytes:
    passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
    sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in passes]
    return b"".join(rows(w, h, pixel) for w, h in sizes)


def profile() -> bytes:
    return chunk(b"iCCP", b"a\0\0" + zlib.compress(bytes(400_000_000), 9))


PICTURES: dict[str, Callable[[int, int], bytes]] = {
    "JPEG, quality 80": lambda w, h: jpeg(pixels(w, h, 4), quality=80),
    "JPEG, noise, quality 100, 4:4:4": lambda w, h: jpeg(pixels(w, h, 1), quality=100, subsampling=0),
    "the same, progressive": lambda w, h: jpeg(pixels(w, h, 1), quality=100, subsampling=0, progressive=True),
    f"JPEG, {SCANS} scans of one colour": lambda w, h: with_scans(
        jpeg(np.full((h, w, 3), 128, np.uint8), progressive=True), SCANS),
    f"JPEG, {SCANS} scans": lambda w, h: with_scans(jpeg(pixels(w, h, 4), quality=90, progressive=True), SCANS),
    "PNG, noise, 16 bits, alpha": lambda w, h: png(w, h, (16, 6, 0), rows(w, h, 8)),
    "the same, interlaced": lambda w, h: png(w, h, (16, 6, 1), interlaced(w, h, 8)),
    "PNG with a profile of 400 MB": lambda w, h: png(w, h, (8, 2, 0), bytes((3 * w + 1) * h), profile()),
}


def replayed_s(program: str, file: bytes, ending: str, count: int) -> float:
    with tempfile.TemporaryDirectory() as folder:
        for index in range(count):
            (Path(folder) / f"{index:03}.{ending}").write_bytes(file)
        began = time.monotonic()
        done = subprocess.run([program, "replay", folder, "--quiet"], capture_output=True, text=True, check=False)
        if done.returncode == 2:
            raise SystemExit(f"{program} replay: {done.stderr}")
        return time.monotonic() - began


def lines(program: str) -> Iterator[str]:
    yield f"{'ms a frame':34}" + "".join(f"{w}x{h}".rjust(12) for w, h in SIZES)
    for name, make in PICTURES.items():
        ending = "png" if make(16, 16).startswith(b"\x89") else "jpg"
        cells = []
        for width, height in SIZES:
            file = make(width, height)
            least = [min(replayed_s(program, file, ending, count) for _ in range(3)) for count in (SHORT, LONG)]
            cells.append(f"{1000 * (least[1] - least[0]) / (LONG - SHORT):12.0f}")
        yield f"{name:34}" + "".join(cells)


if __name__ == "__main__":
    for line in lines(sys.argv[1] if len(sys.argv) > 1 else "target/release/gapwatch"):
        print(line, flush=True)
