//! Signals that bring out the errors of an engine.

use fvi_core::Real;

/// A kind of test signal; its numbers are the same in every run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// A slow oscillation with noise of the same size.
    Stationary,
    /// The same under an envelope that falls from 1 to 10⁻⁸ over the length.
    Decaying,
    /// The same under an envelope that grows from 10⁻⁸ to 1 over the length.
    Growing,
    /// A tenth, which is rounded the same way at every step: errors of one sign accumulate.
    Constant,
}

impl Signal {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Stationary, Self::Decaying, Self::Growing, Self::Constant];

    /// `length` samples of `channels` numbers each, one sample after the other.
    pub fn samples<T: Real>(self, channels: usize, length: usize) -> Vec<T> {
        let mut noise = Noise(1);
        let mut samples = Vec::with_capacity(channels * length);
        for k in 0..length {
            let progress = k as f64 / length as f64;
            let envelope = match self {
                Self::Stationary | Self::Constant => 1.0,
                Self::Decaying => 10f64.powf(-8.0 * progress),
                Self::Growing => 10f64.powf(8.0 * progress - 8.0),
            };
            for channel in 0..channels {
                let smooth = (20.0 * progress + channel as f64).sin();
                let number = if self == Self::Constant { 0.1 } else { envelope * (smooth + noise.next()) };
                samples.push(T::of(number));
            }
        }
        samples
    }
}

/// Numbers spread evenly over (−1, 1): SplitMix64 by Steele, Lea and Flood.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^= bits >> 31;
        (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_are_a_wave_and_noise_under_an_envelope() {
        let [stationary, decaying, growing, constant] =
            Signal::ALL.map(|signal| signal.samples::<f64>(2, 50));
        assert_eq!(constant, [0.1; 100]);
        let mut noise = Noise(1);
        for index in 0..100 {
            let (progress, channel) = ((index / 2) as f64 / 50.0, (index % 2) as f64);
            let number = noise.next();
            assert!((-1.0..1.0).contains(&number));
            let expected = (20.0 * progress + channel).sin() + number;
            assert!((stationary[index] - expected).abs() < 1e-15, "{index}");
            let fallen = expected * 10f64.powf(-8.0 * progress);
            assert!((decaying[index] - fallen).abs() <= 1e-14 * fallen.abs(), "{index}");
            let risen = expected * 10f64.powf(8.0 * progress - 8.0);
            assert!((growing[index] - risen).abs() <= 1e-14 * risen.abs(), "{index}");
        }
    }

    #[test]
    fn noise_is_split_mix() {
        let mut noise = Noise(1);
        for bits in [0x910a_2dec_8902_5cc1_u64, 0xbeeb_8da1_658e_ec67] {
            assert_eq!(noise.next(), (bits >> 11) as f64 / 2f64.powi(52) - 1.0);
        }
    }
}
