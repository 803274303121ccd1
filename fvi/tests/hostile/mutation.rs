//! Mutations of texts, from a seed.

/// A stream of numbers that a seed determines: splitmix64.
pub(crate) struct Generator(u64);

impl Generator {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A whole number below `end`, 0 for `end` = 0.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }

    fn one_of<'a, T: ?Sized>(&mut self, list: &[&'a T]) -> &'a T {
        list[self.below(list.len())]
    }
}

const NUMBERS: &[&str] = &[
    "0",
    "-0",
    "0.0",
    "1",
    "-1",
    "2",
    "3",
    "0.5",
    "1.5",
    "1.999",
    "1e-15",
    "1e-6",
    "1e-300",
    "5e-324",
    "1e300",
    "1.7e308",
    "-1.7e308",
    "1e999",
    "nan",
    "inf",
    "-inf",
    "9223372036854775807",
    "18446744073709551615",
    "1e16",
    "0x7f",
    "1_0",
    "7",
    "8",
    "9",
    "6",
    "-3",
];

const TOKENS: &[&str] = &[
    "\"",
    "'",
    "\"\"\"",
    "[",
    "]",
    "[[",
    "]]",
    "{",
    "}",
    "=",
    ",",
    ".",
    "#",
    "\n",
    "\r\n",
    "\t",
    "\u{0}",
    "\u{1b}[2J",
    "\u{feff}",
    "é",
    "𝛽",
    "\\",
    "\\u0041",
    "q0",
    "q1",
    "q9",
    "t",
    "pi",
    "x0",
    "v0",
    "+",
    "-",
    "*",
    "/",
    "^",
    "(",
    ")",
    "sqrt(",
    "log(",
    "gamma(",
    "step(t - ",
    "min(",
    "exp(",
    "tan(",
    "true",
    "1979-05-27",
    "\"direct\"",
    "\"exponential-sum\"",
    "\"real-time\"",
    "\"block-fft\"",
    "\"galerkin\"",
    "\"explicit-euler\"",
    "\"implicit-euler\"",
    "\"lobatto-iiic\"",
    "\"radau-iia\"",
    "\"caputo\"",
    "\"riemann-liouville\"",
    "order = 2\n",
    "stages = 2\n",
    "degree = 2\n",
    "allow_unstable = true\n",
    "starting = [0.5]\n",
    "[reference]\nposition = [\"t\"]\n",
    "[history]\n",
    "[input]\n",
    "samples = [1]\nperiod = 0.1\n",
];

/// An entry of the corpus after one to four changes.
pub(crate) fn mutant(corpus: &[String], generator: &mut Generator) -> String {
    let texts: Vec<&str> = corpus.iter().map(String::as_str).collect();
    let mut bytes = generator.one_of(&texts).as_bytes().to_vec();
    for _ in 0..=generator.below(4) {
        change(&mut bytes, &texts, generator);
    }
    // Neither the parsers nor the differences between texts profit from longer ones.
    bytes.truncate(1 << 14);
    String::from_utf8_lossy(&bytes).into_owned()
}

fn change(bytes: &mut Vec<u8>, corpus: &[&str], generator: &mut Generator) {
    let place = generator.below(bytes.len() + 1);
    let length = generator.below(20);
    let range = place..(place + length).min(bytes.len());
    match generator.below(12) {
        0 => {
            if let Some(byte) = bytes.get_mut(place) {
                *byte ^= 1 << generator.below(8);
            }
        }
        1 => drop(bytes.drain(range)),
        2 => {
            let part = bytes[range].to_vec();
            bytes.splice(place..place, part);
        }
        3 | 4 => drop(bytes.splice(place..place, generator.one_of(TOKENS).bytes())),
        5..=8 => {
            // Another number in the place of one.
            let from = (place..bytes.len()).find(|&at| bytes[at].is_ascii_digit()).unwrap_or(place);
            let number = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'e');
            let to = from + bytes[from..].iter().take_while(|byte| number(byte)).count();
            bytes.splice(from..to, generator.one_of(NUMBERS).bytes());
        }
        9 => {
            // A part of another text.
            let other = generator.one_of(corpus).as_bytes();
            let start = generator.below(other.len());
            let end = (start + generator.below(200)).min(other.len());
            bytes.splice(place..place, other[start..end].iter().copied());
        }
        10 => {
            // A line less.
            let from = bytes[..place].iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
            let to = bytes[place..]
                .iter()
                .position(|&byte| byte == b'\n')
                .map_or(bytes.len(), |at| place + at + 1);
            bytes.drain(from..to);
        }
        _ => {
            let part: Vec<u8> = bytes[range].to_vec();
            for _ in 0..generator.below(40) {
                bytes.splice(place..place, part.iter().copied());
            }
        }
    }
}
