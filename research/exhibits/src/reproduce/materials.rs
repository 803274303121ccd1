//! Materials and fluids with memory: curves of their kernels, and motions that they damp compared with exact
//! ones.

use super::error_curve::ErrorCurve;
use super::motion::Motion;
use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_fft::memory::Engine;
use fvi_fft::transfer::TransferFunction;
use fvi_fft::transfer::laplace::{creep, relaxation, whole};
use fvi_host::response::Complex;
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::language::Document;
use fvi_scenario::scenario::{Scenario, kernel_of_symbol};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Name of the page.
pub(super) const PAGE: &str = "materials.md";

pub(super) const EXHIBITS: [Exhibit; 2] = [
    Exhibit::beyond(
        "materials",
        "motions damped by memories of materials and fluids, beside exact ones",
        motions,
    )
    .on_page(PAGE),
    Exhibit::beyond("kernels", "creep, relaxation and loss factor", kernels).on_page(PAGE),
];

/// Head of the page.
pub(super) const HEAD: &str = "# Which kernel for which material\n\n\
    `fvi reproduce materials kernels --out book/src/use` writes this page, its pictures and the CSV files behind them. What a kernel is and where it \
    serves: [kernels.md](../theory/kernels.md).\n\n\
    | what is observed | `[[system.damping]]` | scenario |\n|---|---|---|\n\
    | creep that goes on like t^β over many decades, no plateau | `order = β`, a springpot | `creep-seventeen-decades.toml` |\n\
    | a plateau at long times, a glass modulus at short ones, a broad slope between them | a spring (`potential` or `stiffness`) beside \
    `{ form = \"maxwell\", order = β, time = τ }`: fractional Zener | `zener-oscillator.toml` |\n\
    | the same, with a power law at short times in place of a glass modulus | `\"maxwell\"` with `inner` > 0 | |\n\
    | a data sheet with moduli and relaxation times | `\"prony\"`, its long-time modulus as stiffness | `prony-beam-joint.toml` |\n\
    | a peak of the loss factor with unequal flanks: rubber, dielectrics | `\"havriliak-negami\"`; with α = 1 the fast flank alone is broad | |\n\
    | a power law that ends at a longest relaxation time, so that displacements are forgotten | `\"tempered\"` | |\n\
    | a measured relaxation curve | `{ relaxation = \"G.csv\" }` | |\n\
    | waves about ships and wave-energy converters | `{ relaxation = [[\"G00.csv\", …], …] }`, Cummins' equation | |\n\
    | a sphere in a viscous fluid: Basset's history force | `order = 1.5`, beside Stokes' drag `order = 1` | |\n\
    | anything analytic off the negative real axis | `{ symbol = \"…\" }` | |\n";

/// Positions and momenta to 20 digits at t = 1, 2, 4, 8: `tests/reference/materials.py`.
const VALUES: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/reference/materials.csv"));

/// A motion with known values.
struct Known {
    /// Its name in [`VALUES`].
    name: &'static str,
    title: &'static str,
    /// `[system]` and `[initial]`.
    system: &'static str,
}

const OSCILLATORS: [Known; 4] = [
    Known {
        name: "zener",
        title: "fractional Zener solid",
        system: "[system]\nmass = [1.0]\npotential = \"0.25*q0^2\"\n[[system.damping]]\ncoefficient = [1.5]\n\
                 kernel = { form = \"maxwell\", order = 0.6, time = 1.0 }\n[initial]\nposition = [1.0]\n",
    },
    Known {
        name: "tempered",
        title: "tempered damping",
        system: "[system]\nmass = [1.0]\npotential = \"0.5*q0^2\"\n[[system.damping]]\ncoefficient = [0.8]\n\
                 kernel = { form = \"tempered\", order = 0.6, rate = 0.5 }\n[initial]\nposition = [1.0]\n",
    },
    Known {
        name: "polymer",
        title: "polymer, Prony series of five times",
        system: "[system]\nmass = [1.0]\npotential = \"0.06*q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                 kernel = { form = \"prony\", strengths = [0.22, 0.25, 0.21, 0.13, 0.07], times = [1e-3, 1e-2, 0.1, 1.0, 10.0] }\n\
                 [initial]\nposition = [0.0]\nvelocity = [1.0]\n",
    },
    Known {
        name: "body",
        title: "floating body, Cummins' equation",
        system: "[system]\nmass = [2.0]\npotential = \"1.5*q0^2\"\n[[system.damping]]\ncoefficient = [1.0]\n\
                 kernel = { relaxation = \"G.csv\" }\n[initial]\nposition = [1.0]\n",
    },
];

/// The retardation function of the floating body.
const RETARDATION: &str = "t,G\n0,1\n1,0.25\n2,-0.1\n3,0.03\n4,0\n";

/// A sphere that settles under Stokes' drag and Basset's force.
const SPHERE: Known = Known {
    name: "basset",
    title: "settling sphere, Basset's force",
    system: "[system]\nmass = [1.0]\nforce = [\"1\"]\n[[system.damping]]\norder = 1.5\ncoefficient = [3.0]\n\
             [[system.damping]]\norder = 1.0\ncoefficient = [1.0]\n[initial]\nposition = [0.0]\n",
};

/// Degree of the scheme, and order of its backward differentiation formula.
const SCHEMES: [(usize, usize); 4] = [(1, 2), (2, 3), (2, 4), (3, 5)];

/// Numbers of steps per unit of time (`STEPS`), and the last time.
const STEPS: [usize; 3] = [32, 64, 128];
const END: usize = 8;

impl Known {
    /// t, q and p.
    fn values(&self) -> Vec<[f64; 3]> {
        let numbers = |line: &str| -> Option<[f64; 3]> {
            let (name, numbers) = line.split_once(',')?;
            let numbers: Vec<f64> = numbers.split(',').filter_map(|cell| cell.parse().ok()).collect();
            (name == self.name).then(|| numbers.try_into().ok()).flatten()
        };
        VALUES.lines().filter_map(numbers).collect()
    }

    fn scenario(&self, rest: &str) -> Result<Scenario, ReproduceError> {
        let document = Document::new(self.title, Path::new(""), &format!("{}{rest}", self.system));
        let mut scenario = Scenario::from_document(document.with_attached("G.csv", RETARDATION))?;
        if scenario.time.grid.is_none() {
            // Plain sums have the same bits on every machine.
            scenario.history.choose(Engine::Direct);
        }
        Ok(scenario)
    }

    /// Largest errors of q and p at those of the known times that are grid points.
    fn errors(&self, motion: &Motion) -> [f64; 2] {
        let mut errors = [0.0_f64; 2];
        for [time, q, p] in self.values() {
            let at = motion.states.iter().find(|state| (state.time - time).abs() < 1e-9 * time);
            if let Some(state) = at {
                errors[0] = errors[0].max((state.position[0] - q).abs());
                errors[1] = errors[1].max((state.momentum[0] - p).abs());
            }
        }
        errors
    }
}

fn motions(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let text = |name: &str| Column::new(name, Format::Exact);
    let error = |name: String| Column::new(name, Format::Error);
    let order = |name: String| Column::new(name, Format::Order).headed("order");
    let mut columns = vec![text("")];
    for (degree, formula) in SCHEMES {
        let scheme = format!("Gauss {degree}, BDF {formula}");
        columns.extend([error(scheme.clone()), order(format!("order, {scheme}"))]);
    }
    let caption =
        "Largest errors of q at t = 1, 2, 4, 8 with 128 steps a unit of time, and orders from 64 to 128";
    let mut table = Table::new("errors", caption, columns);
    let mut chart = Chart::new("Damped by memories", Axis::linear("time t"), Axis::linear("position q"));
    for (index, known) in OSCILLATORS.iter().enumerate() {
        let mut row: Vec<Cell> = vec![known.title.into()];
        for (degree, formula) in SCHEMES {
            // The delay factors e^{−sT} of a retardation function grow to the left of the imaginary axis,
            // where formulas of higher order evaluate the kernel.
            if known.name == "body" && formula > 2 {
                row.extend([Cell::Empty, Cell::Empty]);
                continue;
            }
            let mut points = Vec::new();
            for steps in STEPS {
                let rest = format!(
                    "[scheme]\nkind = \"galerkin\"\ndegree = {degree}\n[convolution]\norder = {formula}\n[time]\nstep = {:?}\n\
                     steps = {}\n",
                    1.0 / steps as f64,
                    END * steps
                );
                let motion = Motion::run("", &known.scenario(&rest)?, stop)?;
                points.push((1.0 / steps as f64, known.errors(&motion)[0]));
                if formula == 2 && steps == STEPS[2] {
                    let path = motion.states.iter().map(|state| (state.time, state.position[0])).collect();
                    let exact = known.values().iter().map(|[t, q, _]| (*t, *q)).collect();
                    chart = chart
                        .with(Series::new(known.title, Style::Line, path).with_colour_of(index))
                        .with(Series::new("", Style::ReferencePoints, exact));
                }
            }
            let finest = points.last().map(|point| point.1);
            row.extend([finest.into(), Cell::from(ErrorCurve::new("", points).slope_of_finest(2))]);
        }
        table = table.with_row(row);
    }
    let columns = vec![
        Column::new("steps", Format::Exact),
        error("error of q".to_owned()),
        order("order of q".to_owned()),
        error("error of v".to_owned()),
        order("order of v".to_owned()),
    ];
    let caption =
        format!("{}: errors at t = {END} on a graded grid, collocation by Radau IIA 3", SPHERE.title);
    let mut sphere = Table::new("basset", caption, columns);
    let mut before: Option<(f64, [f64; 2])> = None;
    for steps in [50_usize, 100, 200] {
        let rest = format!(
            "[scheme]\nkind = \"collocation\"\n[time]\ngrid = \"graded\"\nend = {END}\nsteps = {steps}\nexponent = 3.0\n"
        );
        let errors = SPHERE.errors(&Motion::run("", &SPHERE.scenario(&rest)?, stop)?);
        let order = |which: usize| before.map(|(_, before)| (before[which] / errors[which]).log2());
        sphere = sphere.with_row([
            (steps as f64).into(),
            errors[0].into(),
            order(0).into(),
            errors[1].into(),
            order(1).into(),
        ]);
        before = Some((steps as f64, errors));
    }
    Ok(Findings::default()
        .with_picture("", "Motions of four materials with their exact values", chart)
        .with_table(table)
        .with_table(sphere)
        .with_remark(
            "The values are inverse Laplace transforms in 60 digits (`tests/reference/materials.py`): of the fractional Zener solid q̈ + ½ q + 3/2 K(D) q = 0, \
             of tempered damping, of a Prony series with relaxation times from 10⁻³ to 10, shorter than the steps and longer than the run; of a \
             floating body in a decay test, whose retardation function is five rows of a file, linear in between: its solution is a series in delays e^(−ks), each \
             term of which is a rational function; BDF of order 3 and more, which are not A-stable, cannot take such a kernel. The sphere q̈ + 3 D^(3/2) q + q̇ = 1 starts at rest, with the velocity \
             [(1 − w(α))/α − (1 − w(β))/β]/(β − α), w(x) = e^(x²t) erfc(x √t), α, β = (3 ∓ √5)/2.",
        ))
}

/// Kernels whose curves are shown, with springs so that they have a plateau.
fn shown() -> Result<Vec<(&'static str, TransferFunction)>, ReproduceError> {
    Ok(vec![
        ("springpot s^0.3", TransferFunction::power(0.3)?),
        ("fractional Zener", kernel_of_symbol("0.05 + s^0.6/(1 + s^0.6)")?),
        ("standard solid", kernel_of_symbol("0.05 + s/(1 + s)")?),
        ("Havriliak–Negami", kernel_of_symbol("0.05 + 1 - (1 + s^0.8)^-0.4")?),
        ("tempered", kernel_of_symbol("0.05 + (s + 0.1)^0.3 - 0.1^0.3")?),
    ])
}

fn kernels(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    const PLACES: i32 = 121;
    let at = |k: i32| libm::exp10(-4.0 + f64::from(k) / 15.0);
    let chart = |x: &str, y: Axis| Chart::new("Five materials", Axis::logarithmic(x), y);
    let mut charts = [
        chart("time t", Axis::logarithmic("relaxation G(t)")),
        chart("time t", Axis::logarithmic("creep J(t)")),
        chart("angular frequency ω", Axis::logarithmic("loss factor Im K/Re K")),
    ];
    let mut rows: Vec<Vec<Cell>> = (0..PLACES).map(|k| vec![at(k).into()]).collect();
    let mut names = vec!["x".to_owned()];
    for (name, transfer) in shown()? {
        if stop.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(ReproduceError::Stopped);
        }
        let loss = |omega: f64| {
            let value = whole(&transfer, Complex::new(0.0, omega));
            Some(value.im / value.re)
        };
        let curves: [&dyn Fn(f64) -> Option<f64>; 3] =
            [&|t| relaxation(&transfer, t), &|t| creep(&transfer, t), &loss];
        for ((what, curve), chart) in ["G", "J", "loss"].iter().zip(curves).zip(&mut charts) {
            let values: Vec<Option<f64>> = (0..PLACES).map(|k| curve(at(k))).collect();
            let points = values.iter().enumerate().filter_map(|(k, value)| Some((at(k as i32), (*value)?)));
            *chart = chart.clone().with(Series::new(name, Style::Line, points.collect()));
            rows.iter_mut().zip(&values).for_each(|(row, value)| row.push((*value).into()));
            names.push(format!("{what}, {name}"));
        }
    }
    let [relaxation, creep, loss] = charts;
    let columns: Vec<&str> = names.iter().map(String::as_str).collect();
    let caption = "G and J at the time x, loss factors at the frequency x";
    Ok(Findings::default()
        .with_picture("relaxation", "Relaxation of five materials", relaxation)
        .with_picture("creep", "Creep of five materials", creep)
        .with_picture("loss", "Loss factors of five materials", loss)
        .with_table(Table::of_curves("curves", caption, &columns, rows))
        .with_remark(
            "Springpot s^0.3; fractional Zener 0.05 + s^0.6/(1 + s^0.6); the standard solid 0.05 + s/(1 + s), one Maxwell element beside a spring; \
             Havriliak–Negami 0.05 + 1 − (1 + s^0.8)^−0.4; tempered 0.05 + (s + 0.1)^0.3 − 0.1^0.3. Of a scenario's own kernels `fvi response` writes these curves.",
        ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_are_those_of_their_formulas_with_the_orders_of_their_schemes() {
        let found = motions(&AtomicBool::new(false)).unwrap();
        let number = |cell: &Cell| if let Cell::Number(number) = cell { *number } else { f64::NAN };
        let [errors, sphere] = &found.tables[..] else { panic!("two tables") };
        for row in &errors.rows {
            for ((scheme, pair), (order, most)) in SCHEMES.iter().zip(row[1..].chunks(2)).zip([
                (1.9, 1e-3),
                (2.7, 1e-5),
                (3.5, 1e-6),
                (4.3, 1e-7),
            ]) {
                if pair[0] == Cell::Empty {
                    continue;
                }
                let (error, slope) = (number(&pair[0]), number(&pair[1]));
                assert!(
                    error < most && (slope > order || error < 1e-11),
                    "{:?}, {scheme:?}: {error:e}, {slope}",
                    row[0]
                );
            }
        }
        let last = sphere.rows.last().unwrap();
        assert!(number(&last[1]) < 1e-9 && number(&last[3]) < 1e-9, "{last:?}");
    }
}
