//! MCAP recordings as sources and as journals: round trip, choice of the topic, damaged files.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::float_cmp
)]

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use crate::program::{files, gapwatch_in, journal_of};
use gapwatch::capture::{Frame, SourceError, open};
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};
use serde_json::{Value, json};

/// A message of `foxglove.CompressedImage` in JSON: a picture of 64x32, another for each number.
fn image(number: u32) -> Vec<u8> {
    use base64::Engine;
    let mut png = Cursor::new(Vec::new());
    image::RgbImage::from_fn(64, 32, |x, y| {
        image::Rgb([(x + y + number) as u8, 90, x as u8])
    })
    .write_to(&mut png, image::ImageFormat::Png)
    .unwrap();
    let data = base64::engine::general_purpose::STANDARD.encode(png.into_inner());
    let stamp = json!({ "sec": 50 + number, "nsec": 250_000_000 });
    json!({ "timestamp": stamp, "frame_id": "camera", "format": "png", "data": data })
        .to_string()
        .into_bytes()
}

/// A recording of five messages a topic, one a second.
fn recording(topics: &[(&str, &str)], options: WriteOptions) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for (topic, schema) in topics {
        let schema = writer.add_schema(schema, "jsonschema", b"{}").unwrap();
        let none = BTreeMap::new();
        writer.add_channel(schema, topic, "json", &none).unwrap();
    }
    for number in 0..5 {
        for channel in 1..=topics.len() as u16 {
            let log_time = 1_000_000_000 * u64::from(number);
            let header = MessageHeader {
                channel_id: channel,
                sequence: number,
                log_time,
                publish_time: log_time,
            };
            writer
                .write_to_known_channel(&header, &image(number))
                .unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

const CAMERA: (&str, &str) = ("/camera", "foxglove.CompressedImage");

fn frames(path: &Path) -> Result<Vec<Frame>, SourceError> {
    let mut source = open(path.to_str().unwrap())?;
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        frames.push(frame);
    }
    Ok(frames)
}

#[test]
fn verdicts_lie_beside_the_images_and_are_the_journal_s() {
    let folder = tempfile::tempdir().unwrap();
    let drive = "scene:sim?seed=7&seconds=4&condition=night:5@1-3";
    let args = ["replay", drive, "--journal", "j", "--mcap", "a.mcap"];
    gapwatch_in(folder.path(), &args).ok();
    let read = |name: &str| journal_of(&folder.path().join(name));
    let lines = read("j");
    let bytes = fs::read(folder.path().join("a.mcap")).unwrap();
    let messages: Vec<mcap::Message<'_>> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    let of = |topic: &str| -> Vec<&mcap::Message<'_>> {
        messages
            .iter()
            .filter(|m| m.channel.topic == topic)
            .collect()
    };
    let (images, verdicts) = (of("/gapwatch/image"), of("/gapwatch/verdict"));
    assert_eq!((images.len(), verdicts.len()), (40, lines.len()));
    assert_eq!(images.len() + verdicts.len(), messages.len());
    for (message, line) in verdicts.iter().zip(&lines) {
        let verdict: Value = serde_json::from_slice(&message.data).unwrap();
        for (key, value) in verdict.as_object().unwrap() {
            assert_eq!(value, &line[key], "{key}");
        }
        assert!(verdict["tap_gap"].is_object() && !verdict["state"].is_null());
        let at_s = message.log_time as f64 / 1e9;
        assert!((at_s - line["t_s"].as_f64().unwrap()).abs() < 1e-9);
    }
    let schema = verdicts[0].channel.schema.as_ref().unwrap();
    let properties: Value = serde_json::from_slice(&schema.data).unwrap();
    assert_eq!(
        properties["properties"]["tap_gap"]["properties"]["e4"]["type"],
        "number"
    );
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let about = mcap::read::metadata(&bytes, &summary.metadata_indexes[0]).unwrap();
    assert_eq!(about.metadata["source"], drive);

    // What was written can be looked at again; times and numbers stay what they were.
    let again = [
        "replay",
        "a.mcap",
        "--warn",
        "gap,change",
        "--journal",
        "k",
        "--mcap",
        "b.mcap",
    ];
    gapwatch_in(folder.path(), &again).ok();
    let again = read("k");
    assert_eq!(again.len(), lines.len());
    for (after, before) in again.iter().zip(&lines) {
        assert_eq!(after["seq"], before["seq"]);
        let [a, b] = [after, before].map(|line| line["t_s"].as_f64().unwrap());
        assert!((a - b).abs() < 1e-6);
    }
    assert_eq!(
        again.last().unwrap()["state"],
        lines.last().unwrap()["state"]
    );
}

#[test]
fn a_recording_keeps_its_own_times_in_every_form_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    let options = WriteOptions::new;
    for options in [
        options().compression(None),
        options().compression(Some(Compression::Lz4)),
        options().compression(Some(Compression::Zstd)),
        options().use_chunks(false),
        options().chunk_size(Some(1)),
        options().emit_summary_records(false),
        options().emit_statistics(false),
    ] {
        fs::write(
            &path,
            recording(&[CAMERA, ("/radar", "radar.Scan")], options),
        )
        .unwrap();
        let frames = frames(&path).unwrap();
        let times: Vec<f64> = frames.iter().map(|f| f.captured_at.as_secs_f64()).collect();
        assert_eq!(times, [0.0, 1.0, 2.0, 3.0, 4.0]);
        for (number, frame) in (0..).zip(&frames) {
            let picture = frame.picture.as_ref().unwrap().picture();
            assert_eq!((picture.width, picture.height), (64, 32));
            assert_eq!(picture.rgb[0], number);
        }
    }
    // What it began with goes on in what is written of it.
    let args = ["replay", "r.mcap", "--mcap", "out.mcap"];
    gapwatch_in(folder.path(), &args).ok();
    let bytes = fs::read(folder.path().join("out.mcap")).unwrap();
    let first = mcap::MessageStream::new(&bytes).unwrap().next().unwrap();
    assert_eq!(first.unwrap().log_time, 50_250_000_000);
}

/// A recording of one topic whose messages stand in this order; message n was recorded at n seconds.
fn recording_in_order(order: impl IntoIterator<Item = u32>, options: WriteOptions) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema(CAMERA.1, "jsonschema", b"{}").unwrap();
    let none = BTreeMap::new();
    let channel_id = writer.add_channel(schema, CAMERA.0, "json", &none).unwrap();
    for sequence in order {
        let log_time = 1_000_000_000 * u64::from(sequence);
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time: log_time,
        };
        writer
            .write_to_known_channel(&header, &image(sequence))
            .unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn images_come_in_the_order_of_time_wherever_they_stand() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    let halves = || (40..80).chain(0..40);
    let near = || (0..80).map(|n| n / 20 * 20 + 19 - n % 20);
    let options = WriteOptions::new;
    let few_in_a_chunk = || options().chunk_size(Some(40_000));
    for bytes in [
        recording_in_order(halves(), few_in_a_chunk()),
        recording_in_order(halves(), options()),
        recording_in_order((0..80).rev(), options().chunk_size(Some(1))),
        recording_in_order(near(), options().use_chunks(false)),
        recording_in_order(near(), few_in_a_chunk().emit_summary_records(false)),
        recording_in_order(near(), few_in_a_chunk().emit_chunk_indexes(false)),
        recording_in_order(near(), few_in_a_chunk().emit_message_indexes(false)),
    ] {
        fs::write(&path, bytes).unwrap();
        let frames = frames(&path).unwrap();
        assert_eq!(frames.len(), 80);
        for (second, frame) in (0_u32..).zip(&frames) {
            assert_eq!(frame.captured_at.as_secs_f64(), f64::from(second));
            let picture = frame.picture.as_ref().unwrap().picture();
            assert_eq!(u32::from(picture.rgb[0]), second);
        }
    }
    // Without an index, an image may stand among the 32 before and after it.
    for options in [
        options().use_chunks(false),
        few_in_a_chunk().emit_summary_records(false),
    ] {
        fs::write(&path, recording_in_order(halves(), options)).unwrap();
        let said = frames(&path).unwrap_err().to_string();
        assert!(
            said.contains("broke off after 9 images of /camera"),
            "{said}"
        );
        assert!(
            said.contains("48.000 s before") && said.contains("mcap sort"),
            "{said}"
        );
    }
}

#[test]
fn one_topic_with_images_is_taken_and_several_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, topics: &[(&str, &str)]| {
        let bytes = recording(topics, WriteOptions::new());
        fs::write(folder.path().join(name), bytes).unwrap();
    };
    write(
        "two.mcap",
        &[
            CAMERA,
            ("/rear", "foxglove.CompressedImage"),
            ("/radar", "radar.Scan"),
        ],
    );
    write("none.mcap", &[("/radar", "radar.Scan")]);
    write("nothing.mcap", &[]);
    fs::write(folder.path().join("no.mcap"), "hello").unwrap();
    fs::write(folder.path().join("empty.mcap"), "").unwrap();
    gapwatch_in(folder.path(), &["replay", "two.mcap?topic=/rear"]).ok();
    let before = files(folder.path());
    for (source, said) in [
        (
            "two.mcap",
            "several topics with images; wanted one of them, as in ?topic=/camera: /camera (foxglove.CompressedImage in json, 5 messages), /rear",
        ),
        (
            "two.mcap?topic=/left",
            "no topic /left; its topics with images: /camera",
        ),
        (
            "two.mcap?topic=/radar",
            "topic /radar holds radar.Scan in json; wanted sensor_msgs/msg/Image",
        ),
        (
            "none.mcap",
            "no topic with images; wanted sensor_msgs/msg/Image",
        ),
        ("nothing.mcap", "its topics: none"),
        ("no.mcap", "no.mcap: "),
        ("empty.mcap", "empty.mcap: "),
        ("gone.mcap", "gone.mcap: no such file"),
        ("two.mcap?fps=3", "own times"),
    ] {
        let line = gapwatch_in(folder.path(), &["replay", source, "--journal", "j"]).refusal();
        assert!(line.contains(said), "{line}");
        assert_eq!(files(folder.path()), before, "{source}");
    }
}

#[test]
fn a_cut_recording_says_where_it_broke_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    let whole = recording(&[CAMERA], WriteOptions::new().chunk_size(Some(1)));
    let mut counts = Vec::new();
    for length in (0..whole.len()).step_by(whole.len() / 200) {
        fs::write(&path, &whole[..length]).unwrap();
        let mut count = 0;
        let said = match open(path.to_str().unwrap()) {
            Err(error) => error.to_string(),
            Ok(mut source) => loop {
                match source.next_frame() {
                    Ok(Some(_)) => count += 1,
                    Ok(None) => panic!("{length} of {} bytes are not a whole file", whole.len()),
                    Err(error) => {
                        let said = error.to_string();
                        assert!(said.contains(&format!("after {count} images")), "{said}");
                        assert!(source.next_frame().unwrap().is_none());
                        break said;
                    }
                }
            },
        };
        assert!(said.contains("cut.mcap"), "{said}");
        counts.push(count);
    }
    assert!(counts.is_sorted() && counts.contains(&3), "{counts:?}");
}

#[test]
fn damaged_recordings_never_break_more_than_themselves() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.mcap");
    let mut whole_pictures = 0;
    for options in [
        WriteOptions::new().compression(None),
        WriteOptions::new().compression(Some(Compression::Lz4)),
        WriteOptions::new().use_chunks(false),
    ] {
        let whole = recording(&[CAMERA], options);
        let mut random = 12_345_u64;
        for _ in 0..300 {
            let mut bytes = whole.clone();
            for _ in 0..3 {
                // The generator of Knuth's MMIX.
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let place = (random >> 33) as usize % bytes.len();
                bytes[place] = (random >> 56) as u8;
            }
            fs::write(&path, bytes).unwrap();
            if let Ok(frames) = frames(&path) {
                assert!(frames.len() <= 5);
                whole_pictures += frames.iter().filter(|f| f.picture.is_ok()).count();
            }
        }
    }
    assert!(whole_pictures > 0, "some damage is in no picture");
}

#[test]
fn a_picture_that_cannot_be_read_is_one_frame_and_not_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.mcap");
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema(CAMERA.1, "jsonschema", b"{}").unwrap();
    writer
        .add_channel(schema, "/camera", "json", &BTreeMap::new())
        .unwrap();
    for number in 0..4 {
        let data = match number {
            1 => b"{".to_vec(),
            2 => String::from_utf8(image(2))
                .unwrap()
                .replace("iVBOR", "iVBOS")
                .into_bytes(),
            _ => image(number),
        };
        let log_time = 1_000_000_000 * u64::from(number);
        let header = MessageHeader {
            channel_id: 1,
            sequence: 0,
            log_time,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    fs::write(&path, writer.into_inner().into_inner()).unwrap();
    let frames = frames(&path).unwrap();
    let whole: Vec<bool> = frames.iter().map(|frame| frame.picture.is_ok()).collect();
    assert_eq!(whole, [true, false, false, true]);
    let times: Vec<f64> = frames.iter().map(|f| f.captured_at.as_secs_f64()).collect();
    assert_eq!(times, [0.0, 1.0, 2.0, 3.0]);
    let said = frames[1].picture.as_ref().unwrap_err().to_string();
    assert!(said.contains("r.mcap: /camera 1: "), "{said}");
}
