"""Pictures as cameras, phones and tools write them, each with what Pillow or OpenCV (both libjpeg-turbo) or NumPy says is right.

make_pictures.py FOLDER: for each case FOLDER/CASE/given.jpg or given.png, beside it right.png, or nothing where the file is damaged.
"""

import io
import random
import struct
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

ImageFile.LOAD_TRUNCATED_IMAGES = True

# Tables of ITU-T T.81, annex K: counts by length, then values.
DC = [0, 1, 5, 1, 1, 1, 1, 1, 1] + [0] * 7, list(range(12))


def standard_ac():
    """The table of luma, from a file that Pillow writes with it."""
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "JPEG")
    for marker, body in segments(file.getvalue())[0]:
        if marker == 0xC4 and body[0] == 0x10:
            return list(body[1:17]), list(body[17:])
    raise AssertionError("no table")


def segments(jpeg):
    """The segments up to the first scan's header, and the bytes behind it."""
    at, found = 2, []
    while True:
        marker, length = jpeg[at + 1], struct.unpack(">H", jpeg[at + 2 : at + 4])[0]
        found.append((marker, jpeg[at + 4 : at + 2 + length]))
        at += 2 + length
        if marker == 0xDA:
            return found, jpeg[at:]


def segment(marker, body):
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def joined(found, rest):
    return b"\xff\xd8" + b"".join(segment(*of) for of in found) + rest


def codes(table):
    code, result, values = 0, {}, iter(table[1])
    for length, count in enumerate(table[0], 1):
        for _ in range(count):
            result[next(values)] = (code, length)
            code += 1
        code *= 2
    return result


ZIGZAG = sorted(range(64), key=lambda n: (n // 8 + n % 8, (n // 8 if (n // 8 + n % 8) % 2 else n % 8)))
COSINES = np.array([[np.cos((2 * x + 1) * u * np.pi / 16) * (0.5 if u else 8**-0.5) for x in range(8)] for u in range(8)])


class Bits:
    def __init__(self):
        self.text = []

    def put(self, value, length):
        if length:
            self.text.append(format(value, f"0{length}b"))

    def bytes(self):
        text = "".join(self.text)
        text += "1" * (-len(text) % 8)
        raw = bytes(int(text[at : at + 8], 2) for at in range(0, len(text), 8))
        return raw.replace(b"\xff", b"\xff\x00")


def size_of(value):
    return int(abs(value)).bit_length()


def put_block(bits, block, before, dc, ac):
    def put_value(value, size):
        bits.put(value if value > 0 else value + (1 << size) - 1, size)

    size = size_of(block[0] - before)
    bits.put(*dc[size])
    put_value(block[0] - before, size)
    run = 0
    for value in block[1:]:
        if value == 0:
            run += 1
            continue
        while run > 15:
            bits.put(*ac[0xF0])
            run -= 16
        size = size_of(value)
        bits.put(*ac[run * 16 + size])
        put_value(value, size)
        run = 0
    if run:
        bits.put(*ac[0])
    return block[0]


def encoded(picture, sampling, scans=None, interval=0, surplus=b"", tables=True, step=6, adobe=None):
    """Baseline JPEG of the components of a picture, `[height, width, components]`.

    sampling: (across, down) for each component; scans: components of each scan; interval: units between restart markers;
    surplus: bytes before each marker that ends data.
    """
    height, width, count = picture.shape
    across, down = max(s[0] for s in sampling), max(s[1] for s in sampling)
    units = -(-width // (8 * across)), -(-height // (8 * down))
    ac_table = standard_ac()
    dc, ac = codes(DC), codes(ac_table)
    blocks, needed = [], []
    for (h, v), plane in zip(sampling, picture.transpose(2, 0, 1)):
        size = units[1] * 8 * v, units[0] * 8 * h
        own = -(-height * v // down), -(-width * h // across)
        small = Image.fromarray(plane).resize(own[::-1], Image.BOX)
        full = np.pad(np.asarray(small, float), [(0, size[0] - own[0]), (0, size[1] - own[1])], mode="edge") - 128
        tiles = full.reshape(size[0] // 8, 8, size[1] // 8, 8).transpose(0, 2, 1, 3)
        levels = np.rint(COSINES @ tiles @ COSINES.T / step).astype(int).reshape(*tiles.shape[:2], 64)
        blocks.append(levels[..., ZIGZAG])
        needed.append((-(-own[0] // 8), -(-own[1] // 8)))
    data = segment(0xDB, bytes([0]) + bytes([step]) * 64)
    frame = struct.pack(">BHHB", 8, height, width, count)
    frame += b"".join(bytes([n + 1, h << 4 | v, 0]) for n, (h, v) in enumerate(sampling))
    data += segment(0xC0, frame)
    if adobe is not None:
        data += segment(0xEE, b"Adobe" + struct.pack(">HHHB", 100, 0, 0, adobe))
    if tables:
        for kind, table in ((0x00, DC), (0x10, ac_table)):
            data += segment(0xC4, bytes([kind, *table[0], *table[1]]))
    if interval:
        data += segment(0xDD, struct.pack(">H", interval))
    for scan in scans or [range(count)]:
        scan = list(scan)
        data += segment(0xDA, bytes([len(scan)]) + b"".join(bytes([n + 1, 0]) for n in scan) + bytes([0, 63, 0]))
        if len(scan) == 1:
            rows, columns = needed[scan[0]]
            order = [[(scan[0], y, x)] for y in range(rows) for x in range(columns)]
        else:
            order = [
                [(n, y * sampling[n][1] + i, x * sampling[n][0] + j) for n in scan for i in range(sampling[n][1]) for j in range(sampling[n][0])]
                for y in range(units[1])
                for x in range(units[0])
            ]
        for number, start in enumerate(range(0, len(order), interval or len(order))):
            if number:
                data += bytes([0xFF, 0xD0 + (number - 1) % 8])
            bits, before = Bits(), [0] * count
            for unit in order[start : start + (interval or len(order))]:
                for n, y, x in unit:
                    before[n] = put_block(bits, blocks[n][y, x], before[n], dc, ac)
            data += bits.bytes() + surplus
    return b"\xff\xd8" + data + b"\xff\xd9"


def road(width, height, seed=1):
    """Sky, ground, lines and grain."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    sky = np.dstack([120 + x / width * 60, 150 + y / height * 40, 200 - y / height * 60])
    ground = np.dstack([90 + y / height * 40, 92 + x / width * 30, 80 + 0 * x])
    picture = np.where((y > height * 0.45)[..., None], ground, sky)
    picture[np.abs(x - width / 2 - (y - height / 2) * 0.7) < 3] = (240, 235, 200)
    picture += np.random.default_rng(seed).normal(0, 6, picture.shape)
    return picture.clip(0, 255).astype(np.uint8)


def exif(orientation, order="<"):
    head = b"II*\0" if order == "<" else b"MM\0*"
    entry = struct.pack(order + "HHIHH", 0x112, 3, 1, orientation, 0)
    return head + struct.pack(order + "IH", 8, 1) + entry + bytes(4)


def saved(picture, **options):
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", **{"quality": 90, **options})
    return file.getvalue()


def with_segment(jpeg, marker, body):
    found, rest = segments(jpeg)
    return joined([(marker, body), *found], rest)


def jpegs():
    """Name, file, and whether the picture is whole."""
    for size in ((96, 64), (131, 77)):
        picture = road(*size)
        ycc = np.asarray(Image.fromarray(picture).convert("YCbCr"))
        grey = ycc[..., :1]
        of = f"{size[0]}x{size[1]}"
        for name, sampling in {
            "444": [(1, 1)] * 3,
            "422": [(2, 1), (1, 1), (1, 1)],
            "420": [(2, 2), (1, 1), (1, 1)],
            "440": [(1, 2), (1, 1), (1, 1)],
            "411": [(4, 1), (1, 1), (1, 1)],
            "410": [(4, 2), (1, 1), (1, 1)],
            "triple": [(3, 1), (1, 1), (1, 1)],
            "colours-apart": [(2, 2), (2, 1), (1, 2)],
            "fine-colour": [(1, 1), (2, 2), (1, 1)],
        }.items():
            yield f"{of}-{name}", encoded(ycc, sampling), True
            yield f"{of}-{name}-scans", encoded(ycc, sampling, scans=[[0], [1], [2]]), True
            yield f"{of}-{name}-two-scans", encoded(ycc, sampling, scans=[[0], [1, 2]]), True
        half = [(2, 2), (1, 1), (1, 1)]
        yield f"{of}-grey", encoded(grey, [(1, 1)]), True
        yield f"{of}-grey-2x2", encoded(grey, [(2, 2)]), True
        yield f"{of}-no-tables", encoded(ycc, half, tables=False), True
        yield f"{of}-no-tables-avi1", with_segment(encoded(ycc, half, tables=False), 0xE0, b"AVI1" + bytes(10)), True
        yield f"{of}-no-tables-no-end", encoded(ycc, half, tables=False)[:-2], True
        yield f"{of}-restarts", encoded(ycc, half, interval=3), True
        yield f"{of}-surplus-before-restarts", encoded(ycc, half, interval=3, surplus=b"\x12\x34\x56"), True
        yield f"{of}-surplus-before-end", encoded(ycc, half, surplus=b"\x12\x34\x56"), True
        yield f"{of}-zeros-before-end", encoded(ycc, half, surplus=bytes(300)), True
        yield f"{of}-filled-before-end", encoded(ycc, half, surplus=b"\xff" * 7), True
        yield f"{of}-no-tables-surplus", encoded(ycc, half, tables=False, surplus=b"\x12\x34\x56"), True
        yield f"{of}-much-before-end", encoded(ycc, half, surplus=bytes(range(1, 90))), False
        yield f"{of}-rgb", encoded(picture, [(1, 1)] * 3, adobe=0), True
        yield f"{of}-cmyk", encoded(np.dstack([picture, 255 - grey // 3]), [(1, 1)] * 4, adobe=0), True
        yield f"{of}-ycck", encoded(np.dstack([ycc, 255 - grey // 3]), [(2, 2), (1, 1), (1, 1), (2, 2)], adobe=2), True
        yield f"{of}-progressive", saved(picture, progressive=True), True
        yield f"{of}-progressive-no-end", saved(picture, progressive=True)[:-2], True
        yield f"{of}-optimised", saved(picture, optimize=True), True

        whole = saved(picture)
        yield f"{of}-no-end", whole[:-2], True
        yield f"{of}-zeros-behind", whole + bytes(4096), True
        yield f"{of}-second-picture-behind", whole + saved(road(48, 32)), True
        yield f"{of}-film-behind", whole + b"\0\0\0\x18ftypmp42" + random.Random(3).randbytes(50_000), True
        yield f"{of}-second-end", whole + b"\xff\xd9", True
        found, rest = segments(whole)
        yield f"{of}-fill-bytes", b"\xff\xd8" + b"".join(b"\xff\xff" + segment(*one) for one in found) + rest, True
        yield f"{of}-bytes-between-segments", b"\xff\xd8" + b"\x07\x07".join(segment(*one) for one in found) + rest, True
        thumb = exif(1)[:-4] + struct.pack("<I", 26) + struct.pack("<H", 0) + bytes(4) + saved(road(48, 32))
        yield f"{of}-thumbnail", with_segment(whole, 0xE1, b"Exif\0\0" + thumb), True
        for orientation in range(1, 10):
            for order in "<>":
                turned = with_segment(whole, 0xE1, b"Exif\0\0" + exif(orientation, order))
                yield f"{of}-orientation-{orientation}-{'IM'[order == '>']}", turned, True
        yield f"{of}-broken-exif", with_segment(whole, 0xE1, b"Exif\0\0II*\0\xff\xff\xff\xff"), True

        scans = encoded(ycc, half, scans=[[0], [1], [2]])
        last = scans.rindex(b"\xff\xda")
        yield f"{of}-scan-missing", scans[:last] + b"\xff\xd9", False
        yield f"{of}-scan-missing-no-end", scans[:last], False
        progressive = saved(picture, progressive=True)
        yield f"{of}-progressive-cut-between-scans", progressive[: progressive.rindex(b"\xff\xc4")], False
        yield f"{of}-cut", whole[: len(whole) // 2], False
        yield f"{of}-cut-and-ended", whole[: len(whole) // 2] + b"\xff\xd9", False
        yield f"{of}-cut-in-the-header", whole[:300], False
        yield f"{of}-start-missing", whole[2:], False
        middle = len(whole) * 2 // 3
        yield f"{of}-bytes-lost", whole[: middle - 400] + whole[middle:], False
        restarts = encoded(ycc, half, interval=3)
        middle = len(restarts) * 2 // 3
        yield f"{of}-bytes-lost-with-restarts", restarts[: middle - 500] + restarts[middle:], False


def right_of(jpeg):
    try:
        image = Image.open(io.BytesIO(jpeg))
    except UnidentifiedImageError:
        # It wants segments without bytes between them.
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    image.load()
    return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def packed(rows, depth):
    if depth == 16:
        return [row.astype(">u2").tobytes() for row in rows]
    bits = np.unpackbits(rows.astype(np.uint8)[..., None], axis=-1)[..., 8 - depth :]
    return [np.packbits(row.reshape(-1)).tobytes() for row in bits]


def png(values, colour, depth=8, interlaced=False, before=b"", behind=b""):
    """A PNG of `[height, width]` or `[height, width, channels]`."""
    height, width = values.shape[:2]
    passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
    parts = [values[y::dy, x::dx] for x, y, dx, dy in passes] if interlaced else [values]
    raw = b"".join(b"\0" + row for part in parts if part.size for row in packed(part, depth))
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, int(interlaced))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + before + chunk(b"IDAT", zlib.compress(raw)) + behind + chunk(b"IEND", b"")


def pngs():
    """Name, file, and the right pixels; None where it is damaged."""
    picture = road(131, 77)
    grey = picture[..., 1]
    alpha = (np.indices(grey.shape)[1] * 2 % 256).astype(np.uint8)

    def three(values):
        return np.repeat(values[..., None], 3, 2)

    for interlaced in (False, True):
        of = "png-interlaced" if interlaced else "png"
        yield f"{of}-rgb", png(picture, 2, interlaced=interlaced), picture
        yield f"{of}-rgb16", png(picture.astype(np.uint16) * 257, 2, 16, interlaced), picture
        yield f"{of}-rgba", png(np.dstack([picture, alpha]), 6, interlaced=interlaced), picture
        yield f"{of}-grey16", png(grey.astype(np.uint16) * 257, 0, 16, interlaced), three(grey)
        yield f"{of}-grey-alpha", png(np.dstack([grey, alpha]), 4, interlaced=interlaced), three(grey)
        for depth in (1, 2, 4, 8):
            levels = grey >> (8 - depth)
            yield f"{of}-grey{depth}", png(levels, 0, depth, interlaced), three(levels * (255 // ((1 << depth) - 1)))
            palette = np.random.default_rng(depth).integers(0, 256, (1 << depth, 3), np.uint8)
            tables = chunk(b"PLTE", palette.tobytes()) + chunk(b"tRNS", bytes(len(palette)))
            yield f"{of}-palette{depth}", png(levels, 3, depth, interlaced, before=tables), palette[levels]
    for orientation in range(1, 10):
        turn = chunk(b"eXIf", exif(orientation, "<>"[orientation % 2]))
        image = Image.fromarray(picture)
        image.getexif()[0x112] = orientation
        right = np.asarray(ImageOps.exif_transpose(image))
        yield f"png-orientation-{orientation}", png(picture, 2, before=turn), right
        yield f"png-orientation-behind-{orientation}", png(picture, 2, behind=turn), right
    whole = png(picture, 2)
    yield "png-bytes-behind", whole + b"more" * 50, picture
    yield "png-cut", whole[: len(whole) // 2], None
    yield "png-cut-before-the-end", whole[:-12], None
    broken = bytearray(whole)
    broken[len(broken) // 2] ^= 4
    yield "png-changed-byte", bytes(broken), None


def main(folder):
    def put(name, ending, file, right):
        place = Path(folder) / name
        place.mkdir()
        (place / f"given.{ending}").write_bytes(file)
        if right is not None:
            Image.fromarray(right).save(place / "right.png")

    for name, file, whole in jpegs():
        put(name, "jpg", file, right_of(file) if whole else None)
    for name, file, right in pngs():
        put(name, "png", file, right)


main(sys.argv[1])
