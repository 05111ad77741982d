//! What a desk needs and a car does not: rendered drives, studies, comparison, and pages to look at.

pub mod scene;

pub mod camera_buffers;
pub mod labelled;

pub mod comparison;
pub mod evaluation;

pub mod profile_chart;
pub mod report;

/// Makes the sources of the lab known: from now on [`capture::open`](crate::capture::open) opens `scene:…`.
pub fn register() {
    crate::capture::register_scenes(scene::open);
}
