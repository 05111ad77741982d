//! The virtual machine of `tests/vm`: what it is given, its one boot, and where it leaves what is to be judged.
#![allow(dead_code, clippy::unwrap_used)]

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
const PROGRAM: &str = env!("CARGO_BIN_EXE_gapwatch");

/// The folder that a machine of this name shared, with what it left there. It is booted by the first test that asks; `stage`
/// puts what it needs into the folder.
pub fn machine(name: &str, stage: impl FnOnce(&Path)) -> PathBuf {
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&root).unwrap();
    let lock = File::create(root.join("lock")).unwrap();
    lock.lock().unwrap();
    // The tests of one run may be processes of their own.
    let run = std::env::var("NEXTEST_RUN_ID").unwrap_or_else(|_| std::process::id().to_string());
    let share = root.join(&run);
    if !share.exists() {
        for old in fs::read_dir(&root).unwrap().map(|old| old.unwrap().path()) {
            if old.is_dir() {
                fs::remove_dir_all(old).unwrap();
            }
        }
        fs::create_dir(&share).unwrap();
        stage(&share);
        let console = File::create(share.join("console.log")).unwrap();
        let ended = Command::new(format!("{ROOT}/tests/vm/boot"))
            .arg(&share)
            .stdout(Stdio::from(console))
            .status()
            .unwrap();
        fs::write(share.join("ended"), format!("{ended}")).unwrap();
    }
    let ended = fs::read_to_string(share.join("ended")).unwrap_or_default();
    let console = share.join("console.log");
    assert_eq!(ended, "exit status: 0", "see {}", console.display());
    share
}

/// Puts the program, its libraries and the script of `tests/vm` that the machine runs where it finds them.
pub fn stage_program(share: &Path, script: &str) {
    fs::copy(PROGRAM, share.join("gapwatch")).unwrap();
    fs::create_dir(share.join("lib")).unwrap();
    let ldd = Command::new("ldd").arg(PROGRAM).output().unwrap();
    for word in String::from_utf8(ldd.stdout).unwrap().split_whitespace() {
        if word.starts_with('/') {
            let name = Path::new(word).file_name().unwrap();
            fs::copy(word, share.join("lib").join(name)).unwrap();
        }
    }
    fs::copy(format!("{ROOT}/tests/vm/{script}"), share.join("guest.sh")).unwrap();
}

/// Keeps what was measured, for `tests/vm/run` to show.
pub fn report(share: &Path, name: &str, text: &str) {
    fs::write(share.join(format!("report-{name}.md")), text).unwrap();
}
