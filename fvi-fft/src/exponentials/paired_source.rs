//! Filters whose exponentials come in complex-conjugate pairs, as code of Rust or C that needs nothing else.
//!
//! ```text
//! Z_j ← ρ_j Z_j + x_{k−n₀} ,        y_k = Σ_{n<n₀} w_n x_{k−n} + Re Σ_j c_j Z_j
//! ```
//!
//! with the weights of [`ComplexExponentials`]. All numbers of a filter are in double precision, since a pair
//! that hardly decays is turned at every tick.

use crate::ComplexExponentials;
use crate::exponentials::controller_source::camel_case;
use crate::exponentials::rust_constants::rows;

/// A filter as code.
#[derive(Clone, Copy, Debug)]
pub struct PairedSource<'a> {
    /// Its weights.
    pub table: &'a ComplexExponentials,
    /// What they are, for the comment.
    pub origin: &'a str,
    /// Its name, an identifier.
    pub name: &'a str,
    /// True if samples and outputs are in single precision.
    pub in_single: bool,
}

impl PairedSource<'_> {
    /// `re,im,coefficient_re,coefficient_im` of each pair, the coefficients those at the first lag behind the
    /// head.
    pub fn csv(&self) -> String {
        let row = |[re, im, c_re, c_im]: &[f64; 4]| format!("{re:.16e},{im:.16e},{c_re:.16e},{c_im:.16e}\n");
        let rows: String = self.table.pairs.iter().map(row).collect();
        let head = self.table.head.len();
        format!("# {}\n# head = {head}\nre,im,coefficient_re,coefficient_im\n{rows}", self.origin)
    }

    /// A type with `new` and `tick`.
    pub fn rust(&self) -> String {
        let (head, pairs) = (self.table.head.len(), self.table.pairs.len());
        let (camel, scalar) = (camel_case(&self.name.to_ascii_lowercase()), self.scalar(["f64", "f32"]));
        let [taken, given] = if self.in_single { ["f64::from(sample)", " as f32"] } else { ["sample", ""] };
        let numbers: String = self.table.pairs.iter().map(|pair| format!("        {pair:?},\n")).collect();
        let weights = rows(&self.table.head, "        ", "");
        format!(
            "/// {}: {head} weights, then {pairs} exponentials in pairs.\n\
             #[derive(Clone, Debug)]\npub struct {camel} {{\n    \
                 recent: [f64; {head}],\n    sums: [[f64; 2]; {pairs}],\n}}\n\n\
             impl {camel} {{\n    \
                 const HEAD: [f64; {head}] = [\n{weights}    ];\n\n    \
                 /// Re rho, Im rho, Re c, Im c.\n    \
                 const PAIRS: [[f64; 4]; {pairs}] = [\n{numbers}    ];\n\n    \
                 /// The filter at rest: all samples before the first one are zero.\n    \
                 pub const fn new() -> Self {{\n        \
                     Self {{ recent: [0.0; {head}], sums: [[0.0; 2]; {pairs}] }}\n    }}\n\n    \
                 /// Takes a sample; the output at its time.\n    \
                 pub fn tick(&mut self, sample: {scalar}) -> {scalar} {{\n        \
                     let leaving = self.recent[{last}];\n        \
                     self.recent.copy_within(..{last}, 1);\n        \
                     self.recent[0] = {taken};\n        \
                     let mut output = 0.0;\n        \
                     for (weight, recent) in Self::HEAD.iter().zip(&self.recent) {{\n            \
                         output += weight * recent;\n        }}\n        \
                     for ([re, im, c_re, c_im], sum) in Self::PAIRS.iter().zip(&mut self.sums) {{\n            \
                         *sum = [re * sum[0] - im * sum[1] + leaving, im * sum[0] + re * sum[1]];\n            \
                         output += c_re * sum[0] - c_im * sum[1];\n        }}\n        \
                     output{given}\n    }}\n}}\n\n\
             impl Default for {camel} {{\n    fn default() -> Self {{\n        Self::new()\n    }}\n}}\n",
            self.origin,
            last = head - 1,
        )
    }

    /// A structure, which is at rest when it is zero, and a function `NAME_tick`.
    pub fn c(&self) -> String {
        let (head, pairs) = (self.table.head.len(), self.table.pairs.len());
        let small = self.name.to_ascii_lowercase();
        let (camel, scalar) = (camel_case(&small), self.scalar(["double", "float"]));
        let row = |[re, im, c_re, c_im]: &[f64; 4]| format!("    {{{re:e}, {im:e}, {c_re:e}, {c_im:e}}},\n");
        let numbers: String = self.table.pairs.iter().map(row).collect();
        let weights = rows(&self.table.head, "    ", "");
        format!(
            "/* {}: {head} weights, then {pairs} exponentials in pairs. A structure of zeros is the filter at rest. */\n\
             typedef struct {{\n    double recent[{head}];\n    double sums[{pairs}][2];\n}} {camel};\n\n\
             static const double {small}_head[{head}] = {{\n{weights}}};\n\n\
             /* Re rho, Im rho, Re c, Im c. */\n\
             static const double {small}_pairs[{pairs}][4] = {{\n{numbers}}};\n\n\
             /* Takes a sample; the output at its time. */\n\
             static inline {scalar} {small}_tick({camel} *filter, {scalar} sample) {{\n    \
                 const double leaving = filter->recent[{last}];\n    \
                 double output = 0.0;\n    \
                 for (int n = {last}; n > 0; n--) filter->recent[n] = filter->recent[n - 1];\n    \
                 filter->recent[0] = (double)sample;\n    \
                 for (int n = 0; n < {head}; n++) output += {small}_head[n] * filter->recent[n];\n    \
                 for (int j = 0; j < {pairs}; j++) {{\n        \
                     const double *pair = {small}_pairs[j];\n        \
                     double *sum = filter->sums[j];\n        \
                     const double re = pair[0] * sum[0] - pair[1] * sum[1] + leaving;\n        \
                     sum[1] = pair[1] * sum[0] + pair[0] * sum[1];\n        \
                     sum[0] = re;\n        \
                     output += pair[2] * sum[0] - pair[3] * sum[1];\n    }}\n    \
                 return ({scalar})output;\n}}\n",
            self.origin,
            last = head - 1,
        )
    }

    fn scalar(&self, [double, single]: [&'static str; 2]) -> &'static str {
        if self.in_single { single } else { double }
    }
}
