"""Recordings of every kind that cameras and recorders make, written with the packages mcap and mcap-ros2-support, and what
is right for each: order and log times by Python's reader of MCAP, colours by OpenCV.

usage: foreign_recordings.py FOLDER     writes recordings, pictures and cases.json
"""

import io
import json
import struct
import sys
from pathlib import Path

import cv2
import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as Ros2Writer
from PIL import Image

COUNT = 24
BEGAN_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
SIZE = (96, 48)
HEADER = "\n" + "=" * 80 + """
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
""" + "=" * 80 + """
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
RAW = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data" + HEADER
COMPRESSED = "std_msgs/Header header\nstring format\nuint8[] data" + HEADER


def picture(number):
    """Smooth, so that colours between pixels are plain; another for each number."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    channels = [60 + x + number, 200 - 2 * y - number, 40 + x // 2 + y + 2 * number]
    return np.dstack(channels).astype(np.uint8)


def png(rgb):
    data = io.BytesIO()
    Image.fromarray(rgb).save(data, "PNG")
    return data.getvalue()


def stamp(ns):
    seconds, nanoseconds = divmod(ns, 10**9)
    return {"sec": seconds, "nanosec": nanoseconds}


def log_time(number):
    return BEGAN_NS + number * STEP_NS


class Cases:
    def __init__(self, folder):
        self.folder, self.cases = Path(folder), []
        for number in range(COUNT):
            Image.fromarray(picture(number)).save(self.folder / f"{number}.png")

    def path(self, name):
        return self.folder / name

    def read(self, name, source, times=None, pictures=None, tolerance=0):
        """A case that is read, with the first picture of this recording at 0 s."""
        self.cases.append({
            "name": name, "source": source, "tolerance": tolerance,
            "times_s": times or [number * STEP_NS / 1e9 for number in range(COUNT)],
            "pictures": pictures or [f"{number}.png" for number in range(COUNT)],
        })

    def by_reader(self, name, source):
        """A case whose order and times are those of Python's reader in the order of log times."""
        with open(self.path(source), "rb") as file:
            messages = [message for _, _, message in make_reader(file).iter_messages(log_time_order=True)]
        self.read(name, source, [(message.log_time - messages[0].log_time) / 1e9 for message in messages],
                  [f"{message.sequence}.png" for message in messages])

    def refused(self, name, source, said):
        self.cases.append({"name": name, "source": source, "refused": said})

    def ros(self, file, messages, schema, compression=CompressionType.ZSTD, chunk=1_000_000, topic="/camera/image"):
        with open(self.path(file), "wb") as out:
            writer = Ros2Writer(out, compression=compression, chunk_size=chunk)
            registered = writer.register_msgdef(f"sensor_msgs/msg/{schema}", RAW if schema == "Image" else COMPRESSED)
            for number, ns, message in messages:
                writer.write_message(topic, registered, message, ns, ns, number)
            writer.finish()


def compressed(number, ns=None, form="png", data=None):
    ns = log_time(number) if ns is None else ns
    return {"header": {"stamp": stamp(ns), "frame_id": "camera"}, "format": form, "data": data or png(picture(number))}


def serialised(number):
    """The message of `compressed` in little-endian CDR."""
    data, ns = png(picture(number)), log_time(number)
    text = lambda value: struct.pack("<I", len(value) + 1) + value + b"\0"
    fields = struct.pack("<iI", ns // 10**9, ns % 10**9) + text(b"camera")
    fields += b"\0" * (-len(fields) % 4) + text(b"png")
    fields += b"\0" * (-len(fields) % 4) + struct.pack("<I", len(data)) + data
    return b"\0\1\0\0" + fields


def plain(path, order, message=serialised, chunked=True, chunk=1_000_000, schema="sensor_msgs/msg/CompressedImage", encoding="cdr", summary=True, finish=True):
    """A recording written message by message, without the package of ROS."""
    with open(path, "wb") as out:
        writer = Writer(out, chunk_size=chunk, use_chunking=chunked, use_statistics=summary, use_summary_offsets=summary,
                        repeat_channels=summary, repeat_schemas=summary)
        writer.start("ros2")
        registered = writer.register_schema(schema, "ros2msg", COMPRESSED.encode())
        channel = writer.register_channel("/camera", encoding, registered)
        for number in order:
            writer.add_message(channel, log_time(number), message(number), log_time(number), number)
        writer.finish()


def encodings(cases):
    grey = {number: cv2.cvtColor(picture(number), cv2.COLOR_RGB2GRAY) for number in range(COUNT)}
    wide = lambda pixels, order="<": (pixels.astype(np.uint16) * 256 + 37).astype(order + "u2")
    def mosaic(rgb, order):
        out = np.zeros(rgb.shape[:2], np.uint8)
        for place, colour in enumerate(order):
            out[place // 2::2, place % 2::2] = rgb[place // 2::2, place % 2::2, "rgb".index(colour)]
        return out
    def planes(rgb, form):
        i420 = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420)
        rows = SIZE[1]
        luma, u, v = i420[:rows], i420[rows:rows * 5 // 4].reshape(rows // 2, -1), i420[rows * 5 // 4:].reshape(rows // 2, -1)
        return {
            "i420": i420, "yuv420": i420, "yv12": np.vstack([luma, v.reshape(-1, SIZE[0]), u.reshape(-1, SIZE[0])]),
            "nv12": np.vstack([luma, np.dstack([u, v]).reshape(rows // 2, -1)]),
            "nv21": np.vstack([luma, np.dstack([v, u]).reshape(rows // 2, -1)]),
        }[form]
    pixels = {
        "rgb16": lambda rgb, n: wide(rgb), "bgr16": lambda rgb, n: wide(rgb[..., ::-1]),
        "rgba16": lambda rgb, n: wide(np.dstack([rgb, rgb[..., :1]])), "bgra16": lambda rgb, n: wide(np.dstack([rgb[..., ::-1], rgb[..., :1]])),
        "16UC3": lambda rgb, n: wide(rgb[..., ::-1]), "mono16": lambda rgb, n: wide(grey[n]), "16UC1": lambda rgb, n: wide(grey[n]),
        "8UC1": lambda rgb, n: grey[n], "8UC4": lambda rgb, n: np.dstack([rgb[..., ::-1], rgb[..., :1]]),
    }
    for order in ["rggb", "bggr", "gbrg", "grbg"]:
        pixels[f"bayer_{order}8"] = lambda rgb, n, order=order: mosaic(rgb, order)
        pixels[f"bayer_{order}16"] = lambda rgb, n, order=order: wide(mosaic(rgb, order))
    for form in ["nv12", "nv21", "i420", "yuv420", "yv12"]:
        pixels[form] = lambda rgb, n, form=form: planes(rgb, form)
    # What OpenCV makes of each; it names a mosaic by the colours of the second row and column.
    mosaics = {"rggb": cv2.COLOR_BayerBG2RGB, "bggr": cv2.COLOR_BayerRG2RGB, "gbrg": cv2.COLOR_BayerGR2RGB, "grbg": cv2.COLOR_BayerGB2RGB}
    yuv = {"nv12": cv2.COLOR_YUV2RGB_NV12, "nv21": cv2.COLOR_YUV2RGB_NV21, "i420": cv2.COLOR_YUV2RGB_I420, "yuv420": cv2.COLOR_YUV2RGB_I420, "yv12": cv2.COLOR_YUV2RGB_YV12}
    def seen(encoding, number):
        rgb = picture(number)
        if encoding.startswith("bayer"):
            return cv2.demosaicing(mosaic(rgb, encoding[6:10]), mosaics[encoding[6:10]]), 1
        if encoding in yuv:
            return cv2.cvtColor(planes(rgb, encoding), yuv[encoding]), 2
        if encoding in ("mono16", "16UC1", "8UC1"):
            return cv2.cvtColor(grey[number], cv2.COLOR_GRAY2RGB), 0
        return rgb, 0
    for big in [False, True]:
        for encoding, of in pixels.items():
            if big and not encoding.endswith("16"):
                continue
            name = f"{encoding}{'-big' if big else ''}"
            messages, pictures, tolerance = [], [], 0
            for number in range(6):
                rgb = picture(number)
                data = of(rgb, number)
                if big:
                    data = data.astype(">u2")
                step = SIZE[0] if encoding in yuv else data.strides[0] if data.flags["C_CONTIGUOUS"] else data[0].nbytes
                message = {"header": {"stamp": stamp(log_time(number)), "frame_id": "camera"}, "height": SIZE[1], "width": SIZE[0],
                           "encoding": encoding, "is_bigendian": int(big), "step": step, "data": np.ascontiguousarray(data).tobytes()}
                messages.append((number, log_time(number), message))
                wanted, tolerance = seen(encoding, number)
                pictures.append(f"{name}-{number}.png")
                Image.fromarray(np.ascontiguousarray(wanted)).save(cases.path(pictures[-1]))
            cases.ros(f"{name}.mcap", messages, "Image")
            cases.read(name, f"{name}.mcap", [number * 0.1 for number in range(6)], pictures, tolerance)
    depth = {"header": {"stamp": stamp(0), "frame_id": "d"}, "height": 1, "width": 1, "encoding": "32FC1", "is_bigendian": 0, "step": 4, "data": b"\0" * 4}
    cases.ros("floats.mcap", [(0, log_time(0), depth)], "Image")
    cases.refused("floats", "floats.mcap", 'encoding "32FC1", wanted rgb8')
    for form, said in [("16UC1; compressedDepth png", "distances"), ("h264", 'format "h264"'), ("webp", 'format "webp"')]:
        file = f"form-{form[:4]}.mcap"
        data = struct.pack("<iff", 0, 0, 0) + png(picture(0))
        cases.ros(file, [(number, log_time(number), compressed(number, form=form, data=data)) for number in range(3)], "CompressedImage")
        cases.refused(form, file, said)
    for number, form in enumerate(["", "PNG", "rgb8; png compressed bgr8"]):
        file = f"spelling-{number}.mcap"
        cases.ros(file, [(number, log_time(number), compressed(number, form=form)) for number in range(COUNT)], "CompressedImage")
        cases.read(f"format {form!r}", file)


def order(cases):
    halves = [*range(COUNT // 2, COUNT), *range(COUNT // 2)]
    pairs = [number ^ 1 for number in range(COUNT)]
    interleaved = [number % 3 * 8 + number // 3 for number in range(COUNT)]
    for name, numbers in [("halves", halves), ("pairs", pairs), ("interleaved", interleaved), ("backwards", [*range(COUNT)][::-1])]:
        for chunk in [1, 20_000, 1_000_000]:
            plain(cases.path(f"{name}-{chunk}.mcap"), numbers, chunk=chunk)
            cases.by_reader(f"{name}, chunks of {chunk}", f"{name}-{chunk}.mcap")
    plain(cases.path("no-chunks.mcap"), pairs, chunked=False)
    cases.by_reader("pairs without chunks", "no-chunks.mcap")
    plain(cases.path("no-summary.mcap"), pairs, summary=False, chunk=20_000)
    cases.read("pairs without a summary", "no-summary.mcap")


def stamps(cases):
    def case(name, stamp_of, times=None):
        messages = [(number, log_time(number), compressed(number, stamp_of(number))) for number in range(COUNT)]
        file = f"stamps-{len(cases.cases)}.mcap"
        cases.ros(file, messages, "CompressedImage")
        cases.read(name, file, times)
    case("no stamps", lambda n: 0)
    case("the first image without a stamp", lambda n: log_time(n) if n else 0)
    case("stamps from the tenth image on", lambda n: log_time(n) if n > 9 else 0)
    case("clock set after five images", lambda n: log_time(n) if n > 4 else 12_000_000_000 + n * STEP_NS)
    case("clock set back", lambda n: log_time(n) - (5_000_000_000 if n > 9 else 0))
    case("clock set forward", lambda n: log_time(n) + (4_000_000_000 if n > 9 else 0))
    case("time since power-up", lambda n: 40_000_000_000 + n * STEP_NS)
    case("one stamp for all", lambda n: BEGAN_NS)
    case("one stamp for two", lambda n: log_time(n // 2 * 2))
    case("before the epoch", lambda n: -5_000_000_000 + n * STEP_NS)
    # The camera's own times count where they are a clock: a rate of its own, and a real pause.
    case("its own rate", lambda n: 7_000_000_000 + n * 99_000_000, [n * 0.099 for n in range(COUNT)])


def containers(cases):
    packer = zstandard.ZstdCompressor()
    plain(cases.path("packed-messages.mcap"), range(COUNT), message=lambda number: packer.compress(serialised(number)))
    cases.read("messages compressed one by one", "packed-messages.mcap")
    plain(cases.path("whole.mcap"), range(COUNT))
    whole = cases.path("whole.mcap").read_bytes()
    for end in ["mcap.zstd", "mcap.zst", "bin"]:
        cases.path(f"packed.{end}").write_bytes(packer.compress(whole))
        cases.read(f"a file compressed as a whole, .{end}", f"packed.{end}")
    cases.path("packed.mcap.gz").write_bytes(b"\x1f\x8b" + whole)
    cases.refused("compressed otherwise", "packed.mcap.gz", "unpacked first")
    for name, magic, said in [("old.bag", b"#ROSBAG V2.0\n", "recording of ROS 1"), ("a.db3", b"SQLite format 3\0", "ros2 bag convert")]:
        cases.path(name).write_bytes(magic + b"\0" * 100)
        cases.refused(name, name, said)
    names = [f"drive_{part}.mcap" for part in [9, 10, 11]]
    parts = dict(zip(names, [range(0, 9), range(9, 20), range(20, COUNT)]))
    listed = "".join(f"    - {file}\n" for file in names)
    metadata = f"rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n{listed}"
    for name, listed, end in [("split", metadata, ""), ("unlisted", None, ""), ("split-packed", metadata, ".zstd"), ("missing", "relative_file_paths: [drive_9.mcap, drive_12.mcap]", "")]:
        folder = cases.path(name)
        folder.mkdir()
        for file, numbers in parts.items():
            plain(folder / file, numbers)
            if end:
                (folder / f"{file}{end}").write_bytes(packer.compress((folder / file).read_bytes()))
                (folder / file).unlink()
        if listed:
            (folder / "metadata.yaml").write_text(listed)
        (folder / "._drive_9.mcap").write_bytes(b"\0" * 9)
        if name == "missing":
            cases.refused("a part that is missing", name, "names drive_12.mcap")
        else:
            cases.read(f"a recording in parts, {name}", name)
    cases.read("a topic of a recording in parts", "split?topic=/camera")
    folder = cases.path("sqlite")
    folder.mkdir()
    (folder / "drive_0.db3").write_bytes(b"SQLite format 3\0" + b"\0" * 99)
    cases.refused("a folder in SQLite", "sqlite", "ros2 bag convert")
    cases.refused("a rate for a recording in parts", "split?fps=3", "own times")


def topics(cases):
    with open(cases.path("nothing.mcap"), "wb") as out:
        writer = Ros2Writer(out)
        for topic in ["/front", "/rear"]:
            schema = writer.register_msgdef("sensor_msgs/msg/Image", RAW)
            writer._writer.register_channel(topic, "cdr", schema.id)
        writer.finish()
    cases.refused("topics without messages", "nothing.mcap", "no image on its topics with images: /front")
    cases.refused("a topic without messages", "nothing.mcap?topic=/rear", "no message on topic /rear")
    with open(cases.path("one.mcap"), "wb") as out:
        writer = Ros2Writer(out)
        schema = writer.register_msgdef("sensor_msgs/msg/CompressedImage", COMPRESSED)
        writer._writer.register_channel("/rear", "cdr", schema.id)
        for number in range(COUNT):
            writer.write_message("/front", schema, compressed(number), log_time(number), log_time(number), number)
        writer.finish()
    cases.read("one topic of two has messages", "one.mcap")
    plain(cases.path("ros1.mcap"), range(3), message=lambda number: b"\0" * 40, schema="sensor_msgs/CompressedImage", encoding="ros1")
    cases.refused("messages of ROS 1", "ros1.mcap", "in ros1")


if __name__ == "__main__":
    cases = Cases(sys.argv[1])
    for part in [encodings, order, stamps, containers, topics]:
        part(cases)
    cases.path("cases.json").write_text(json.dumps(cases.cases, indent=1))
    print(len(cases.cases), "cases")
