//! Files that are whole, or as long as what was written: everything that the program leaves on a disk goes through here.

pub mod durable;
pub mod live_file;
pub mod output;
pub mod temporary_folder;
pub mod whole_file;

pub mod json_fault;
pub mod toml_keys;
