//! A graph → the steps that compute it: where each value is stored, how weights are laid out, which memory is used
//! again.

use super::graph::{Activation, Graph, Node, NodeId, Op, Window};
use super::layout::{Blocked, LANES, Planar};
use super::steps::{self, Convolution, Scaling, Source, View};
use crate::model::vectors::Vectors;

/// Largest number of elements of one value, with its zeros: as many as a model's own values may have.
const VOLUME_MAX: usize = 1 << 27;

/// Largest stride, dilation, kernel and margin of a window, cells: anything larger is a broken model.
const WINDOW_MAX: usize = 1 << 12;

/// Everything about an encoder that does not change from picture to picture.
pub struct Plan {
    /// Instructions with which it runs.
    pub kernel: Vectors,
    /// Layout of the input.
    pub picture: Planar,
    /// Buffers, each for several values one after the other.
    pub slots: Vec<Blocked>,
    /// The steps, in their order.
    pub steps: Vec<Step>,
    /// Channels, height and width of the outputs.
    pub outputs: Vec<[usize; 3]>,
    /// Number of products in the convolutions, for one picture.
    pub products: u64,
}

/// A value in a buffer.
#[derive(Clone, Copy)]
pub struct Place {
    /// The buffer.
    pub slot: usize,
    /// The part of the buffer.
    pub view: View,
}

/// What a convolution reads.
#[derive(Clone, Copy)]
pub enum Input {
    /// The input of the whole graph.
    Picture,
    /// A value.
    Slot(Place),
}

/// One step.
pub enum Step {
    /// Computes a value from others.
    Compute {
        /// What is computed.
        work: Work,
        /// Where the result is stored.
        output: Place,
    },
    /// Writes an output of the whole graph, `[channels, height, width]`.
    Emit {
        /// How it is written.
        form: Form,
        /// Where it is read from.
        input: Place,
        /// Number of channels of the input.
        channels: usize,
        /// Number of the output.
        output: usize,
    },
}

/// How a value is computed: see the functions of [`super::steps`].
pub enum Work {
    /// A convolution.
    Convolve {
        /// Its weights.
        convolution: Convolution,
        /// What it reads.
        input: Input,
        /// What is added to its sums.
        residual: Option<Place>,
    },
    /// Largest values in a window.
    PoolBlocks(Window, Activation, Place),
    /// The same for the picture, from this channel on.
    PoolPicture(Window, Activation, usize),
    /// A sum.
    Add(Activation, [Place; 2]),
    /// Factors and offsets.
    Scale(Scaling, Place),
    /// Bilinear interpolation.
    Resize(Activation, Place),
    /// Fills a value with zeros.
    Clear,
    /// Copies some of the channels.
    Copy {
        /// Where they are read from.
        input: Place,
        /// Number of channels.
        channels: usize,
        /// The first channel in the output.
        first: usize,
    },
}

/// How an output is written.
pub enum Form {
    /// With factors and offsets.
    Scaled(Scaling),
    /// Channels as squares of pixels.
    Unfolded {
        /// Pixels.
        side: usize,
    },
}

impl Plan {
    /// Plans the computation of a graph's outputs.
    ///
    /// # Errors
    /// The part of the graph that it cannot compute.
    pub fn new(graph: &Graph, kernel: Vectors) -> Result<Self, String> {
        check(graph)?;
        let mut planner = Planner::new(graph);
        if planner
            .layouts
            .iter()
            .any(|layout| layout.len() > VOLUME_MAX)
        {
            return Err("a value that is too large in blocks".to_owned());
        }
        for id in 0..graph.nodes.len() {
            planner.plan(id)?;
        }
        let products = graph.nodes.iter().map(|node| match &node.op {
            Op::Conv { weights, .. } => {
                weights.len() as u64 / node.shape[0] as u64
                    * node.shape.iter().product::<usize>() as u64
            }
            _ => 0,
        });
        Ok(Self {
            kernel,
            picture: planner.picture,
            slots: planner.slots,
            steps: planner.steps,
            outputs: graph
                .outputs
                .iter()
                .map(|&id| graph.nodes[id].shape)
                .collect(),
            products: products.sum(),
        })
    }
}

/// Refuses a graph that the steps cannot compute.
fn check(graph: &Graph) -> Result<(), String> {
    for (id, node) in graph.nodes.iter().enumerate() {
        let whole = node.shape.iter().all(|&side| side > 0);
        if !whole {
            return Err("a value of no size".to_owned());
        }
        let (window, input) = match &node.op {
            Op::Picture if id == 0 => continue,
            Op::Picture => return Err("a second picture".to_owned()),
            Op::Margin(_) => return Err("zeros around a value that is not convolved".to_owned()),
            Op::Unfold { .. } if !graph.outputs.contains(&id) || graph.uses()[id] > 1 => {
                return Err("an unfolded value that is not an output".to_owned());
            }
            Op::Conv {
                window,
                weights,
                bias,
            } => {
                if !weights.iter().chain(bias).all(|value| value.is_finite()) {
                    return Err("weights that are not finite".to_owned());
                }
                (window, node.inputs[0])
            }
            Op::MaxPool(window) => (window, node.inputs[0]),
            _ => continue,
        };
        let sides = [window.kernel, window.stride, window.dilation].concat();
        let odd = |side: &usize| !(1..=WINDOW_MAX).contains(side);
        if sides.iter().any(odd) || window.before.iter().any(|&before| before > WINDOW_MAX) {
            return Err("a window of no size or an odd one".to_owned());
        }
        let input = graph.nodes[input].shape;
        if margins(window, input[2], node.shape[2]).1 > WINDOW_MAX {
            return Err("a window far outside of its input".to_owned());
        }
        let pools = matches!(node.op, Op::MaxPool(_));
        for axis in 0..2 {
            let size = input[axis + 1];
            let empty =
                |&position: &usize| steps::seen(window, axis, position, size).next().is_none();
            if pools && (0..node.shape[axis + 1]).any(|position| empty(&position)) {
                return Err("a largest value of nothing".to_owned());
            }
        }
    }
    let picture = graph
        .nodes
        .first()
        .is_some_and(|node| node.op == Op::Picture);
    if !picture || graph.outputs.contains(&0) {
        return Err("outputs that are not computed from a picture".to_owned());
    }
    Ok(())
}

/// Columns that a convolution reads left and right of its input.
fn margins(window: &Window, input_width: usize, output_width: usize) -> (usize, usize) {
    let last = (output_width - 1) * window.stride[1] + (window.kernel[1] - 1) * window.dilation[1];
    let right = (last + 1).saturating_sub(window.before[1] + input_width);
    (window.before[1], right)
}

struct Planner<'a> {
    graph: &'a Graph,
    picture: Planar,
    /// Layout of every node's value.
    layouts: Vec<Blocked>,
    /// For parts of a concatenation that are written directly to their final place: the concatenation, and their first
    /// channel in it.
    homes: Vec<Option<(NodeId, usize)>>,
    /// The last node that reads each value.
    last_use: Vec<NodeId>,
    uses: Vec<usize>,
    places: Vec<Option<Place>>,
    slots: Vec<Blocked>,
    free: Vec<usize>,
    steps: Vec<Step>,
}

impl<'a> Planner<'a> {
    fn new(graph: &'a Graph) -> Self {
        let nodes = &graph.nodes;
        let blocked = |node: &Node| Blocked {
            blocks: node.shape[0].div_ceil(LANES),
            height: node.shape[1],
            width: node.shape[2],
            left: 0,
            right: 0,
        };
        let mut layouts: Vec<Blocked> = nodes.iter().map(blocked).collect();
        let [channels, height, width] = nodes[0].shape;
        let mut picture = Planar {
            channels,
            height,
            width,
            left: 0,
            right: 0,
        };
        // Values of one size get the same zeros around them, so that they can share buffers.
        for node in nodes {
            let Op::Conv { window, .. } = &node.op else {
                continue;
            };
            let input = node.inputs[0];
            let (left, right) = margins(window, nodes[input].shape[2], node.shape[2]);
            if input == 0 {
                picture.left = picture.left.max(left);
                picture.right = picture.right.max(right);
                continue;
            }
            let size = |layout: &Blocked| (layout.blocks, layout.height, layout.width);
            let wanted = size(&layouts[input]);
            for layout in layouts.iter_mut().filter(|layout| size(layout) == wanted) {
                layout.left = layout.left.max(left);
                layout.right = layout.right.max(right);
            }
        }
        let uses = graph.uses();
        let mut homes = vec![None; nodes.len()];
        for (id, node) in nodes.iter().enumerate() {
            if node.op == Op::Concat
                && let Some(starts) = starts_in_place(graph, &uses, id)
            {
                for (&part, start) in node.inputs.iter().zip(starts) {
                    homes[part] = Some((id, start));
                }
            }
        }
        let mut last_use: Vec<NodeId> = (0..nodes.len()).collect();
        for (id, node) in nodes.iter().enumerate() {
            for &input in &node.inputs {
                last_use[input] = id;
            }
        }
        Self {
            graph,
            picture,
            layouts,
            homes,
            last_use,
            uses,
            places: vec![None; nodes.len()],
            slots: Vec::new(),
            free: Vec::new(),
            steps: Vec::new(),
        }
    }

    fn plan(&mut self, id: NodeId) -> Result<(), String> {
        let node = &self.graph.nodes[id];
        let output = self.graph.outputs.iter().position(|&output| output == id);
        match (&node.op, output) {
            (Op::Picture, _) => return Ok(()),
            (Op::Unfold { side }, Some(output)) => {
                self.emit(Form::Unfolded { side: *side }, node.inputs[0], output)?;
            }
            // It is used only here: it is computed while the output is written.
            (Op::Scale { factor, offset }, Some(output)) if self.uses[id] == 1 => {
                let scaling = Scaling::new(factor, offset, node.activation);
                self.emit(Form::Scaled(scaling), node.inputs[0], output)?;
            }
            _ => {
                self.compute(id)?;
                let [one, zero] = [1.0, 0.0].map(|value| vec![value; node.shape[0]]);
                for output in 0..self.graph.outputs.len() {
                    if self.graph.outputs[output] == id {
                        let scaling = Scaling::new(&one, &zero, Activation::None);
                        self.emit(Form::Scaled(scaling), id, output)?;
                    }
                }
            }
        }
        self.release(id);
        Ok(())
    }

    fn emit(&mut self, form: Form, from: NodeId, output: usize) -> Result<(), String> {
        let step = Step::Emit {
            form,
            input: self.place_of(from)?,
            channels: self.graph.nodes[from].shape[0],
            output,
        };
        self.steps.push(step);
        Ok(())
    }

    /// Adds the step that computes a value into a place of its own.
    fn compute(&mut self, id: NodeId) -> Result<(), String> {
        let node = &self.graph.nodes[id];
        let activation = node.activation;
        let (output, channel) = self.place_for(id);
        let place = |index: usize| self.place_of(node.inputs[index]);
        let work = match &node.op {
            Op::Conv {
                window,
                weights,
                bias,
            } => {
                let (input, source) = match node.inputs[0] {
                    0 => (Input::Picture, Source::Picture(self.picture)),
                    _ => (Input::Slot(place(0)?), Source::Blocks(place(0)?.view)),
                };
                let channels = self.graph.nodes[node.inputs[0]].shape[0];
                let size = [node.shape[1], node.shape[2]];
                Work::Convolve {
                    convolution: Convolution::new(
                        window, weights, bias, channels, &source, size, activation,
                    ),
                    input,
                    residual: (node.inputs.len() > 1).then(|| place(1)).transpose()?,
                }
            }
            Op::MaxPool(window) if node.inputs[0] == 0 => {
                if self.homes[id].is_none() {
                    let work = Work::Clear;
                    self.steps.push(Step::Compute { work, output });
                }
                Work::PoolPicture(*window, activation, channel)
            }
            Op::MaxPool(window) => Work::PoolBlocks(*window, activation, place(0)?),
            Op::Add => Work::Add(activation, [place(0)?, place(1)?]),
            Op::Scale { factor, offset } => {
                Work::Scale(Scaling::new(factor, offset, activation), place(0)?)
            }
            Op::Resize => Work::Resize(activation, place(0)?),
            Op::Concat if node.inputs.iter().all(|&part| self.homes[part].is_some()) => {
                return Ok(());
            }
            Op::Concat => {
                let work = Work::Clear;
                self.steps.push(Step::Compute { work, output });
                let mut first = 0;
                for &part in &node.inputs {
                    let channels = self.graph.nodes[part].shape[0];
                    let work = Work::Copy {
                        input: self.place_of(part)?,
                        channels,
                        first,
                    };
                    self.steps.push(Step::Compute { work, output });
                    first += channels;
                }
                return Ok(());
            }
            Op::Picture | Op::Margin(_) | Op::Unfold { .. } => {
                return Err("a value that is not computed".to_owned());
            }
        };
        self.steps.push(Step::Compute { work, output });
        Ok(())
    }

    /// Where a value that was computed is stored.
    fn place_of(&self, id: NodeId) -> Result<Place, String> {
        self.places[id].ok_or_else(|| "an operator on the picture that is not known".to_owned())
    }

    /// Where a value is computed: a place of its own, or a part of the concatenation to which it belongs, and its first
    /// channel relative to that place.
    fn place_for(&mut self, id: NodeId) -> (Place, usize) {
        let (owner, start) = self.homes[id].unwrap_or((id, 0));
        let whole = match self.places[owner] {
            Some(place) => place,
            None => {
                let layout = self.layouts[owner];
                let place = Place {
                    slot: self.slot(layout),
                    view: View {
                        layout,
                        first: 0,
                        blocks: layout.blocks,
                    },
                };
                self.places[owner] = Some(place);
                place
            }
        };
        let place = Place {
            slot: whole.slot,
            view: View {
                first: start / LANES,
                blocks: (start % LANES + self.graph.nodes[id].shape[0]).div_ceil(LANES),
                ..whole.view
            },
        };
        self.places[id] = Some(place);
        (place, start % LANES)
    }

    /// A buffer that is no longer needed, or a new one.
    fn slot(&mut self, layout: Blocked) -> usize {
        let free = self
            .free
            .iter()
            .position(|&slot| self.slots[slot] == layout);
        match free {
            Some(index) => self.free.swap_remove(index),
            None => {
                self.slots.push(layout);
                self.slots.len() - 1
            }
        }
    }

    /// Releases the buffers of values that are not needed after this node.
    fn release(&mut self, after: NodeId) {
        for id in 0..=after {
            if self.last_use[id] == after
                && self.homes[id].is_none()
                && let Some(place) = self.places[id]
            {
                self.free.push(place.slot);
            }
        }
    }
}

/// First channels of the parts of a concatenation, if each part can be written directly to its final place. Steps write
/// whole blocks. Only a pooling of the picture may fill the rest of a block, if it comes later than the step that
/// writes the beginning of the block.
fn starts_in_place(graph: &Graph, uses: &[usize], id: NodeId) -> Option<Vec<usize>> {
    let node = &graph.nodes[id];
    let pools_picture = |part: NodeId| {
        matches!(graph.nodes[part].op, Op::MaxPool(_)) && graph.nodes[part].inputs[0] == 0
    };
    let mut starts = Vec::new();
    let mut end = 0;
    for &part in &node.inputs {
        starts.push(end);
        end += graph.nodes[part].shape[0];
    }
    if end != node.shape[0] || end % LANES != 0 {
        return None;
    }
    let fits = |index: usize| {
        let (part, start) = (node.inputs[index], starts[index]);
        let writes = matches!(
            graph.nodes[part].op,
            Op::Conv { .. } | Op::MaxPool(_) | Op::Add | Op::Scale { .. } | Op::Resize
        );
        let alone = uses[part] == 1 && !graph.outputs.contains(&part);
        let whole_blocks = start % LANES == 0;
        let end_block = (start + graph.nodes[part].shape[0]) / LANES;
        let later = |other: usize| {
            starts[other] / LANES != end_block
                || (pools_picture(node.inputs[other]) && node.inputs[other] > part)
        };
        writes
            && alone
            && (pools_picture(part) || (whole_blocks && (index + 1..starts.len()).all(later)))
    };
    (0..starts.len()).all(fits).then_some(starts)
}
