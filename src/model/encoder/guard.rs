//! tract's panics become errors.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

thread_local! {
    static IN_TRACT: Cell<bool> = const { Cell::new(false) };
}

/// Whether this thread is loading a model or inside tract, where a panic is caught and becomes an error, so that a
/// panic hook may stay silent.
pub fn in_tract() -> bool {
    IN_TRACT.get()
}

/// Runs code of tract, which panics on some malformed models, or plans and tests our own executor, and turns a panic
/// into an error.
pub fn contained<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    let before = IN_TRACT.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(work));
    IN_TRACT.set(before);
    outcome.map_err(|panic| {
        let said = panic.downcast_ref::<String>().map(String::as_str);
        let said = said
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or_default();
        format!(
            "the inference engine failed with it ({})",
            said.lines().next().unwrap_or_default()
        )
    })
}
