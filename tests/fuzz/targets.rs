//! What is fuzzed: whole inputs, and what reads them after they were damaged.

use std::borrow::Cow;
use std::fs;
use std::panic::{Location, PanicHookInfo, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;

use gapwatch::calibration::shard::Shard;
use gapwatch::calibration::survey::store::{SurveyKind, SurveyStore};
use gapwatch::calibration::survey::{Keep, Survey};
use gapwatch::can::e2e::{E2eReceiver, E2eSender};
use gapwatch::can::message::{ClearRequest, GapHealth, GapStatus, GapVersion};
use gapwatch::can::receiver::{Heard, Receiver};
use gapwatch::can::speed::SpeedSignal;
use gapwatch::can::{CanFrame, CanSettings};
use gapwatch::capture::open;
use gapwatch::capture::pixels::{Layout, PixelFormat};
use gapwatch::live::board::Board;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::preprocess::{CROP_NOTHING, Preprocessing};
use gapwatch::model::{DataFile, ModelOptions, ModelSpec};
use gapwatch::record::journal;
use gapwatch::reference::{ModelFingerprint, Reference};
use sha2::{Digest, Sha256};

use super::ROOT;

#[path = "tiny_onnx.rs"]
mod tiny_onnx;
use tiny_onnx::{tiny_onnx, values};

/// Something that reads bytes from outside.
pub struct Target {
    /// What it takes.
    pub seeds: Vec<Vec<u8>>,
    /// Whether bytes were taken. The same bytes get the same answer.
    pub read: Read,
}

pub type Read = Box<dyn FnMut(&[u8]) -> bool>;
pub type Named = (&'static str, fn() -> Target);

/// All of them by name.
pub const TARGETS: [Named; 14] = [
    ("png", png),
    ("jpeg", jpeg),
    ("camera-buffers", camera_buffers),
    ("recordings", recordings),
    ("references", references),
    ("boards", boards),
    ("model-options", model_options),
    ("source-names", source_names),
    ("journals", journals),
    ("bus", bus),
    ("surveys", surveys),
    ("shards", shards),
    ("onnx", || onnx(tiny_onnx(false))),
    ("onnx-weights", || onnx(tiny_onnx(true))),
];

/// A folder in memory, where there is one: reading takes most of the time.
fn scratch() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    let root = if memory.is_dir() {
        memory.to_owned()
    } else {
        std::env::temp_dir()
    };
    tempfile::tempdir_in(root).unwrap()
}

/// What is read from a file of this name.
fn file(file: &str, seeds: Vec<Vec<u8>>, mut read: impl FnMut(&Path) -> bool + 'static) -> Target {
    let folder = scratch();
    let path = folder.path().join(file);
    Target {
        seeds,
        read: Box::new(move |input| {
            fs::write(&path, input).unwrap();
            let _lives_as_long = &folder;
            read(&path)
        }),
    }
}

fn shipped(folder: &str, extension: &str) -> Vec<Vec<u8>> {
    let entries = fs::read_dir(Path::new(ROOT).join(folder)).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == extension));
    paths.sort();
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

fn picture() -> image::RgbImage {
    image::RgbImage::from_fn(48, 32, |x, y| {
        let byte = |n: u32| n.to_le_bytes()[0];
        image::Rgb([byte(5 * x), byte(7 * y), byte(x * y)])
    })
}

fn encoded_jpeg() -> Vec<u8> {
    let rgb = picture().into_raw();
    let (width, height) = (48, 32);
    gapwatch::capture::jpeg(&gapwatch::capture::Picture { width, height, rgb }).unwrap()
}

/// The same picture turned, and without tables and end marker; other forms as libjpeg's tools write them.
fn jpegs() -> Vec<Vec<u8>> {
    let whole = encoded_jpeg();
    let turned = [
        &whole[..2],
        b"\xFF\xE1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0",
        &whole[2..],
    ];
    let mut bare = whole.clone();
    while let Some(at) = (2..bare.len() - 4).find(|&at| bare[at..].starts_with(b"\xFF\xC4")) {
        let length = usize::from(u16::from_be_bytes([bare[at + 2], bare[at + 3]]));
        bare.drain(at..at + 2 + length);
    }
    assert!(bare.len() < whole.len());
    bare.truncate(bare.len() - 2);
    let mut forms = vec![whole.clone(), turned.concat(), bare];
    forms.extend(shipped("tests/fuzz/seeds", "jpg"));
    forms
}

fn image(name: &str, seeds: Vec<Vec<u8>>) -> Target {
    file(name, seeds, |path| {
        let opened = open(path.to_str().unwrap());
        match opened.and_then(|mut source| source.next_frame()) {
            Ok(frame) => frame.unwrap().picture.is_ok(),
            // What begins as a recording does is read as one; any other damage is a frame that cannot be judged.
            Err(error) => {
                let bytes = fs::read(path).unwrap();
                assert!(bytes.starts_with(b"\x89MCAP"), "{error}");
                false
            }
        }
    })
}

fn png() -> Target {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture()
        .write_to(&mut bytes, image::ImageFormat::Png)
        .unwrap();
    image("a.png", vec![bytes.into_inner()])
}

fn jpeg() -> Target {
    image("a.jpg", jpegs())
}

/// Two bytes choose the format and its sizes, the rest is what the camera gave.
fn camera_buffers() -> Target {
    let formats = [
        PixelFormat::Mjpg,
        PixelFormat::Yuyv,
        PixelFormat::Nv12,
        PixelFormat::Rgb3,
        PixelFormat::Bgr3,
    ];
    let mut seeds = Vec::new();
    for format in 0..5 {
        for sizes in 0..64 {
            seeds.push([&[format, sizes], encoded_jpeg().as_slice()].concat());
            seeds.push([&[format, sizes], picture().into_raw().as_slice()].concat());
        }
    }
    Target {
        seeds,
        read: Box::new(move |input| {
            let [format, sizes, buffer @ ..] = input else {
                return false;
            };
            let choice = |of: [u32; 4], shift: u8| of[usize::from(sizes >> shift & 3)];
            let layout = Layout {
                format: formats[usize::from(*format) % 5],
                width: choice([48, 47, 2, 1], 0),
                height: choice([32, 31, 2, 1], 2),
                stride: choice([0, 144, 7, u32::MAX], 4),
            };
            layout
                .pixels(buffer)
                .is_ok_and(|pixels| !pixels.picture().rgb.is_empty())
        }),
    }
}

/// A message with a picture as ROS 2 writes them.
#[derive(serde::Serialize)]
struct RosImage {
    stamp: (i32, u32),
    frame_id: String,
    height: u32,
    width: u32,
    encoding: String,
    is_bigendian: u8,
    step: u32,
    data: serde_bytes::ByteBuf,
}

/// A message of ROS with a picture of 48x32 in this encoding, made of the same bytes again and again.
fn ros_image(encoding: &str, step: u32, bytes: usize) -> Vec<u8> {
    let image = RosImage {
        stamp: (7, 500_000_000),
        frame_id: "camera".to_owned(),
        height: 32,
        width: 48,
        encoding: encoding.to_owned(),
        is_bigendian: 0,
        step,
        data: picture()
            .into_raw()
            .into_iter()
            .cycle()
            .take(bytes)
            .collect::<Vec<u8>>()
            .into(),
    };
    let ros = cdr_encoding::to_vec::<_, byteorder::LittleEndian>(&image).unwrap();
    [&[0, 1, 0, 0], ros.as_slice()].concat()
}

const TOPICS: [&str; 4] = ["/ros", "/mosaic", "/planes", "/camera"];

/// Recordings with the same picture four times on each topic, in each form of the file; without check sums, so that damage
/// gets inside.
fn whole_recordings() -> Vec<Vec<u8>> {
    let ros = ros_image("bgr8", 144, 4_608);
    let mosaic = ros_image("bayer_grbg16", 96, 3_072);
    let planes = zstd::stream::encode_all(&ros_image("i420", 48, 2_304)[..], 1).unwrap();
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, encoded_jpeg());
    let json = format!(r#"{{"timestamp":{{"sec":7,"nsec":5}},"format":"jpeg","data":"{data}"}}"#);
    let options = || {
        let options = mcap::WriteOptions::new().calculate_chunk_crcs(false);
        let options = options.calculate_data_section_crc(false);
        options.calculate_summary_section_crc(false)
    };
    let forms = [
        options().use_chunks(false),
        options().compression(None),
        options().compression(Some(mcap::Compression::Lz4)),
        options().compression(Some(mcap::Compression::Zstd)),
    ];
    let written = forms.into_iter().map(|options| {
        let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
        for (schema, encoding, topic, message) in [
            ("sensor_msgs/msg/Image", "cdr", TOPICS[0], ros.as_slice()),
            ("sensor_msgs/msg/Image", "cdr", TOPICS[1], &mosaic),
            ("sensor_msgs/msg/Image", "cdr", TOPICS[2], &planes),
            (
                "foxglove.CompressedImage",
                "json",
                TOPICS[3],
                json.as_bytes(),
            ),
        ] {
            let schema = writer.add_schema(schema, "none", b"").unwrap();
            let none = std::collections::BTreeMap::new();
            let channel_id = writer.add_channel(schema, topic, encoding, &none).unwrap();
            for sequence in 0..4 {
                let log_time = 100_000_000 * u64::from(sequence);
                let header = mcap::records::MessageHeader {
                    channel_id,
                    sequence,
                    log_time,
                    publish_time: log_time,
                };
                writer.write_to_known_channel(&header, message).unwrap();
            }
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    });
    let mut written: Vec<Vec<u8>> = written.collect();
    written.push(zstd::stream::encode_all(&written[1][..], 1).unwrap());
    written
}

fn recordings() -> Target {
    // A record longer than its chunk makes mcap 0.26 subtract beyond 0. Unchecked, as it is shipped, it reads on to an error at
    // the end of the file.
    let in_mcap = |panic: &PanicHookInfo| {
        let at = panic.location().map_or("", Location::file);
        at.ends_with("sans_io/linear_reader.rs") && panic.to_string().contains("subtract")
    };
    let loud = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !in_mcap(panic) {
            loud(panic);
        }
    }));
    let pictures = |path: &Path, topic: &str| {
        let Ok(mut source) = open(&format!("{}?topic={topic}", path.display())) else {
            return 0;
        };
        let mut pictures = 0;
        while let Ok(Some(frame)) = source.next_frame() {
            pictures += u32::from(frame.picture.is_ok());
        }
        pictures
    };
    let mut target = file("a.mcap", whole_recordings(), move |path| {
        let all = || TOPICS.map(|topic| pictures(path, topic));
        catch_unwind(all).is_ok_and(|all| all == [4; 4])
    });
    assert!(target.seeds.iter().all(|seed| (target.read)(seed)));
    target
}

fn references() -> Target {
    let path = Path::new(ROOT).join("calibration/sim.json");
    let seeds = vec![fs::read(path).unwrap()];
    file("reference.json", seeds, |path| {
        Reference::read(Some(path)).is_ok()
    })
}

fn boards() -> Target {
    let speed = b"[camera]\nsource = \"v4l2:/dev/video0\"\n[can]\nsink = \"socketcan:can0\"\nstatus = { id = 0x5D0, data_id = 1 }\n\
        [can.speed]\nid = 0x1A0\nstart_bit = 8\nlength = 16\nfactor = 0.01\n[budget]\nframe_ms = 10\n";
    let mut seeds = shipped("boards", "toml");
    seeds.push(speed.to_vec());
    file("board.toml", seeds, |path| Board::read(path).is_ok())
}

fn model_options() -> Target {
    let mut seeds = shipped("calibration", "toml");
    seeds.push(b"taps = [\"a\"]\nlane = \"b\"\nsize = \"64x32\"\nmean = [0, 0, 0]\nstd = [1, 1, 1]\ncrop = [0.0, 0.3, 1.0, 0.7]\n".to_vec());
    file("m.toml", seeds, |path| {
        let onnx = path.with_extension("onnx");
        if !onnx.exists() {
            fs::write(&onnx, b"").unwrap();
        }
        ModelSpec::new(Some(&onnx), ModelOptions::default()).is_ok()
    })
}

fn source_names() -> Target {
    let names = [
        "scene:sim?seed=7&seconds=3&fps=10&size=32x16&condition=fog:3@20-40&without=dashes",
        "scene:game?condition=night:5&condition=dirt:1@1-2",
        "random:seed=1&frames=60",
    ];
    Target {
        seeds: names.map(|name| name.as_bytes().to_vec()).to_vec(),
        read: Box::new(|input| {
            let name = String::from_utf8_lossy(input).replace('\0', "0");
            // Only what is rendered: other names may be devices.
            let rendered = name.starts_with("scene:") || name.starts_with("random:");
            let drives = gapwatch::capture::drives(&name).map(|drives| drives.len());
            gapwatch::lab::register();
            rendered && drives.is_ok() && open(&name).is_ok()
        }),
    }
}

fn journals() -> Target {
    let line = |n: u32, state: &str, score: &str| {
        format!(
            "{{\"t_s\":{}.1,\"seq\":{n},\"state\":\"{state}\",\"reason\":\"\",\"score\":{score},\"change\":{score},\"lanes\":0.25,\"cause\":\"fog\",\"cause_probability\":0.5,\"gap\":{score},\"tap_gap\":{{\"e2\":0.5}},\
             \"tap_similarity\":{{\"e2\":null}},\"health\":\"ok\",\"latency_ms\":5.5}}\n",
            n / 10
        )
    };
    let first = "{\"gapwatch_journal\":4,\"began\":{\"utc\":\"\",\"is_set\":true,\"monotonic_s\":7.5},\"about\":{\"source\":\"s\"}}\n";
    let lines = line(0, "Init", "null") + &line(1, "Ok", "0.5") + &line(2, "Gap", "7.25");
    let seed = first.to_owned() + &lines;
    file("drive.jsonl", vec![seed.into_bytes()], |path| {
        journal::read(path).is_ok()
    })
}

/// Four bytes say where the speed lies, then frames of nine bytes: which identifier, and the data.
fn bus() -> Target {
    let mut requests = vec![8, 16, 0, 0];
    let mut statuses = requests.clone();
    for _ in 0..3 {
        for (which, id, frames) in [(0, 0x5D0, &mut statuses), (2, 0x5D8, &mut requests)] {
            E2eSender::new(id)
                .protect(ClearRequest.to_bytes(), |data: [u8; 8]| {
                    frames.push(which);
                    frames.extend(data);
                    Ok::<(), ()>(())
                })
                .unwrap();
        }
    }
    let speeds = [&[7, 12, 0xFF, 0][..], &[3; 27]].concat();
    Target {
        seeds: vec![requests, statuses, speeds],
        read: Box::new(|input| {
            let [start_bit, length, order, scale, frames @ ..] = input else {
                return false;
            };
            let speed = SpeedSignal {
                id: 0x1A0,
                start_bit: u16::from(*start_bit),
                length: u16::from(*length),
                big_endian: order & 1 == 1,
                factor: [0.01, 1.0, 1e300, f64::NAN][usize::from(scale & 3)],
                offset: [0.0, -40.0, f64::INFINITY, 1e-320][usize::from(scale >> 2 & 3)],
                parked_below_kmh: 1.0,
                parked_after: Duration::from_secs(1),
            };
            let settings = CanSettings {
                speed: Some(speed).filter(|speed| speed.check().is_ok()),
                ..CanSettings::default()
            };
            let mut receiver = Receiver::new(&settings);
            let mut checker = E2eReceiver::new(0x5D0);
            let mut all = settings.speed.is_some();
            for frame in frames.chunks_exact(9) {
                let mut data = [0; 8];
                data.copy_from_slice(&frame[1..]);
                let id = [0x5D0, 0x5D1, 0x5D8, 0x1A0, 0x7FF, 0x5D3][usize::from(frame[0]) % 6];
                let heard = receiver.hear(&CanFrame { id, data });
                let _ = (GapStatus::from_bytes(&data), GapHealth::from_bytes(&data));
                let _ = GapVersion::from_bytes(&data);
                all &= match heard {
                    Some(Heard::Foreign(0x5D0)) => checker.check(&data).is_ok(),
                    Some(Heard::Standing(_) | Heard::Clear) => true,
                    _ => false,
                };
            }
            all
        }),
    }
}

const DRIVE: &str = "scene:sim?seed=3&seconds=1&fps=3&size=64x32";

fn built_in() -> (ModelSpec, Encoder) {
    let spec = ModelSpec::new(None, ModelOptions::default()).unwrap();
    let encoder = Encoder::load(&spec).unwrap();
    (spec, encoder)
}

fn surveys() -> Target {
    gapwatch::lab::register();
    let (spec, encoder) = built_in();
    let fingerprint = ModelFingerprint::new(&spec, &encoder);
    let survey = Survey::of(DRIVE, &encoder, &spec.preprocessing, Keep::Means, &|| {}).unwrap();

    let folder = scratch();
    let store = SurveyStore::open(folder.path(), &fingerprint).unwrap();
    store.keep(DRIVE, SurveyKind::Means, "", &survey).unwrap();
    let path = fs::read_dir(folder.path())
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let whole = fs::read(&path).unwrap();
    // Magic, version, checksum, content: of damaged content with the old checksum, a new one lets the damage in.
    let sum = 16 + 4..16 + 4 + 32;
    let old = whole[sum.clone()].to_vec();
    Target {
        seeds: vec![whole],
        read: Box::new(move |input| {
            let mut bytes = input.to_vec();
            if bytes.get(sum.clone()).is_some_and(|found| found == old) {
                let new = Sha256::digest(&bytes[sum.end..]);
                bytes[sum.clone()].copy_from_slice(&new);
            }
            fs::write(&path, bytes).unwrap();
            let _lives_as_long = &folder;
            store.find::<Survey>(DRIVE, SurveyKind::Means, None).is_ok()
        }),
    }
}

fn shards() -> Target {
    let (spec, encoder) = built_in();
    let fingerprint = ModelFingerprint::new(&spec, &encoder);
    let reference = fs::read(Path::new(ROOT).join("calibration/sim.json")).unwrap();
    let shard = serde_json::json!({
        "format": "gapwatch-shard", "version": 1, "gapwatch": "0.1.0", "model": fingerprint, "metric": "mahalanobis",
        "window_s": 1.0, "false_alarms_per_hour": 1.0,
        "sources": [{"source": DRIVE, "role": "simulation", "frames": 3}],
    });
    let seeds = vec![shard.to_string().into_bytes(), reference];
    file("shard.json", seeds, |path| Shard::read(path).is_ok())
}

fn onnx(seed: Vec<u8>) -> Target {
    // What tract panics on is an error, not news.
    let loud = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !gapwatch::model::encoder::in_tract() {
            loud(panic);
        }
    }));
    Target {
        seeds: vec![seed],
        read: Box::new(|input| {
            let spec = ModelSpec {
                name: "damaged".to_owned(),
                onnx: Cow::Owned(input.to_vec()),
                data: vec![DataFile {
                    name: "w.bin".to_owned(),
                    bytes: [vec![0; 4], values()].concat(),
                }],
                taps: vec!["tap".to_owned()],
                lane: None,
                preprocessing: Preprocessing {
                    width: 32,
                    height: 16,
                    mean: [0.5; 3],
                    std: [0.5; 3],
                    crop: CROP_NOTHING,
                },
            };
            let Ok(encoder) = Encoder::load(&spec) else {
                return false;
            };
            // What is loaded also runs, or says why not.
            let mut session = encoder.session().unwrap();
            let _ = session.run(&[0.5; 3 * 16 * 32]);
            true
        }),
    }
}
