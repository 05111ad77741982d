//! Files with weights beside an ONNX file (external data), as PyTorch's exporter writes them.
//!
//! A model says which files it wants, so only plain files in its own folder are read: a name with a folder in it, a link,
//! a device or a pipe is refused.

use std::io;
use std::path::Path;

use crate::files::whole_file::read_plain;
use crate::model::onnx_file::ONNX_BYTES_MAX;

/// What would do instead of a second file.
const ONE_FILE: &str = "one file with all weights (torch.onnx.export(..., external_data=False))";

/// A file with weights.
#[derive(Clone, Debug, PartialEq)]
pub struct DataFile {
    /// Its name, as the model has it.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// Reads the files that a model of `taken` bytes names, in the order of their names.
///
/// # Errors
/// What was found and what would do, as text.
pub fn read_beside<'a>(
    model: &Path,
    taken: u64,
    names: impl IntoIterator<Item = &'a String>,
) -> Result<Vec<DataFile>, String> {
    let mut left = ONNX_BYTES_MAX.saturating_sub(taken);
    let mut files = Vec::new();
    for name in names {
        if !is_bare(name) {
            return Err(format!(
                "its weights are in {name:?}; wanted the name of a file in the model's own folder, or {ONE_FILE}"
            ));
        }
        let bytes = read_plain(&model.with_file_name(name), left).map_err(|error| {
            let why = match error.kind() {
                io::ErrorKind::FileTooLarge => {
                    format!("is too large: model and weights may have {ONNX_BYTES_MAX} bytes together")
                }
                _ => format!("cannot be read ({error})"),
            };
            format!("its weights are in {name}, which {why}; wanted that file beside the model, or {ONE_FILE}")
        })?;
        left -= bytes.len() as u64;
        files.push(DataFile {
            name: name.clone(),
            bytes,
        });
    }
    Ok(files)
}

/// Whether a name is that of a file, without any folder.
fn is_bare(name: &str) -> bool {
    let path = Path::new(name);
    path.file_name().is_some_and(|file| file == name) && !name.contains('\0')
}
