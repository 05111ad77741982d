//! What is taken from a frame: energies of the encoder's activations, their histograms, and the quality of the picture.

pub mod image_quality;

pub mod attention;
pub mod lane;

pub mod energies;

pub mod heat;
pub mod histogram;
