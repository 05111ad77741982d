//! What a camera is asked for, and what it reports about itself.

/// Supported pixel formats of cameras, with the names of V4L2.
pub const CAMERA_FORMATS: [&str; 5] = ["YUYV", "NV12", "MJPG", "RGB3", "BGR3"];
/// What to ask a camera for. What the camera grants is used.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraWish {
    /// Pixel format, four characters of V4L2 such as `YUYV`.
    pub format: Option<String>,
    /// Width and height, pixels.
    pub size: Option<(u32, u32)>,
    /// Frames a second.
    pub fps: Option<f64>,
}

/// What a camera reports about itself.
#[derive(Clone, Debug)]
pub struct CameraFacts {
    /// Its name and the name of the driver.
    pub name: String,
    /// Its present settings.
    pub set_to: String,
    /// Pixel formats that it offers, with the names of V4L2.
    pub formats: Vec<String>,
}
