//! Which pixel of a picture is the nearest one when it is resized, as onnxruntime decides.

/// Marks a Resize that was an Upsample or a Resize of operator set 10; later sets have no word for how these find the
/// nearest pixel.
pub const SIMPLE: &str = "simple";
/// Nearer than this, pixels lie exactly between two others for onnxruntime.
const HALFWAY: f32 = 1e-6;

/// Pixels of a result for one of the original, as onnxruntime computes it.
// Sides of pictures are small.
#[allow(clippy::cast_precision_loss)]
pub fn ratio(to: i64, from: i64) -> f32 {
    to as f32 / from as f32
}

/// One axis of a picture that is resized.
pub struct Line {
    /// Pixels of the original.
    pub from: i64,
    /// Pixels of the result.
    pub to: i64,
    /// Pixels of the result for one of the original.
    pub scale: f32,
}

impl Line {
    /// The pixel of the original that is nearest to a pixel of the result; `None` for a mode that is not known. The
    /// order of operations and their precision are those of onnxruntime: pixels lie often exactly between two others.
    // Sides of pictures are small.
    #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation)]
    pub fn nearest(&self, pixel: i64, mode: &str, rounding: &str) -> Option<i64> {
        let (x, from, to) = (pixel as f32, self.from as f32, self.to as f32);
        let original = match mode {
            "asymmetric" => x / self.scale,
            "pytorch_half_pixel" if self.to <= 1 => 0.0,
            "half_pixel" | "pytorch_half_pixel" => (x + 0.5) / self.scale - 0.5,
            "tf_half_pixel_for_nn" => (x + 0.5) / self.scale,
            "align_corners" if self.to == 1 => 0.0,
            "align_corners" => x * (from - 1.0) / (to - 1.0),
            "half_pixel_symmetric" => {
                let adjustment = to / (self.scale * from);
                from / 2.0 * (1.0 - adjustment) + (x + 0.5) / self.scale - 0.5
            }
            _ => return None,
        };
        let below = original.floor();
        let is_halfway = (original - below - 0.5).abs() < HALFWAY;
        let rounded = match rounding {
            "floor" => below,
            "ceil" => original.ceil(),
            "round_prefer_floor" if is_halfway => below,
            "round_prefer_ceil" if is_halfway => below + 1.0,
            "round_prefer_floor" | "round_prefer_ceil" => original.round(),
            SIMPLE if self.scale < 1.0 => original.ceil(),
            SIMPLE => original.trunc(),
            _ => return None,
        };
        Some((rounded as i64).clamp(0, self.from - 1))
    }
}
