//! One thread's memory for a plan, and the loop over its steps.

use super::layout::Planar;
use super::plan::{Form, Input, Place, Plan, Step, Work};
use super::steps::{self, View};
use crate::model::vectors::Vectors;

/// One thread's buffers for a plan.
pub struct Buffers {
    picture: Vec<f32>,
    slots: Vec<Vec<f32>>,
    outputs: Vec<Vec<f32>>,
    /// Room for a row of the picture, a row of the widest value, and one more value.
    scratch: Vec<f32>,
}

impl Buffers {
    /// Buffers for one plan.
    pub fn new(plan: &Plan) -> Self {
        Self {
            picture: vec![0.0; plan.picture.len()],
            slots: plan
                .slots
                .iter()
                .map(|slot| vec![0.0; slot.len()])
                .collect(),
            outputs: plan
                .outputs
                .iter()
                .map(|shape| vec![0.0; shape.iter().product()])
                .collect(),
            scratch: vec![
                0.0;
                plan.picture.width
                    + 1
                    + plan.slots.iter().map(|slot| slot.width).max().unwrap_or(0)
            ],
        }
    }

    /// The outputs of the last picture, `[channels, height, width]` each.
    pub fn outputs(&self) -> &[Vec<f32>] {
        &self.outputs
    }

    /// Computes the outputs for a picture `[channels, height, width]`. Allocates nothing.
    pub fn run(&mut self, plan: &Plan, picture: &[f32]) {
        let planar = plan.picture;
        for (row, values) in picture.chunks_exact(planar.width).enumerate() {
            let (channel, y) = (row / planar.height, row % planar.height);
            self.picture[planar.pixels(channel, y)].copy_from_slice(values);
        }
        for step in &plan.steps {
            self.step(plan.kernel, planar, step);
        }
    }

    fn step(&mut self, kernel: Vectors, planar: Planar, step: &Step) {
        match step {
            Step::Compute { work, output } => {
                // The output is taken out of the slots while all other slots are read.
                let mut values = std::mem::take(&mut self.slots[output.slot]);
                let place = (&mut *values, output.view);
                match work {
                    Work::Convolve {
                        convolution,
                        input,
                        residual,
                    } => {
                        let input = match input {
                            Input::Picture => &self.picture,
                            Input::Slot(place) => &self.slots[place.slot],
                        };
                        let residual = residual.as_ref().map(|place| self.read(place));
                        convolution.run(kernel, input, residual, place);
                    }
                    _ => kernel.vectorised(
                        #[inline(always)]
                        || self.compute(kernel, planar, work, place),
                    ),
                }
                self.slots[output.slot] = values;
            }
            Step::Emit {
                form,
                input,
                channels,
                output,
            } => {
                let target = &mut self.outputs[*output];
                let (input, from) = (&self.slots[input.slot], input.view);
                match form {
                    Form::Scaled(scaling) => scaling.unpack(input, from, target),
                    Form::Unfolded { side } => steps::unfold(*side, input, from, *channels, target),
                }
            }
        }
    }

    fn read(&self, place: &Place) -> (&[f32], View) {
        (&self.slots[place.slot], place.view)
    }

    /// Computes everything except convolutions, which choose their instructions themselves.
    #[inline(always)]
    fn compute(
        &mut self,
        kernel: Vectors,
        planar: Planar,
        work: &Work,
        output: (&mut [f32], View),
    ) {
        match work {
            Work::Convolve { .. } => {}
            Work::PoolBlocks(window, activation, input) => {
                steps::pool_blocks(kernel, window, *activation, self.read(input), output);
            }
            Work::PoolPicture(window, activation, first) => {
                let picture = (self.picture.as_slice(), planar);
                let scratch = &mut self.scratch;
                steps::pool_picture(window, *activation, picture, scratch, output, *first);
            }
            Work::Add(activation, [a, b]) => {
                steps::add(*activation, self.read(a), self.read(b), output);
            }
            Work::Scale(scaling, input) => scaling.run(self.read(input), output),
            Work::Resize(activation, input) => {
                steps::resize(*activation, self.read(input), output);
            }
            Work::Clear => steps::clear(output),
            Work::Copy {
                input,
                channels,
                first,
            } => steps::copy_channels(self.read(input), *channels, output, *first),
        }
    }
}
