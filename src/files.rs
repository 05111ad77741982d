//! Files that appear whole, or grow line by line: everything that the program writes to a disk goes through here.

pub mod durable;
pub mod live_file;
pub mod output;
pub mod temporary_folder;
pub mod unfinished;
pub mod whole_file;

pub mod json_fault;
pub mod shell;
pub mod toml_keys;
