"""MCAP recordings as others write and read them: the packages mcap, mcap-ros2-support, mcap-protobuf-support, jsonschema.

usage: check_mcap.py write FOLDER-OF-PNG OUT-FOLDER    the pictures as recordings of every form, 10 a second
       check_mcap.py read FILE.mcap JOURNAL            what gapwatch wrote against its journal
"""

import base64
import io
import json
import sys
from pathlib import Path

import jsonschema
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer
from PIL import Image

BEGAN_NS = 1_700_000_000_250_000_000
STEP_NS = 100_000_000
HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""
ROS_IMAGE = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data"
ROS_COMPRESSED = "std_msgs/Header header\nstring format\nuint8[] data"


def png(rgb):
    data = io.BytesIO()
    Image.fromarray(rgb).save(data, "PNG")
    return data.getvalue()


def raw(rgb, encoding):
    """Bytes of the pixels with rows of a multiple of 64 bytes, and that length."""
    channels = {
        "rgb8": rgb, "bgr8": rgb[..., ::-1],
        "rgba8": np.dstack([rgb, np.full_like(rgb[..., 0], 255)]),
        "bgra8": np.dstack([rgb[..., ::-1], np.full_like(rgb[..., 0], 255)]),
        "mono8": rgb[..., :1],
    }[encoding]
    rows = channels.reshape(len(channels), -1)
    step = -(-rows.shape[1] // 64) * 64
    padded = np.full((len(rows), step), 99, np.uint8)
    padded[:, : rows.shape[1]] = rows
    return padded.tobytes(), step


def stamp(ns):
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


def write_ros(path, pictures, compression, message, schema):
    with open(path, "wb") as file:
        writer = Ros2Writer(file, compression=compression, chunk_size=100_000)
        registered = writer.register_msgdef(f"sensor_msgs/msg/{schema}", (ROS_IMAGE if schema == "Image" else ROS_COMPRESSED) + HEADER)
        text = writer.register_msgdef("std_msgs/msg/String", "string data")
        for number, rgb in enumerate(pictures):
            ns = BEGAN_NS + number * STEP_NS
            header = {"stamp": stamp(ns), "frame_id": f"camera{number % 3 * 'x'}"}
            # Recorded late, and not evenly: the image's own time counts.
            late = ns + 5_000_000_000 + number * number * 1_000_000
            writer.write_message("/camera/image", registered, {"header": header, **message(rgb)}, late, ns, number)
            writer.write_message("/said", text, {"data": "hello"}, late, ns, number)
        writer.finish()


def write_protobuf(path, pictures, message):
    with open(path, "wb") as file, ProtobufWriter(file) as writer:
        for number, rgb in enumerate(pictures):
            ns = BEGAN_NS + number * STEP_NS
            sent = message(rgb)
            sent.timestamp.FromNanoseconds(ns)
            sent.frame_id = "camera"
            writer.write_message("/camera/image", sent, log_time=ns + 7, publish_time=ns)


def write_json(path, pictures):
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("foxglove.RawImage", "jsonschema", b"{}")
        channel = writer.register_channel("/camera/image", "json", schema)
        for number, rgb in enumerate(pictures):
            ns = BEGAN_NS + number * STEP_NS
            data, step = raw(rgb, "rgb8")
            message = {
                "timestamp": {"sec": ns // 10**9, "nsec": ns % 10**9}, "frame_id": "camera", "width": rgb.shape[1],
                "height": rgb.shape[0], "encoding": "rgb8", "step": step, "data": base64.b64encode(data).decode(),
            }
            writer.add_message(channel, ns, json.dumps(message).encode(), ns, number)
        writer.finish()


def write(folder, out):
    pictures = [np.asarray(Image.open(path).convert("RGB")) for path in sorted(Path(folder).glob("*.png"))]
    out = Path(out)

    def ros_raw(encoding):
        def message(rgb):
            data, step = raw(rgb, encoding)
            return {"height": rgb.shape[0], "width": rgb.shape[1], "encoding": encoding, "is_bigendian": 0, "step": step, "data": data}
        return message

    def foxglove_raw(rgb):
        data, step = raw(rgb, "bgr8")
        return RawImage(width=rgb.shape[1], height=rgb.shape[0], encoding="bgr8", step=step, data=data)

    zstd, lz4, none = CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE
    write_ros(out / "ros-rgb8.mcap", pictures, zstd, ros_raw("rgb8"), "Image")
    write_ros(out / "ros-bgr8.mcap", pictures, lz4, ros_raw("bgr8"), "Image")
    write_ros(out / "ros-rgba8.mcap", pictures, none, ros_raw("rgba8"), "Image")
    write_ros(out / "ros-bgra8.mcap", pictures, zstd, ros_raw("bgra8"), "Image")
    write_ros(out / "ros-png.mcap", pictures, lz4, lambda rgb: {"format": "rgb8; png compressed bgr8", "data": png(rgb)}, "CompressedImage")
    write_protobuf(out / "foxglove-raw.mcap", pictures, foxglove_raw)
    write_protobuf(out / "foxglove-png.mcap", pictures, lambda rgb: CompressedImage(format="png", data=png(rgb)))
    write_json(out / "foxglove-json.mcap", pictures)
    # Grey pictures have a folder of their own to compare with.
    write_ros(out / "grey-mono8.mcap", pictures, zstd, ros_raw("mono8"), "Image")
    (out / "grey").mkdir()
    for number, rgb in enumerate(pictures):
        Image.fromarray(np.repeat(rgb[..., :1], 3, axis=2)).save(out / "grey" / f"{number:06}.png")
    print(len(pictures), "pictures")


def without_nulls(value):
    if isinstance(value, dict):
        return {key: without_nulls(inner) for key, inner in value.items() if inner is not None and key != "about"}
    return value


def read(path, journal):
    # The first line says what the run was made with.
    first, *lines = [json.loads(line) for line in Path(journal).read_text().splitlines()]
    verdicts, images = [], []
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        statistics = reader.get_summary().statistics
        for schema, channel, message in reader.iter_messages("/gapwatch/verdict"):
            verdict = json.loads(message.data)
            jsonschema.validate(verdict, json.loads(schema.data))
            assert abs(message.log_time / 1e9 - verdict["t_s"]) < 1e-6, message.log_time
            verdicts.append(verdict)
        for schema, channel, message, image in reader.iter_decoded_messages("/gapwatch/image"):
            assert image.header.stamp.sec * 10**9 + image.header.stamp.nanosec == message.log_time
            picture = Image.open(io.BytesIO(bytes(image.data)))
            picture.load()
            images.append((message.log_time, picture.format, picture.size))
        about = {record.name: record.metadata for record in reader.iter_metadata()}
    assert verdicts == [without_nulls(line) for line in lines]
    assert len(images) == sum(line["seq"] is not None and "cut off" not in line["health"] for line in lines)
    assert {kind for _, kind, _ in images} == {"JPEG"}
    assert statistics.message_count == len(images) + len(verdicts)
    assert about["gapwatch"]["source"] == first["about"]["source"]
    print(json.dumps({"verdicts": len(verdicts), "images": len(images), "size": images[0][2]}))


if __name__ == "__main__":
    {"write": write, "read": read}[sys.argv[1]](*sys.argv[2:])
