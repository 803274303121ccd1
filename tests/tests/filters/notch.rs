/// a notch and a resonance: 2 weights, then 4 exponentials in pairs.
#[derive(Clone, Debug)]
pub struct Notch {
    recent: [f64; 2],
    sums: [[f64; 2]; 4],
}

impl Notch {
    const HEAD: [f64; 2] = [
        1.375642616557348e0, 4.589426335242907e-1,
    ];

    /// Re rho, Im rho, Re c, Im c.
    const PAIRS: [[f64; 4]; 4] = [
        [0.9978052018501559, 0.019856137352430577, -0.0038374784869113694, -0.0010736431694251352],
        [0.9534851561640362, 0.28644563768201287, 0.44044101177615747, 0.3193749731159363],
        [0.33351903144181355, -0.0022176435196594414, 0.00014596649407835102, 2.8551488769614373e-5],
        [0.326208330426002, -0.03103056775865723, -0.01671072127393147, 0.009850755982587445],
    ];

    /// The filter at rest: all samples before the first one are zero.
    pub const fn new() -> Self {
        Self { recent: [0.0; 2], sums: [[0.0; 2]; 4] }
    }

    /// Takes a sample; the output at its time.
    pub fn tick(&mut self, sample: f32) -> f32 {
        let leaving = self.recent[1];
        self.recent.copy_within(..1, 1);
        self.recent[0] = f64::from(sample);
        let mut output = 0.0;
        for (weight, recent) in Self::HEAD.iter().zip(&self.recent) {
            output += weight * recent;
        }
        for ([re, im, c_re, c_im], sum) in Self::PAIRS.iter().zip(&mut self.sums) {
            *sum = [re * sum[0] - im * sum[1] + leaving, im * sum[0] + re * sum[1]];
            output += c_re * sum[0] - c_im * sum[1];
        }
        output as f32
    }
}

impl Default for Notch {
    fn default() -> Self {
        Self::new()
    }
}
