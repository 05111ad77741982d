#![doc = "gapwatch watches the road through a lane model's own encoder."]

pub mod scene;
