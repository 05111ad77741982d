//! Frames and where they come from: the beginning of the chain.
//!
//! It opens sources by name and reads pictures. A picture that cannot be read does not end a source: it becomes a frame
//! with an error, so that the monitor can report what it did not see.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut source = gapwatch::capture::open("random:seed=1&frames=2")?;
//! while let Some(frame) = source.next_frame()? {
//!     match &frame.picture {
//!         Ok(pixels) => println!("{}: {:?}", frame.sequence, pixels.layout()),
//!         Err(why) => println!("{}: no picture, {why}", frame.sequence),
//!     }
//! }
//! # Ok(())
//! # }
//! ```

pub mod clock;
pub mod undefined;

mod picture;

mod compressed;
pub mod pixels;

mod frame;

mod name_order;
pub mod newest;
pub mod period;
mod wish;

#[cfg(feature = "camera")]
mod camera;
mod images;
mod random;
#[cfg(feature = "lab")]
mod recording;
mod video;

mod names;
mod sources;

pub use compressed::jpeg;
pub use frame::{Frame, FrameSource, Place, SourceError, time_of};
pub use images::FOLDER_FPS;
pub use names::{camera_of, drives, is_rendered, ranges, sort_drives, stamp};
pub use picture::{PIXELS_MAX, Picture, PictureError};
pub use sources::{
    BUILT_IN_DRIVE, camera_facts, open, open_camera, register_overlay, register_scenes,
};
pub use wish::{CAMERA_FORMATS, CameraFacts, CameraWish};
