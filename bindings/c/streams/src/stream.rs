//! What both precisions have in common.

/// What is known about a stream before it begins.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviStream {
    /// Samples by which outputs come later than by the definition: y(k) is the value for k − latency. With a
    /// latency of the length of a block there is little or nothing to sum directly.
    pub latency: usize,
    /// Samples of a call, if all have as many, else 0. Other calls remain possible, but may cost more.
    pub block: usize,
    /// Samples of the longest response that will be exchanged for the present ones, if it is longer; else 0.
    pub longest: usize,
}

/// What a convolver is, and where it is.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FviConvolverFacts {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Samples by which outputs come later than by the definition of the convolution.
    pub latency: usize,
    /// Samples of the longest response that can be exchanged for the present ones.
    pub longest: usize,
    /// Bytes of tables and state.
    pub bytes: usize,
    /// Samples taken since the beginning.
    pub taken: u64,
    /// Samples until the exchange under way has ended; 0 if there is none.
    pub exchange_left: u64,
    /// Number of blocks that were not done when they were due, and were then finished at once. The schedule
    /// keeps it at zero.
    pub overruns: u64,
}
