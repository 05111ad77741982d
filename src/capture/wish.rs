//! What a camera is asked for, and what it says of itself.

/// Pixel formats of cameras that are understood, by the names of V4L2.
pub const CAMERA_FORMATS: [&str; 5] = ["YUYV", "NV12", "MJPG", "RGB3", "BGR3"];
/// What to ask a camera for; what it grants counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraWish {
    /// Four characters of V4L2, such as `YUYV`.
    pub format: Option<String>,
    /// Width and height, pixels.
    pub size: Option<(u32, u32)>,
    /// Frames a second.
    pub fps: Option<f64>,
}

/// What a camera says of itself.
#[derive(Clone, Debug)]
pub struct CameraFacts {
    /// Its name and the driver's.
    pub name: String,
    /// What it is set to.
    pub set_to: String,
    /// Pixel formats that it offers, by the names of V4L2.
    pub formats: Vec<String>,
}
