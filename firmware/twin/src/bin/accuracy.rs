//! Compares the memories available for firmware: accuracy against exact values, bytes, instructions. Prints
//! the tables of book/src/use/firmware.md and draws its picture.
//!
//! `accuracy COSTS PICTURE`: the file with the output of the image `costs`, and the path of the picture to be
//! written.

use std::error::Error;
use std::fs;

use fvi_core::{
    BdfOrder, ConvolutionWeights, ExponentialSum, ExponentialTable, FixedDirect, FractionalOperator, Memory,
    Start,
};
use plotters::prelude::*;
use scenarios::oustaloup::Oustaloup;
use scenarios::tables::{DAMPING, INTEGRAL};

const STEP_SIZE: f64 = 1e-3;
const STEPS: usize = 1_000_000;
/// Steps at which errors are printed: 0.1 s to 1000 s.
const PRINTED: [usize; 5] = [100, 1_000, 10_000, 100_000, 1_000_000];
/// Band of Oustaloup's filter in radians per second.
const BAND: (f64, f64) = (1e-4, 1e3);

/// A compared memory: its names in the table and in the costs, and its relative error at every step.
struct Candidate {
    name: String,
    cost: String,
    errors: Vec<f64>,
}

/// Relative errors of D^exponent of the unit step that starts at t = 0, for t = h, 2h, …
fn errors(
    exponent: f64,
    mut operation: impl FnMut(f32) -> Result<f32, Box<dyn Error>>,
) -> Result<Vec<f64>, Box<dyn Error>> {
    operation(1.0)?;
    (1..=STEPS)
        .map(|k| {
            let time = k as f64 * STEP_SIZE;
            let exact = time.powf(-exponent) / libm::tgamma(1.0 - exponent);
            Ok((f64::from(operation(1.0)?) / exact - 1.0).abs())
        })
        .collect()
}

fn memory(exponent: f64, memory: impl Memory<f32>) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut operation = FractionalOperator::new(memory, Start::RiemannLiouville)?;
    errors(exponent, |sample| Ok(operation.push(sample)?))
}

fn short<const H: usize>(exponent: f64) -> Result<Candidate, Box<dyn Error>> {
    let mut weights = vec![0.0f32; H + 1];
    ConvolutionWeights::bdf(BdfOrder::GRUNWALD_LETNIKOV, exponent, STEP_SIZE)?.fill(&mut weights);
    Ok(Candidate {
        name: format!("short memory, {H} samples"),
        cost: format!("direct {H} x 1"),
        errors: memory(exponent, FixedDirect::<f32, 1, H>::short_memory(&weights, 1.0)?)?,
    })
}

fn oustaloup<const S: usize>(exponent: f64) -> Result<Candidate, Box<dyn Error>> {
    let mut filter = Oustaloup::<f32, S>::new(exponent, BAND.0, BAND.1, STEP_SIZE);
    Ok(Candidate {
        name: format!("Oustaloup, {S} sections"),
        cost: format!("Oustaloup {S}"),
        errors: errors(exponent, |sample| Ok(filter.push(sample)))?,
    })
}

fn candidates(
    exponent: f64,
    table: ExponentialTable<&'static [f32]>,
) -> Result<Vec<Candidate>, Box<dyn Error>> {
    let state = vec![0.0f32; table.state_len(1)];
    Ok(vec![
        short::<32>(exponent)?,
        short::<64>(exponent)?,
        short::<128>(exponent)?,
        short::<256>(exponent)?,
        short::<1024>(exponent)?,
        oustaloup::<15>(exponent)?,
        oustaloup::<31>(exponent)?,
        oustaloup::<75>(exponent)?,
        Candidate {
            name: "exponential sum".into(),
            cost: "exponential sum x 1".into(),
            errors: memory(exponent, ExponentialSum::new(table, 1.0, 1, state)?)?,
        },
    ])
}

fn percent(error: f64) -> String {
    match error * 100.0 {
        percent if percent >= 100.0 => format!("{percent:.0} %"),
        percent if percent >= 1.0 => format!("{percent:.1} %"),
        percent => format!("{percent:.1e} %"),
    }
}

/// One table; `costs` maps a name to RAM, table, mean and worst case.
fn print_table(
    candidates: &[Candidate],
    costs: impl Fn(&str) -> Result<[String; 4], Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    println!(
        "| memory | RAM / B | table / B | instructions per step | worst | error at 0.1 s | 1 s | 10 s | 100 s | 1000 s |"
    );
    println!("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|");
    for Candidate { name, cost, errors } in candidates {
        let [ram, table, mean, worst] = costs(cost)?;
        let errors = PRINTED.map(|step| percent(errors[step - 1])).join(" | ");
        println!("| {name} | {ram} | {table} | {mean} | {worst} | {errors} |");
    }
    Ok(())
}

fn draw(candidates: &[Candidate], file: &str) -> Result<(), Box<dyn Error>> {
    let area = SVGBackend::new(file, (900, 560)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption("Half derivative of a unit step, h = 1 ms: relative error", ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d((1e-2..1e3f64).log_scale(), (1e-8..1e4f64).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("t / s")
        .y_desc("relative error")
        .x_label_formatter(&|x| format!("{x:.0e}"))
        .y_label_formatter(&|y| format!("{y:.0e}"))
        .draw()?;
    for (index, candidate) in candidates.iter().enumerate() {
        let colour = Palette99::pick(index).stroke_width(2);
        let steps =
            std::iter::successors(Some(10usize), |k| Some(k + k / 12 + 1)).take_while(|&k| k <= STEPS);
        let points = steps.map(|k| (k as f64 * STEP_SIZE, candidate.errors[k - 1].clamp(1e-8, 1e4)));
        chart
            .draw_series(LineSeries::new(points, colour))?
            .label(&candidate.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    area.present()?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(costs), Some(picture)) = (arguments.next(), arguments.next()) else {
        return Err("usage: accuracy COSTS PICTURE".into());
    };
    let costs = fs::read_to_string(costs)?;
    let look_up = |name: &str| -> Result<[String; 4], Box<dyn Error>> {
        let row = costs
            .lines()
            .map(|line| line.split(',').collect::<Vec<_>>())
            .find(|row| row.first() == Some(&name));
        match row.as_deref() {
            Some([_, mean, worst, _, ram, table, _]) => Ok([
                ram.to_string(),
                table.to_string(),
                format!("{:.0}", mean.parse::<f64>()?),
                worst.to_string(),
            ]),
            _ => Err(format!("no cost of {name}").into()),
        }
    };
    let derivative = candidates(0.5, DAMPING)?;
    println!("Half derivative of a unit step:\n");
    print_table(&derivative, look_up)?;
    println!("\nIntegral of order 0.8 of a unit step:\n");
    print_table(&candidates(-0.8, INTEGRAL)?, look_up)?;
    draw(&derivative, &picture)
}
