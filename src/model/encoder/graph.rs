//! An encoder as a graph of the few operators of lane models, and the rewrites that make it shorter.

/// Index of a node in its graph.
pub type NodeId = usize;

/// The function that is applied to a sum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Activation {
    /// Nothing.
    #[default]
    None,
    /// Negative values become 0; NaN stays NaN.
    Relu,
    /// Negative values times this slope.
    Leaky(f32),
}

impl Activation {
    /// Applies it to one value.
    #[inline(always)]
    pub fn of(self, value: f32) -> f32 {
        match self {
            Self::Relu if value < 0.0 => 0.0,
            Self::Leaky(slope) if value < 0.0 => value * slope,
            _ => value,
        }
    }

    /// Applies it to every value, in place.
    #[inline(always)]
    pub fn of_all(self, values: &mut [f32]) {
        match self {
            Self::None => {}
            Self::Relu => values.iter_mut().for_each(|v| *v = Self::Relu.of(*v)),
            Self::Leaky(slope) => values
                .iter_mut()
                .for_each(|v| *v = Self::Leaky(slope).of(*v)),
        }
    }
}

/// A window that moves over a picture. In each field, the first number is vertical and the second is horizontal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Number of cells.
    pub kernel: [usize; 2],
    /// Pixels from one position to the next.
    pub stride: [usize; 2],
    /// Pixels from one cell to the next.
    pub dilation: [usize; 2],
    /// Pixels by which the first position is above and left of the picture.
    pub before: [usize; 2],
}

/// What a node computes.
#[derive(Clone, Debug, PartialEq)]
pub enum Op {
    /// The input of the whole graph.
    Picture,
    /// Convolution of the first input; a second input is added to the result.
    Conv {
        /// The pixels that are used; pixels outside of the picture are 0.
        window: Window,
        /// `[outputs, inputs, kernel height, kernel width]`.
        weights: Vec<f32>,
        /// `[outputs]`.
        bias: Vec<f32>,
    },
    /// Largest value in a window; pixels outside of the picture do not count.
    MaxPool(Window),
    /// Sum of two inputs. The second one may have fewer channels: its missing channels are 0.
    Add,
    /// Channels of all inputs, one after the other. If more are wanted, channels of 0 follow.
    Concat,
    /// Rows of zeros above and columns of zeros left of the picture.
    Margin([usize; 2]),
    /// Each channel times its factor plus its offset.
    Scale {
        /// `[channels]`.
        factor: Vec<f32>,
        /// `[channels]`.
        offset: Vec<f32>,
    },
    /// Bilinear interpolation between pixels with half-pixel centres.
    Resize,
    /// Each pixel's channels become a square of `side` by `side` pixels: channel `(c side + dy) side + dx` is `c` at `dy, dx`.
    Unfold {
        /// Pixels.
        side: usize,
    },
}

/// One value of the graph.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// What it computes.
    pub op: Op,
    /// Nodes from which it is computed.
    pub inputs: Vec<NodeId>,
    /// Channels, height, width.
    pub shape: [usize; 3],
    /// Activation of the result.
    pub activation: Activation,
}

/// Nodes in an order in which each follows its inputs.
#[derive(Clone, Debug, Default)]
pub struct Graph {
    /// All nodes.
    pub nodes: Vec<Node>,
    /// Nodes that are wanted, in this order.
    pub outputs: Vec<NodeId>,
}

impl Graph {
    /// Adds a node without activation.
    pub fn push(&mut self, op: Op, inputs: &[NodeId], shape: [usize; 3]) -> NodeId {
        self.nodes.push(Node {
            op,
            inputs: inputs.to_vec(),
            shape,
            activation: Activation::None,
        });
        self.nodes.len() - 1
    }

    /// Applies an activation to a value.
    pub fn push_activation(&mut self, activation: Activation, input: NodeId) -> NodeId {
        let shape = self.nodes[input].shape;
        let one = Op::Scale {
            factor: vec![1.0; shape[0]],
            offset: vec![0.0; shape[0]],
        };
        let id = self.push(one, &[input], shape);
        self.nodes[id].activation = activation;
        id
    }

    /// Gives the same values with fewer nodes: factors, activations and sums are merged into the convolution before
    /// them, and margins into the convolution after them. Nodes that do not lead to an output are removed.
    pub fn fused(mut self) -> Self {
        self.absorb_margins();
        for id in 0..self.nodes.len() {
            self.absorb_scale(id);
            self.absorb_sum(id);
        }
        self.without_unused()
    }

    /// How often each node is used.
    pub fn uses(&self) -> Vec<usize> {
        let mut uses = vec![0; self.nodes.len()];
        let inputs = self.nodes.iter().flat_map(|node| &node.inputs);
        for &id in inputs.chain(&self.outputs) {
            uses[id] += 1;
        }
        uses
    }

    /// Whether a node is used exactly once, by another node.
    fn inner(&self, id: NodeId) -> bool {
        self.uses()[id] == 1 && !self.outputs.contains(&id)
    }

    /// Replaces every use of `of` by `by`.
    fn replace(&mut self, of: NodeId, by: NodeId) {
        let inputs = self.nodes.iter_mut().flat_map(|node| &mut node.inputs);
        for id in inputs.chain(&mut self.outputs) {
            if *id == of {
                *id = by;
            }
        }
    }

    fn absorb_margins(&mut self) {
        for id in 0..self.nodes.len() {
            let Some(&input) = self.nodes[id].inputs.first() else {
                continue;
            };
            let Op::Margin(before) = self.nodes[input].op else {
                continue;
            };
            let source = self.nodes[input].inputs[0];
            let node = &mut self.nodes[id];
            if let Op::Conv { window, .. } = &mut node.op {
                window.before[0] += before[0];
                window.before[1] += before[1];
                node.inputs[0] = source;
            }
        }
    }

    /// Merges a factor, an offset and an activation into the node before them.
    fn absorb_scale(&mut self, id: NodeId) {
        let Op::Scale { factor, offset } = &self.nodes[id].op else {
            return;
        };
        let (factor, offset) = (factor.clone(), offset.clone());
        let activation = self.nodes[id].activation;
        let input = self.nodes[id].inputs[0];
        if !self.inner(input) || self.nodes[input].activation != Activation::None {
            return;
        }
        // This is exact: a factor of 1 and an offset of 0 change nothing.
        #[allow(clippy::float_cmp)]
        let pure = factor.iter().all(|&f| f == 1.0) && offset.iter().all(|&o| o == 0.0);
        let parts_take_it = self.concat_of_inner(input);
        let node = &mut self.nodes[input];
        match &mut node.op {
            Op::Conv { weights, bias, .. } if node.inputs.len() == 1 => {
                let filter = weights.len() / bias.len();
                let filters = weights.chunks_exact_mut(filter);
                for ((filter, bias), (&factor, &offset)) in
                    filters.zip(bias).zip(factor.iter().zip(&offset))
                {
                    filter.iter_mut().for_each(|weight| *weight *= factor);
                    *bias = *bias * factor + offset;
                }
            }
            Op::Conv { .. } | Op::Add | Op::MaxPool(_) | Op::Resize if pure => {}
            // Every activation of channels of zeros is zero.
            Op::Concat if pure && parts_take_it => {
                let inputs = self.nodes[input].inputs.clone();
                for part in inputs {
                    self.nodes[part].activation = activation;
                }
                self.replace(id, input);
                return;
            }
            _ => return,
        }
        self.nodes[input].activation = activation;
        self.replace(id, input);
    }

    /// Whether an activation can be moved into every part of a concatenation.
    fn concat_of_inner(&self, id: NodeId) -> bool {
        self.nodes[id].inputs.iter().all(|&part| {
            let node = &self.nodes[part];
            self.inner(part)
                && node.activation == Activation::None
                && matches!(node.op, Op::Conv { .. } | Op::MaxPool(_) | Op::Add)
        })
    }

    /// Merges a sum into the convolution that makes one of its terms.
    fn absorb_sum(&mut self, id: NodeId) {
        if self.nodes[id].op != Op::Add {
            return;
        }
        let [a, b] = self.nodes[id].inputs[..] else {
            return;
        };
        for (term, other) in [(b, a), (a, b)] {
            let node = &self.nodes[term];
            let is_bare = node.inputs.len() == 1 && node.activation == Activation::None;
            if !matches!(node.op, Op::Conv { .. }) || !is_bare || !self.inner(term) {
                continue;
            }
            let other = self.before_filling(other);
            let node = self.nodes[term].clone();
            self.nodes[id].op = node.op;
            self.nodes[id].inputs = vec![node.inputs[0], other];
            return;
        }
        let (a, b) = match (self.before_filling(a), self.before_filling(b)) {
            (_, b_filled) if b_filled != b => (a, b_filled),
            (a_filled, _) => (b, a_filled),
        };
        self.nodes[id].inputs = vec![a, b];
    }

    /// The node before channels of zeros were added, if nothing else was done.
    fn before_filling(&self, id: NodeId) -> NodeId {
        match self.nodes[id].inputs[..] {
            [filled] if self.nodes[id].op == Op::Concat => filled,
            _ => id,
        }
    }

    fn without_unused(self) -> Self {
        let mut wanted = vec![false; self.nodes.len()];
        for &id in &self.outputs {
            wanted[id] = true;
        }
        for (id, node) in self.nodes.iter().enumerate().rev() {
            if wanted[id] {
                node.inputs.iter().for_each(|&input| wanted[input] = true);
            }
        }
        let mut place = vec![0; self.nodes.len()];
        let mut graph = Self::default();
        for (id, mut node) in self.nodes.into_iter().enumerate() {
            if wanted[id] {
                place[id] = graph.nodes.len();
                node.inputs
                    .iter_mut()
                    .for_each(|input| *input = place[*input]);
                graph.nodes.push(node);
            }
        }
        graph.outputs = self.outputs.into_iter().map(|id| place[id]).collect();
        graph
    }
}
