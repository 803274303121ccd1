//! Figures 4 to 6: the linearly damped oscillator as a fractional one.

use super::super::error_curve::{ErrorCurve, error_chart, error_table};
use super::super::motion::{Motion, motion_chart, motion_table};
use super::super::problems::{jo_oscillator, on_grid, with_scheme};
use super::super::table::{Column, Format, Table};
use super::super::{Findings, ReproduceError};
use super::lagrange_dalembert::{LinearOscillator, positions};
use fvi_fft::sums::max_or_nan;
use fvi_fft::transfer::TransferFunction;
use fvi_host::converge::{Grids, Quantity};
use fvi_host::results::picture::{Axis, Chart, Series, Style};
use fvi_scenario::scenario::{Scenario, Scheme};
use std::sync::atomic::AtomicBool;

/// The orders in the Lagrangian of figure 4. The paper does not list the orders that it used.
const ALPHAS: [f64; 5] = [0.25, 0.4, 0.5, 0.6, 0.75];

fn with_alpha(alpha: f64) -> Result<Scenario, ReproduceError> {
    let mut scenario = jo_oscillator()?;
    for term in &mut scenario.system.damping {
        term.transfer = TransferFunction::power(2.0 * alpha)?;
    }
    Ok(scenario)
}

pub(super) fn figure_4(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    const STEP: f64 = 0.5;
    const STEPS: usize = 30;
    let mut motions = Vec::new();
    let columns =
        ["h = 1/2", "h = 1/8", "h = 1/32", "h = 1/128"].map(|name| Column::new(name, Format::Error));
    let columns = [Column::new("α", Format::Exact)].into_iter().chain(columns).collect();
    let caption = "Largest difference of q, t ≥ 1, between the step h and the step h/2";
    let mut differences = Table::new("step-sizes", caption, columns);
    for alpha in ALPHAS {
        let scenario = with_alpha(alpha)?;
        let run = |refined: usize| {
            let grid = on_grid(scenario.clone(), STEP / refined as f64, STEPS * refined);
            Motion::run(format!("α = {alpha}"), &grid, stop)
        };
        let mut row = vec![alpha.into()];
        for refined in [1, 4, 16, 64] {
            row.push(difference(&run(refined)?, &run(2 * refined)?).into());
        }
        differences = differences.with_row(row);
        motions.push(run(1)?);
    }
    let motions: Vec<&Motion> = motions.iter().collect();
    let linear = on_grid(with_alpha(0.5)?, STEP, STEPS);
    let error = Motion::run("", &linear, stop)?.errors(&linear).position.largest;
    let title = "Fractional oscillator, ρ = 0.2, q(0) = 1, p(0) = ½";
    let subtitle = "low order, κ = ½; Grünwald–Letnikov on q itself; h = ½, 30 steps; exact: α = ½";
    Ok(Findings::default()
        .with_picture(
            "",
            "Positions over time for five α",
            motion_chart(title, subtitle, Quantity::Position, &motions, &linear),
        )
        .agrees(
            "α = ½ against the exact solution of the linearly damped oscillator",
            "“approximates properly”",
            format!("largest error of q {error:.1e} with h = ½"),
        )
        .with_table(motion_table("", "Positions", &[Quantity::Position], &motions))
        .with_table(differences)
        .with_remark(
            "The text of the paper does not list its values of α. For α ≠ ½ the derivative of q itself, with q(0) = 1, is a force \
             −ρ t^(−2α)/Γ(1−2α) that is singular at t = 0: integrable for α < ½, where halving the step changes less and less; not for \
             α > ½, where it changes more and more: those curves belong to the step size and have no limit. Caputo's derivative, the \
             default of scenario files, has no such force.",
        ))
}

/// Largest difference of positions at the grid points t ≥ 1 of the coarse motion; the step of the fine one is
/// half as long.
fn difference(coarse: &Motion, fine: &Motion) -> f64 {
    let pairs = coarse.states.iter().zip(fine.states.iter().step_by(2));
    let late = pairs.filter(|(coarse, _)| coarse.time >= 1.0);
    late.fold(0.0, |largest, (a, b)| max_or_nan(largest, (a.position[0] - b.position[0]).abs()))
}

/// The variational integrator and a baseline on the same grid.
struct Duel {
    name: &'static str,
    scheme: &'static str,
    step: f64,
    variational: Motion,
    baseline: Motion,
    /// The scenario of the variational one, with the reference.
    scenario: Scenario,
}

/// The two comparisons with Euler methods, on [0, 30].
fn duels(stop: &AtomicBool) -> Result<[Duel; 2], ReproduceError> {
    let duel = |name, scheme: &'static str, kind: Scheme, step: f64, steps: usize| {
        let scenario = on_grid(jo_oscillator()?, step, steps);
        let variational = Motion::run("variational", &scenario, stop)?;
        let baseline = Motion::run(scheme, &with_scheme(scenario.clone(), kind), stop)?;
        Ok::<_, ReproduceError>(Duel { name, scheme, step, variational, baseline, scenario })
    };
    Ok([
        duel("implicit-euler", "implicit Euler", Scheme::ImplicitEuler, 0.2, 150)?,
        duel("explicit-euler", "explicit Euler", Scheme::ExplicitEuler, 0.1, 300)?,
    ])
}

impl Duel {
    fn chart(&self, quantity: Quantity) -> Chart {
        let title = format!("Linearly damped oscillator: variational integrator and {}", self.scheme);
        let subtitle = format!("α = ½, ρ = 0.2, q(0) = 1, p(0) = ½; step {}", self.step);
        motion_chart(&title, &subtitle, quantity, &[&self.variational, &self.baseline], &self.scenario)
    }

    fn table(&self, caption: &str, quantities: &[Quantity]) -> Table {
        motion_table(self.name, caption, quantities, &[&self.variational, &self.baseline])
    }
}

/// Step sizes 1/8 … 1/256 on [0, 30]; the paper does not state those that it used.
const GRIDS: Grids = Grids { levels: 3..=8, intervals: 30, from: 0.0 };
const STEP_SIZES: &str = "h = 1/8 … 1/256 on [0, 30]";

/// Explains why the slope depends on the step sizes.
fn order_rises(curve: &ErrorCurve) -> String {
    format!(
        "the paper does not print its step sizes; the order rises to 1 as h falls, from level to level {}, and the slope depends on \
         where one begins",
        curve.orders_in_words()
    )
}

pub(super) fn figure_5(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let mut findings = Findings::default();
    for duel in duels(stop)? {
        let of = |motion: &Motion| motion.errors(&duel.scenario).position.largest;
        let ours = format!("{:.1e} and {:.1e}", of(&duel.variational), of(&duel.baseline));
        let quantity = format!("largest error of q, variational and {}, h = {}", duel.scheme, duel.step);
        let caption = format!("Positions: variational integrator and {}", duel.scheme);
        let table = duel.table(&caption, &[Quantity::Position, Quantity::Momentum]);
        findings = findings
            .with_picture(duel.name, caption, duel.chart(Quantity::Position))
            .with_table(table)
            .agrees(quantity, "variational is closer (curves)", ours);
    }
    let scenario = on_grid(jo_oscillator()?, 0.2, 150);
    let differences = difference_to_lagrange_dalembert(&scenario, stop)?;
    let largest = differences.iter().fold(0.0, |largest, &(_, d)| max_or_nan(largest, d.abs()));
    let chart = Chart::new(
        "Variational minus Lagrange–d'Alembert integrator, α = ½",
        Axis::linear("time t"),
        Axis::linear("difference of q"),
    )
    .with_subtitle("step 0.2")
    .with(Series::new("difference", Style::Line, differences.clone()));
    let rows = differences.iter().map(|&(t, d)| vec![t.into(), d.into()]);
    findings = findings
        .with_picture("lagrange-dalembert", "Difference of the two integrators over time", chart)
        .with_table(Table::of_curves("lagrange-dalembert", "Difference of q", &["t", "difference"], rows))
        .agrees(
            "variational minus Lagrange–d'Alembert, h = 0.2",
            "machine rounding error",
            format!("at most {largest:.1e}"),
        );
    let measure =
        |label: &str, quantity| ErrorCurve::measure(label, &jo_oscillator()?, &GRIDS, quantity, stop);
    let curves = [measure("q", Quantity::Position)?, measure("p", Quantity::Momentum)?];
    for curve in &curves {
        let quantity = format!("global order of {}, {STEP_SIZES}", curve.label);
        findings = findings.differs(quantity, "0.94", format!("{:.2}", curve.slope()), order_rises(curve));
    }
    let chart = error_chart(
        "Linearly damped oscillator: errors of the variational integrator",
        format!("α = ½, low order, κ = ½, Grünwald–Letnikov; {STEP_SIZES}"),
        &curves,
        &[1.0],
    );
    Ok(findings
        .with_picture("errors", "Largest errors of q and p over step sizes", chart)
        .with_table(error_table("errors", "Largest errors of q and p", &curves)))
}

/// q of the variational integrator minus q of the recursion with discrete forces, over time.
fn difference_to_lagrange_dalembert(
    scenario: &Scenario,
    stop: &AtomicBool,
) -> Result<Vec<(f64, f64)>, ReproduceError> {
    let oscillator = LinearOscillator {
        coefficient: 0.2,
        position: scenario.initial.position[0],
        momentum: scenario.initial.momentum[0],
    };
    let other = positions(&oscillator, scenario.time.step, scenario.time.steps);
    let motion = Motion::run("", scenario, stop)?;
    Ok(motion.states.iter().zip(other).map(|(state, q)| (state.time, state.position[0] - q)).collect())
}

pub(super) fn figure_6(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let mut findings = Findings::default();
    for duel in duels(stop)? {
        let exact = duel.scenario.reference.as_ref().and_then(|reference| reference.at_time(30.0, 1));
        let exact = exact.and_then(|row| row.energy).unwrap_or(f64::NAN);
        let share = |motion: &Motion| motion.last_energy() / exact;
        let caption = format!("Energies: variational integrator and {}", duel.scheme);
        findings = findings.with_table(duel.table(&caption, &[Quantity::Energy])).with_picture(
            duel.name,
            caption,
            duel.chart(Quantity::Energy),
        );
        let quantity = format!(
            "energy at t = 30 over the exact one, variational and {}, h = {}",
            duel.scheme, duel.step
        );
        let ours = format!("{:.3} and {:.3}", share(&duel.variational), share(&duel.baseline));
        findings = match duel.name {
            "explicit-euler" => findings.differs(
                quantity,
                "“loses”",
                ours,
                "the paper's sentence says that implicit and explicit Euler gain and lose energy, in this order; it is the other way round",
            ),
            _ => findings.differs(quantity, "“gains”", ours, "as below"),
        };
    }
    let curve = ErrorCurve::measure("energy", &jo_oscillator()?, &GRIDS, Quantity::Energy, stop)?;
    let curves = [curve];
    let chart = error_chart(
        "Linearly damped oscillator: error of the energy",
        format!("α = ½, low order, κ = ½, Grünwald–Letnikov; {STEP_SIZES}"),
        &curves,
        &[1.0],
    );
    Ok(findings
        .with_picture("errors", "Largest error of the energy over step sizes", chart)
        .differs(
            format!("global order of the energy, {STEP_SIZES}"),
            "0.94",
            format!("{:.2}", curves[0].slope()),
            order_rises(&curves[0]),
        )
        .with_table(error_table("errors", "Largest error of the energy", &curves)))
}
