//! Convolves a WAV file with the response of a room, in another WAV file:
//!
//! ```text
//! cargo run --release -p fvi-fft --example convolve_wav -- dry.wav room.wav wet.wav
//! ```
//!
//! Without arguments it makes a click and a decaying response itself, in the folder of temporary files.

use std::error::Error;
use std::path::{Path, PathBuf};

use fvi_fft::{Convolver, Responses, Stream};
use hound::{SampleFormat, WavReader, WavSpec, WavWriter};

/// Samples of a call.
const BLOCK: usize = 4096;

/// The channels of a file.
type Channels = Vec<Vec<f32>>;

/// The channels of a file, and its samples per second.
fn read(path: &Path) -> Result<(Channels, u32), Box<dyn Error>> {
    let mut reader = WavReader::open(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let spec = reader.spec();
    let samples: Vec<f32> = match spec.sample_format {
        SampleFormat::Float => reader.samples::<f32>().collect::<Result<_, _>>()?,
        SampleFormat::Int => {
            let scale = 2f32.powi(1 - i32::from(spec.bits_per_sample));
            let samples = reader.samples::<i32>().map(|sample| sample.map(|number| number as f32 * scale));
            samples.collect::<Result<_, _>>()?
        }
    };
    let channels = usize::from(spec.channels);
    let of_channel = |channel| samples.iter().skip(channel).step_by(channels).copied().collect();
    Ok(((0..channels).map(of_channel).collect(), spec.sample_rate))
}

fn write(path: &Path, channels: &[Vec<f32>], sample_rate: u32) -> Result<(), Box<dyn Error>> {
    let spec = WavSpec {
        channels: u16::try_from(channels.len())?,
        sample_rate,
        bits_per_sample: 32,
        sample_format: SampleFormat::Float,
    };
    let mut writer = WavWriter::create(path, spec)?;
    for k in 0..channels.first().map_or(0, Vec::len) {
        channels.iter().try_for_each(|channel| writer.write_sample(channel[k]))?;
    }
    Ok(writer.finalize()?)
}

/// A click, and half a second of noise that decays.
fn made() -> Result<[PathBuf; 3], Box<dyn Error>> {
    let [dry, room, wet] =
        ["fvi-dry.wav", "fvi-room.wav", "fvi-wet.wav"].map(|name| std::env::temp_dir().join(name));
    let mut click = vec![0.0; 48_000];
    click[0] = 0.5;
    let mut state = 1u32;
    let mut noise = |n: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state as f32 / u32::MAX as f32 - 0.5) * (-6.0 * n as f32 / 24_000.0).exp()
    };
    write(&dry, &[click.clone(), click], 48_000)?;
    write(&room, &[(0..24_000).map(&mut noise).collect()], 48_000)?;
    Ok([dry, room, wet])
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [dry, room, wet] = match <[PathBuf; 3]>::try_from(arguments) {
        Ok(paths) => paths,
        Err(none) if none.is_empty() => made()?,
        Err(_) => return Err("the arguments are three files: the sound, the response, the result".into()),
    };
    let ((mut sound, rate), (response, of_response)) = (read(&dry)?, read(&room)?);
    if rate != of_response {
        let (dry, room) = (dry.display(), room.display());
        return Err(format!("{dry} has {rate} samples per second, {room} {of_response}").into());
    }
    // One response for all channels, or one for each.
    let responses = match response.as_slice() {
        [one] => Responses::shared(one, sound.len())?,
        _ if response.len() == sound.len() => Responses::each(&response)?,
        _ => return Err(format!("{} channels and {} responses", sound.len(), response.len()).into()),
    };
    // The sound, until the response has died away.
    let length = sound.iter().map(Vec::len).max().unwrap_or(0) + responses.longest() - 1;
    sound.iter_mut().for_each(|channel| channel.resize(length, 0.0));
    let stream = Stream { block: Some(BLOCK), ..Stream::default() };
    let mut convolver = Convolver::new(&responses, &stream)?;
    let mut output = vec![vec![0.0; length]; sound.len()];
    for first in (0..length).step_by(BLOCK) {
        let block = first..length.min(first + BLOCK);
        let inputs: Vec<&[f32]> = sound.iter().map(|channel| &channel[block.clone()]).collect();
        let mut outputs: Vec<&mut [f32]> =
            output.iter_mut().map(|channel| &mut channel[block.clone()]).collect();
        convolver.process(&inputs, &mut outputs)?;
    }
    write(&wet, &output, rate)?;
    println!("{}: {} channels, {:.3} s", wet.display(), output.len(), length as f64 / f64::from(rate));
    Ok(())
}
