//! Encoder input → feature maps of the tapped blocks: this file and those below it are the only ones that use tract's
//! types.
//!
//! Any ONNX encoder with one picture input can be used. The taps are named, and whatever does not lead to them (for
//! example a lane head that is not asked for) is removed before the graph is read. An operator that is not known to be
//! computed as onnxruntime does is refused by name.
//!
//! tract reads every model. Graphs that consist of the few operators of lane models then run in our own executor, which
//! takes a third of tract's time. All other graphs run in tract. Both are first compared with tract's graph before it is
//! optimised:
//!
//! ```text
//! ONNX -> what tract reads right -> tract's typed graph -> Graph of our operators -> Plan of steps -> Buffers of one thread
//!         opened, tensors, functions,  encoder, trial      lowering, graph           plan, layout     buffers, steps, kernel
//!         vouched, rewritten
//! ```

use std::sync::Arc;

use sha2::{Digest, Sha256};
use tract_onnx::model::ParseResult;
use tract_onnx::pb::ModelProto;
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::infer::InferenceModelExt;

use crate::model::vectors::Vectors;
use crate::model::{ModelSpec, onnx_file};

mod buffers;
mod error;
mod functions;
mod graph;
mod guard;
mod inference;
mod kernel;
mod layout;
mod loops;
mod lowering;
mod maps;
mod nearest;
mod opened;
mod parts;
mod plan;
mod rewritten;
mod steps;
mod tensors;
#[cfg(test)]
mod tests;
mod trial;
mod vouched;
#[cfg(target_arch = "x86_64")]
mod x86;

use buffers::Buffers;
pub use error::EncoderError;
use guard::contained;
pub use guard::in_tract;
use inference::{admits, broken_constant, largest, root};
pub use maps::{FeatureMap, FeatureMaps};
use maps::{feature_map, run_in_tract};
use plan::Plan;
use trial::Trial;

/// Largest number of elements of one value inside a model: half a GiB of 32-bit floats, eight times the largest input.
const VOLUME_MAX: u64 = 1 << 27;

/// A loaded model, shared between threads.
#[derive(Clone)]
pub struct Encoder {
    engine: Engine,
    taps: Vec<String>,
    has_lane: bool,
    input_shape: [usize; 4],
    sha256: String,
}

/// What computes a model.
#[derive(Clone)]
enum Engine {
    Own(Arc<Plan>),
    Tract(Arc<TypedRunnableModel>),
}

/// What may compute a model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Executor {
    /// Our executor if it knows all operators and agrees with tract, else tract.
    #[default]
    Fastest,
    /// tract.
    Tract,
}

/// Adds at least `count` products in registers with the fastest vectors of this processor, and returns how many. This
/// is the limit with which the speed of an encoder is compared.
pub fn products_in_registers(count: u64) -> u64 {
    let in_round = (loops::REGISTERS * layout::LANES) as u64;
    let rounds = count.div_ceil(in_round);
    std::hint::black_box(Vectors::available()[0].products_in_registers(rounds));
    rounds * in_round
}

impl Encoder {
    /// Loads and optimises a model for its taps.
    ///
    /// # Errors
    /// When the file is not an ONNX model, when a tap is unknown, or when shapes do not fit.
    pub fn load(spec: &ModelSpec) -> Result<Self, EncoderError> {
        Self::load_in(spec, Executor::Fastest)
    }

    /// Loads a model for its taps and its lane head, if the model's options name one.
    ///
    /// # Errors
    /// Like [`Encoder::load`], and when the lane head does not give one logit for each pixel of the input.
    pub fn load_with_lane(spec: &ModelSpec) -> Result<Self, EncoderError> {
        Self::load_for(spec, spec.lane.as_ref(), Executor::Fastest)
    }

    /// Like [`Encoder::load`], with a choice of what may compute the model.
    ///
    /// # Errors
    /// As [`Encoder::load`].
    pub fn load_in(spec: &ModelSpec, executor: Executor) -> Result<Self, EncoderError> {
        Self::load_for(spec, None, executor)
    }

    fn load_for(
        spec: &ModelSpec,
        lane: Option<&String>,
        executor: Executor,
    ) -> Result<Self, EncoderError> {
        contained(|| Self::load_trusting(spec, lane, executor)).unwrap_or_else(|why| {
            Err(EncoderError::Onnx {
                model: spec.name.clone(),
                why,
            })
        })
    }

    fn load_trusting(
        spec: &ModelSpec,
        lane: Option<&String>,
        executor: Executor,
    ) -> Result<Self, EncoderError> {
        let broken = |why: &dyn std::fmt::Display| EncoderError::Onnx {
            model: spec.name.clone(),
            why: why.to_string(),
        };
        let outputs: Vec<&String> = spec.taps.iter().chain(lane).collect();
        let mut proto = opened::opened(spec, &outputs)?;
        let (width, height) = (spec.preprocessing.width, spec.preprocessing.height);
        let input_shape = [1, 3, height as usize, width as usize];
        let mut read = analysed(&proto, spec, input_shape)?;
        if rewritten::needs_shapes(&proto) {
            rewritten::with_shapes(&mut proto, &read).map_err(|why| broken(&why))?;
            read = analysed(&proto, spec, input_shape)?;
        }
        let typed = read.model.into_typed().map_err(|e| broken(&root(&e)))?;
        check_shapes(&typed, spec, lane)?;
        let takes_bytes =
            onnx_file::described(&spec.onnx).is_ok_and(|described| described.takes_bytes);
        let own = match executor {
            Executor::Fastest => own_plan(&typed, &spec.name),
            Executor::Tract => None,
        };
        let trial = Trial::new(&typed, input_shape, takes_bytes).map_err(|why| broken(&why))?;
        let engine = match own {
            Some(own) if trial.agrees_with(&own, &spec.name) => Engine::Own(Arc::new(own)),
            _ => Engine::Tract(trial.fastest(typed, &spec.name)),
        };
        Ok(Self {
            engine,
            taps: spec.taps.clone(),
            has_lane: lane.is_some(),
            input_shape,
            sha256: sha256_of(spec),
        })
    }

    /// Name of what computes the model, for people.
    pub fn executor(&self) -> String {
        match &self.engine {
            Engine::Own(plan) => format!("own, {}", plan.kernel.name()),
            Engine::Tract(_) => "tract".to_owned(),
        }
    }

    /// Number of products of weights and activations in the convolutions of one picture; `None` for a model that runs
    /// in tract.
    pub fn products(&self) -> Option<u64> {
        match &self.engine {
            Engine::Own(plan) => Some(plan.products),
            Engine::Tract(_) => None,
        }
    }

    /// Whether the lane head's logits come after the feature maps.
    pub fn has_lane(&self) -> bool {
        self.has_lane
    }

    /// Hash of the ONNX file, followed by its files of weights in the order of their names if there are any.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Names of the taps, in the order of the feature maps.
    pub fn taps(&self) -> &[String] {
        &self.taps
    }

    /// State for running the model in one thread.
    ///
    /// # Errors
    /// When tract cannot set up its state.
    pub fn session(&self) -> Result<EncoderSession, EncoderError> {
        let state = match &self.engine {
            Engine::Own(plan) => State::Own {
                buffers: Buffers::new(plan),
                plan: plan.clone(),
            },
            Engine::Tract(plan) => State::Tract {
                state: plan.spawn().map_err(|e| EncoderError::Onnx {
                    model: self.sha256.clone(),
                    why: root(&e),
                })?,
                outputs: TVec::new(),
            },
        };
        Ok(EncoderSession {
            state,
            input_shape: self.input_shape,
        })
    }
}

/// One thread's state of an encoder.
pub struct EncoderSession {
    state: State,
    input_shape: [usize; 4],
}

enum State {
    Own {
        plan: Arc<Plan>,
        buffers: Buffers,
    },
    Tract {
        state: TypedSimpleState,
        outputs: TVec<TValue>,
    },
}

impl EncoderSession {
    /// Runs the encoder on `[3, H, W]` normalised RGB. The feature maps are in the order of the taps, followed by the
    /// lane head's logits `[1, H, W]` if it was loaded. Our own executor allocates nothing.
    ///
    /// # Errors
    /// The reason as text if the input has another size or if tract fails.
    pub fn run(&mut self, input: &[f32]) -> Result<FeatureMaps<'_>, String> {
        if input.len() != self.input_shape.iter().product::<usize>() {
            let [_, channels, height, width] = self.input_shape;
            return Err(format!(
                "the input has {} values; wanted [{channels}, {height}, {width}]",
                input.len()
            ));
        }
        match &mut self.state {
            State::Own { plan, buffers } => {
                buffers.run(plan, input);
                let outputs = plan.outputs.iter().zip(buffers.outputs());
                FeatureMaps::collect(
                    outputs.map(|(&shape, activations)| Ok(FeatureMap { shape, activations })),
                )
            }
            State::Tract { state, outputs } => {
                *outputs = run_in_tract(state, &self.input_shape, input)?;
                FeatureMaps::collect(outputs.iter().map(|output| feature_map(output)))
            }
        }
    }
}

/// Our own plan for a model, if it knows all of the model's operators.
fn own_plan(model: &TypedModel, name: &str) -> Option<Plan> {
    let planned = contained(|| {
        let kernel = Vectors::available()[0];
        lowering::lower(model).and_then(|graph| Plan::new(&graph.fused(), kernel))
    });
    planned
        .flatten()
        .inspect_err(|why| log::info!("{name} runs in tract: {why}"))
        .ok()
}

/// Hash of a model's bytes, followed by those of its files of weights in the order of their names.
fn sha256_of(spec: &ModelSpec) -> String {
    let mut hash = Sha256::new_with_prefix(&spec.onnx);
    spec.data.iter().for_each(|file| hash.update(&file.bytes));
    let digest = hash.finalize();
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A model as tract reads it, with the shapes of its values for our input.
fn analysed(
    proto: &ModelProto,
    spec: &ModelSpec,
    input_shape: [usize; 4],
) -> Result<ParseResult, EncoderError> {
    let broken = |why: &dyn std::fmt::Display| EncoderError::Onnx {
        model: spec.name.clone(),
        why: why.to_string(),
    };
    let onnx = rewritten::reader();
    let mut read = onnx.parse(proto, None).map_err(|e| broken(&root(&e)))?;
    let model = &mut read.model;
    if let Some(name) = broken_constant(model) {
        return Err(broken(&format!(
            "its constant {name} has values that are not finite"
        )));
    }
    let [input] = model.inputs[..] else {
        let inputs = model.inputs.iter();
        let names: Vec<&str> = inputs.map(|input| &*model.node(input.node).name).collect();
        return Err(broken(&format!(
            "its inputs are {names:?}; wanted one, a picture"
        )));
    };
    let declared = model.input_fact(0).map_err(|e| broken(&root(&e)))?;
    let declared = declared.shape.clone();
    if !admits(&declared, &input_shape) {
        return Err(EncoderError::Input {
            model: spec.name.clone(),
            input: model.node(input.node).name.clone(),
            found: format!("[{declared:?}]"),
            height: spec.preprocessing.height,
            width: spec.preprocessing.width,
        });
    }
    model
        .set_input_fact(0, f32::fact(input_shape).into())
        .map_err(|e| broken(&root(&e)))?;
    model.analyse(false).map_err(|e| broken(&root(&e)))?;
    if let Some((node, volume)) = largest(model).filter(|&(_, volume)| volume > VOLUME_MAX) {
        return Err(broken(&format!(
            "its value {node} has {volume} elements, more than {VOLUME_MAX}"
        )));
    }
    Ok(read)
}

fn check_shapes(
    model: &TypedModel,
    spec: &ModelSpec,
    lane: Option<&String>,
) -> Result<(), EncoderError> {
    let (width, height) = (spec.preprocessing.width, spec.preprocessing.height);
    let (width, height) = (width as usize, height as usize);
    for (index, value) in spec.taps.iter().chain(lane).enumerate() {
        let fact = model.output_fact(index).map_err(|e| EncoderError::Onnx {
            model: spec.name.clone(),
            why: root(&e),
        })?;
        let is_f32 = fact.datum_type == f32::datum_type();
        let shape = fact.shape.as_concrete();
        let found = || format!("{:?} of {:?}", fact.shape, fact.datum_type);
        if index == spec.taps.len() {
            if !is_f32 || shape != Some(&[1, 1, height, width]) {
                return Err(EncoderError::LaneShape {
                    model: spec.name.clone(),
                    lane: value.clone(),
                    found: found(),
                    height,
                    width,
                });
            }
        } else if !is_f32
            || !shape.is_some_and(|s| matches!(*s, [1, c, h, w] if c > 0 && h > 1 && w > 1))
        {
            return Err(EncoderError::TapShape {
                model: spec.name.clone(),
                tap: value.clone(),
                found: found(),
            });
        }
    }
    Ok(())
}
