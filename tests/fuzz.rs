//! Damaged input of every kind that comes from outside: none may panic, whatever else it is answered with.
//!
//! Each test takes what is whole (shipped files, what the program writes itself), damages it and reads it, for a few seconds.
//!
//! `GAPWATCH_FUZZ_SECONDS=600 GAPWATCH_FUZZ_SEED=7 cargo test --release --all-features --test suite fuzz:: -- --nocapture --test-threads=2`
//! looks longer, and elsewhere. Input that makes a panic is kept in `target/tmp/fuzz`. `tests/fuzz/run` looks at the same with
//! libFuzzer, which sees what code was reached.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

#[path = "fuzz/mutation.rs"]
mod mutation;
#[path = "fuzz/targets.rs"]
mod targets;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use mutation::{Dice, mutate};
use targets::{TARGETS, Target};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn setting(name: &str, default: u64) -> u64 {
    let set = std::env::var(name).ok();
    set.map_or(default, |text| text.parse().unwrap())
}

/// Damages and reads until the time is over; says how often it was taken all the same.
fn fuzz(wanted: &str) {
    let mut targets = TARGETS.iter().filter(|(name, _)| *name == wanted);
    let (name, target) = targets.next().unwrap();
    let Target { seeds, mut read } = target();
    assert!(
        seeds.iter().any(|seed| read(seed)),
        "{name}: nothing is taken"
    );
    let seconds = setting("GAPWATCH_FUZZ_SECONDS", 2);
    let mut dice = Dice(setting("GAPWATCH_FUZZ_SEED", 1));
    let until = Instant::now() + Duration::from_secs(seconds);
    let (mut executions, mut taken, mut longest) = (0_u64, 0_u64, Duration::ZERO);
    while Instant::now() < until {
        let input = mutate(&mut dice, &seeds);
        let began = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| read(&input))) {
            Ok(whole) => taken += u64::from(whole),
            Err(_) => {
                let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fuzz");
                fs::create_dir_all(&folder).unwrap();
                let path = folder.join(format!("{name}-{executions}"));
                fs::write(&path, &input).unwrap();
                panic!(
                    "{name}: panic after {executions} executions on {}",
                    path.display()
                );
            }
        }
        longest = longest.max(began.elapsed());
        executions += 1;
    }
    println!("{name}: {executions} executions, {taken} taken, longest {longest:.1?}");
    assert!(executions > taken, "{name}: all of {executions} were taken");
}

#[test]
fn fuzz_png() {
    fuzz("png");
}

#[test]
fn fuzz_jpeg() {
    fuzz("jpeg");
}

#[test]
fn fuzz_camera_buffers() {
    fuzz("camera-buffers");
}

#[test]
fn fuzz_recordings() {
    fuzz("recordings");
}

#[test]
fn fuzz_references() {
    fuzz("references");
}

#[test]
fn fuzz_boards() {
    fuzz("boards");
}

#[test]
fn fuzz_model_options() {
    fuzz("model-options");
}

#[test]
fn fuzz_source_names() {
    fuzz("source-names");
}

#[test]
fn fuzz_journals() {
    fuzz("journals");
}

#[test]
fn fuzz_what_comes_over_the_bus() {
    fuzz("bus");
}

#[test]
fn fuzz_surveys() {
    fuzz("surveys");
}

#[test]
fn fuzz_shards() {
    fuzz("shards");
}

#[test]
fn fuzz_onnx() {
    fuzz("onnx");
}

#[test]
fn fuzz_onnx_with_weights_in_a_second_file() {
    fuzz("onnx-weights");
}
