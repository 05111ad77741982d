//! Runs the built program as its user would.
#![allow(dead_code, clippy::unwrap_used, clippy::float_cmp)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// What a run of the program left.
pub struct Ran {
    pub code: i32,
    pub out: String,
    pub err: String,
}

/// Runs gapwatch in a folder.
pub fn gapwatch_in(folder: &Path, args: &[&str]) -> Ran {
    ran(Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(args)
        .current_dir(folder)
        .output()
        .unwrap())
}

/// Runs gapwatch with a number of threads.
pub fn gapwatch_threads(folder: &Path, threads: u32, args: &[&str]) -> Ran {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gapwatch"));
    ran(command
        .args(args)
        .current_dir(folder)
        .env("RAYON_NUM_THREADS", threads.to_string())
        .output()
        .unwrap())
}

/// Runs a check of `tests/python` with the Python that has its packages.
pub fn check(script: &str, args: &[&str]) -> String {
    let python = std::env::var("GAPWATCH_PYTHON")
        .expect("GAPWATCH_PYTHON names a Python with the packages of tests/requirements.txt; tests/run sets it");
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/python")
        .join(script);
    let Ran { code, out, err } = ran(Command::new(python)
        .arg(script)
        .args(args)
        .output()
        .unwrap());
    assert_eq!(code, 0, "{out}\n{err}");
    out
}

/// A program's exit code and output.
pub fn ran(output: Output) -> Ran {
    Ran {
        code: output.status.code().unwrap_or(-1),
        out: String::from_utf8(output.stdout).unwrap(),
        err: String::from_utf8(output.stderr).unwrap(),
    }
}

/// A journal's lines of frames and silences, as texts; its first line says that it is one.
pub fn journal_lines(path: &Path) -> Vec<String> {
    let text = fs::read_to_string(path).unwrap();
    let (first, rest) = text.split_once('\n').unwrap();
    assert!(first.starts_with("{\"gapwatch_journal\":4,"), "{first}");
    rest.lines().map(str::to_owned).collect()
}

/// As [`journal_lines`], as objects.
pub fn journal_of(path: &Path) -> Vec<serde_json::Value> {
    let lines = journal_lines(path);
    let objects = lines.iter().map(|line| serde_json::from_str(line).unwrap());
    objects.collect()
}

/// As [`journal_lines`], without what differs from run to run: the time that each frame took.
pub fn verdict_lines(path: &Path) -> Vec<String> {
    let lines = journal_lines(path).into_iter();
    lines
        .map(|line| line.split(",\"latency_ms\"").next().unwrap().to_owned())
        .collect()
}

impl Ran {
    /// The output of a run that did its job.
    pub fn ok(self) -> String {
        assert_eq!(self.code, 0, "standard error: {}", self.err);
        self.out
    }

    /// The one line of a run that could not do its job.
    pub fn refusal(self) -> String {
        assert_eq!(
            self.code, 2,
            "output: {}\nstandard error: {}",
            self.out, self.err
        );
        assert_eq!(self.err.lines().count(), 1, "wanted one line: {}", self.err);
        assert_eq!(self.out, "");
        self.err
    }
}

/// Every file below a folder, with its bytes, in name order.
pub fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push((path.clone(), fs::read(&path).unwrap()));
        }
    }
    found.sort();
    found
}

/// Compares output with `tests/expected/NAME`: words exactly, whole numbers too, others within 2 %, two units of their last place or 1e-4
/// (encoders round differently on other kinds of CPU). `BLESS=1` rewrites the file.
pub fn assert_expected(name: &str, found: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/expected")
        .join(name);
    if std::env::var_os("BLESS").is_some() {
        fs::write(&path, found).unwrap();
    }
    let wanted = fs::read_to_string(&path).unwrap();
    let (found_parts, wanted_parts) = (parts(found), parts(&wanted));
    let same =
        found_parts.len() == wanted_parts.len() && found_parts.iter().zip(&wanted_parts).all(alike);
    assert!(same, "{name}: wanted\n{wanted}\nfound\n{found}");
}

fn alike((found, wanted): (&String, &String)) -> bool {
    match (found.parse::<f64>(), wanted.parse::<f64>()) {
        (Ok(found), Ok(number)) => {
            let Some((_, decimals)) = wanted.split_once('.') else {
                return found == number;
            };
            let unit = 0.1_f64.powi(i32::try_from(decimals.len()).unwrap());
            (found - number).abs() <= (0.02 * number.abs()).max(2.0 * unit).max(1e-4)
        }
        _ => found.trim() == wanted.trim(),
    }
}

/// Text cut into numbers, with their signs, and what stands between them.
fn parts(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let digit = |i: usize| chars.get(i).is_some_and(char::is_ascii_digit);
    let in_number = |i: usize| digit(i) || (matches!(chars[i], '.' | '-') && digit(i + 1));
    let places: Vec<usize> = (0..chars.len()).collect();
    places
        .chunk_by(|&a, &b| in_number(a) == in_number(b))
        .map(|part| part.iter().map(|&i| chars[i]).collect())
        .collect()
}

/// The names of the events; each must be whole.
pub fn whole_events(folder: &Path) -> Vec<String> {
    let mut events = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.starts_with('.') {
            continue;
        }
        let event = folder.join(&name);
        let json: serde_json::Value =
            serde_json::from_slice(&fs::read(event.join("event.json")).unwrap()).unwrap();
        let moments = json["moments"].as_array().unwrap();
        let heat = moments
            .iter()
            .flat_map(|moment| moment["heat"].as_object())
            .flatten();
        let named: Vec<&serde_json::Value> = moments
            .iter()
            .map(|moment| &moment["frame"])
            .chain(heat.map(|(_, file)| file))
            .collect();
        for file in &named {
            let path = event.join(file.as_str().unwrap());
            let frame = gapwatch::capture::open(path.to_str().unwrap())
                .and_then(|mut source| source.next_frame());
            frame.unwrap().unwrap().picture.unwrap();
        }
        assert_eq!(files(&event).len(), named.len() + 1);
        events.push(name);
    }
    events.sort();
    events
}

/// A small file system of its own at a folder, until it is dropped.
pub struct SmallDisk<'a>(&'a Path);

impl<'a> SmallDisk<'a> {
    pub fn mount(folder: &'a Path, size: &str) -> Self {
        let status = Command::new("mount")
            .args([
                "-t",
                "tmpfs",
                "-o",
                &format!("size={size}"),
                "gapwatch-test",
            ])
            .arg(folder)
            .status();
        assert!(status.unwrap().success(), "cannot mount a tmpfs");
        Self(folder)
    }

    /// An image of an ext4 file system, which writes by itself only after five minutes.
    pub fn mount_image(folder: &'a Path, image: &Path) -> Self {
        let status = Command::new("mount")
            .args(["-o", "loop,commit=300"])
            .args([image, folder])
            .status();
        assert!(status.unwrap().success(), "cannot mount an image");
        Self(folder)
    }
}

impl Drop for SmallDisk<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0).status();
    }
}

/// Names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let name = |entry: fs::DirEntry| entry.file_name().into_string().unwrap();
    let mut names: Vec<String> = entries.map(|entry| name(entry.unwrap())).collect();
    names.sort();
    names
}
