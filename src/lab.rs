//! What is used on a desk and not in a car: rendered drives, studies, comparison, and reports.

pub mod scene;

pub mod camera_buffers;
pub mod labelled;

pub mod comparison;
pub mod evaluation;

pub mod profile_chart;
pub mod report;

/// Registers the sources of the lab, so that [`capture::open`](crate::capture::open) opens `scene:…`, and renders
/// conditions over the pictures of other sources.
pub fn register() {
    crate::capture::register_scenes(scene::open);
    crate::capture::register_overlay(scene::lay_over);
}
