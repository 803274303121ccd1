//! Published tunings of fractional controllers, compared with the program's results for the same
//! specifications.

use super::table::{Cell, Column, Format, Table};
use super::{Exhibit, Findings, ReproduceError};
use fvi_core::{DerivativeFilter, PidGains, min_or_nan};
use fvi_fft::sums::max_or_nan;
use fvi_host::tune::{Law, Margins, TuneError, TuningProblem, find, margins_of};
use fvi_scenario::language::Document;
use std::path::Path;
use std::sync::atomic::AtomicBool;

pub(super) const EXHIBITS: [Exhibit; 1] = [Exhibit::beyond(
    "tuning",
    "published tunings of fractional controllers: printed, ours, achieved",
    exhibit,
)];

impl From<TuneError> for ReproduceError {
    fn from(error: TuneError) -> Self {
        match error {
            TuneError::Stopped => Self::Stopped,
            other => Self::Run { reason: other.to_string() },
        }
    }
}

fn problem(text: &str) -> Result<TuningProblem, ReproduceError> {
    let document = Document::new("tuning.toml", Path::new(""), text);
    Ok(TuningProblem::from_document(document)?)
}

fn law([proportional, integral, derivative]: [f64; 3], lambda: f64, mu: f64) -> Law {
    Law {
        gains: PidGains::Parallel { proportional, integral, derivative },
        lambda,
        mu,
        filter: DerivativeFilter::None,
        setpoint_weights: [1.0, 0.0],
    }
}

/// The five specifications of [Monje08] on the plant of a liquid level, with samples so short that the loop
/// is that in continuous time.
const MONJE: &str = "
[plant]
gain = 3.13
time_constant = 433.33
dead_time = 50.0
[controller]
sample = 1e-6
ORDERS
[specification]
crossover = 0.008
phase_margin = 60
flat_phase = true
sensitivity = [{ at = 0.001, below = -20 }]
complementary = [{ at = 10, below = -20 }]
";

/// Crossover and phase margin of a loop, and its Ms.
fn achieved(margins: &Margins) -> [f64; 3] {
    let crossover = margins.gain_crossovers.last().copied().unwrap_or(f64::NAN);
    [crossover, margins.phase_margin.unwrap_or(f64::NAN), margins.ms]
}

struct Rows(Vec<[Cell; 5]>);

impl Rows {
    fn add(
        &mut self,
        source: &str,
        quantity: &str,
        printed: Option<f64>,
        ours: f64,
        by_printed: Option<f64>,
    ) {
        self.0.push([source.into(), quantity.into(), printed.into(), ours.into(), by_printed.into()]);
    }
}

fn exhibit(stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    let mut rows = Rows(Vec::new());
    let mut findings = monje(&mut rows, stop)?;
    findings = flat_phase(&mut rows, findings, stop)?;
    findings = podlubny(&mut rows, findings)?;
    findings = padula_visioli(&mut rows, findings, stop)?;
    let text = |name: &str| Column::new(name, Format::Exact);
    let columns = vec![
        text("tuning"),
        text("quantity"),
        text("printed"),
        text("ours"),
        text("achieved by the printed parameters"),
    ];
    let mut table = Table::new("", "Every number", columns);
    for row in rows.0 {
        table = table.with_row(row);
    }
    table.shown = false;
    Ok(findings.with_table(table).with_remark(
        "All loops are in continuous time with an exact dead time; their stability was verified by the argument principle. The rules of [PV11] are \
         their 36 constants in `rule = \"padula-visioli\"`; the Ms that they lead to is compared with the range that an independent \
         evaluation found over the same dead times.",
    ))
}

fn monje(rows: &mut Rows, stop: &AtomicBool) -> Result<Findings, ReproduceError> {
    const PRINTED: [f64; 5] = [0.6152, 0.0100, 0.8968, 4.3867, 0.4773];
    const NAMES: [&str; 5] = ["K_p", "K_i", "λ", "K_d", "μ"];
    let five = |law: &Law| {
        let [kp, ki, kd] = law.three();
        [kp, ki, law.lambda, kd, law.mu]
    };
    let fixed = problem(&MONJE.replace("ORDERS", "lambda = 0.8968\nmu = 0.4773"))?;
    let with_orders = find(&fixed, stop)?;
    let free = problem(&MONJE.replace("ORDERS", ""))?;
    let best = find(&free, stop)?;
    let printed = law([PRINTED[0], PRINTED[1], PRINTED[3]], PRINTED[2], PRINTED[4]);
    let mut findings = Findings::default();
    for ((name, printed), (ours, free)) in
        NAMES.iter().zip(PRINTED).zip(five(&with_orders).into_iter().zip(five(&best)))
    {
        rows.add("[Monje08], its orders given", name, Some(printed), ours, None);
        rows.add("[Monje08], orders free", name, Some(printed), free, None);
    }
    let [by_printed, by_orders, by_best] = [
        achieved(&margins_of(&free, &printed)?),
        achieved(&margins_of(&free, &with_orders)?),
        achieved(&margins_of(&free, &best)?),
    ];
    for (index, quantity) in ["ω_c", "phase margin", "Ms"].iter().enumerate() {
        let printed = [Some(0.008), Some(60.08), None][index];
        rows.add("[Monje08], its orders given", quantity, printed, by_orders[index], Some(by_printed[index]));
        rows.add("[Monje08], orders free", quantity, printed, by_best[index], Some(by_printed[index]));
    }
    let said = |law: &Law| {
        let [kp, ki, lambda, kd, mu] = five(law);
        format!("{kp:.4}, {ki:.5}, {lambda:.4}, {kd:.4}, {mu:.4}")
    };
    findings = findings
        .agrees(
            "[Monje08] five specifications, its orders given: K_p, K_i, λ, K_d, μ",
            "0.6152, 0.0100, 0.8968, 4.3867, 0.4773",
            said(&with_orders),
        )
        .differs(
            "the same, orders free",
            "0.6152, 0.0100, 0.8968, 4.3867, 0.4773",
            said(&best),
            format!(
                "two of five parameters are left free; ours are those of the smallest Ms, {:.3} instead of {:.3}, with the phase \
                 margin {:.2}° instead of {:.2}°",
                by_best[2], by_printed[2], by_best[1], by_printed[1]
            ),
        );
    Ok(findings)
}

fn flat_phase(
    rows: &mut Rows,
    mut findings: Findings,
    stop: &AtomicBool,
) -> Result<Findings, ReproduceError> {
    let printed = [
        ("1.0263/(s*(0.71*s + 1))", 2.51, 83.9, [2.69908, 0.619_222, 0.969_410]),
        ("1.102/(s*(0.17936*s + 1))", 9.9298, 83.8783, [9.94805, 0.163_063, 0.969_344]),
    ];
    for (plant, crossover, margin, printed) in printed {
        let problem = problem(&format!(
            "plant = {{ transfer = \"{plant}\" }}\ncontroller = {{ structure = \"pd\", sample = 1e-8 }}\n\
             specification = {{ crossover = {crossover}, phase_margin = {margin}, flat_phase = true }}\n"
        ))?;
        let law = find(&problem, stop)?;
        let [kp, _, kd] = law.three();
        let ours = [kp, kd / kp, law.mu];
        for ((name, printed), ours) in ["K_p", "K_d/K_p", "μ"].iter().zip(printed).zip(ours) {
            rows.add(&format!("flat phase, {plant}"), name, Some(printed), ours, None);
        }
        let show = |[kp, ratio, mu]: [f64; 3]| format!("{kp:.5}, {ratio:.6}, {mu:.6}");
        findings = findings.agrees(
            format!("flat-phase PD^μ for {plant}: K_p, K_d/K_p, μ"),
            show(printed),
            show(ours),
        );
    }
    Ok(findings)
}

fn podlubny(rows: &mut Rows, mut findings: Findings) -> Result<Findings, ReproduceError> {
    let problem = problem(
        "plant = { transfer = \"1/(0.8*s^2.2 + 0.5*s^0.9 + 1)\" }\ncontroller = { structure = \"pd\", sample = 1e-3 }\n\
         specification = { crossover = 5, phase_margin = 40 }\n",
    )?;
    for (kd, mu, crossover, margin) in [(2.7343, 1.0, 4.895, 18.77), (3.7343, 1.15, 5.213, 44.17)] {
        let margins = margins_of(&problem, &law([20.5, 0.0, kd], 1.0, mu))?;
        let [found_crossover, found_margin, _] = achieved(&margins);
        let name = format!("[Podlubny99], 20.5 + {kd} s^{mu}");
        rows.add(&name, "ω_c", Some(crossover), found_crossover, Some(found_crossover));
        rows.add(&name, "phase margin", Some(margin), found_margin, Some(found_margin));
        findings = findings.agrees(
            format!("{name}: phase margin at ω_c"),
            format!("{margin}° at {crossover}"),
            format!("{found_margin:.2}° at {found_crossover:.3}"),
        );
    }
    Ok(findings)
}

fn padula_visioli(
    rows: &mut Rows,
    mut findings: Findings,
    stop: &AtomicBool,
) -> Result<Findings, ReproduceError> {
    let known = [
        ("setpoint", 1.4, "1.40 … 1.43"),
        ("load", 1.4, "1.44 … 1.50"),
        ("setpoint", 2.0, "1.93 … 2.34"),
        ("load", 2.0, "1.98 … 2.63"),
    ];
    for (purpose, ms, range) in known {
        let mut found = Vec::new();
        for tenths in 1..=7 {
            let share = f64::from(tenths) / 10.0;
            let problem = problem(&format!(
                "plant = {{ time_constant = 1.0, dead_time = {:?} }}\ncontroller = {{ sample = 1e-3 }}\n\
                 specification = {{ rule = \"padula-visioli\", ms = {ms:?}, purpose = \"{purpose}\" }}\n",
                share / (1.0 - share)
            ))?;
            let law = find(&problem, stop)?;
            let margins = margins_of(&problem, &law)?;
            let quantity = format!("Ms at L/(L + T) = {share}");
            rows.add(
                &format!("[PV11], {purpose}, Ms {ms:.1}"),
                &quantity,
                Some(ms),
                margins.ms,
                Some(margins.ms),
            );
            found.push(margins.ms);
        }
        let least = found.iter().copied().fold(f64::INFINITY, min_or_nan);
        let most = found.iter().copied().fold(0.0, max_or_nan);
        findings = findings.differs(
            format!("[PV11] rules for {purpose} steps: Ms over L/(L + T) = 0.1 … 0.7"),
            format!("{ms:.1}; as evaluated {range}"),
            format!("{least:.2} … {most:.2}"),
            "the rules are fits to optima under this Ms",
        );
    }
    Ok(findings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_tunings_are_met() {
        let findings = exhibit(&AtomicBool::new(false)).unwrap();
        let mut compared = [0; 4];
        for row in &findings.tables[0].rows {
            let [Cell::Text(source), Cell::Text(quantity), printed, Cell::Number(ours), _] = &row[..] else {
                panic!("{row:?}");
            };
            let Cell::Number(printed) = printed else { continue };
            let off = ours / printed - 1.0;
            let fail = || panic!("{source}, {quantity}: {ours} instead of {printed}");
            if source.ends_with("its orders given") {
                // Deviations up to one per cent are accepted.
                if off.abs() > 0.01 {
                    fail();
                }
                compared[0] += 1;
            } else if source.starts_with("flat phase") {
                if off.abs() > 5e-6 {
                    fail();
                }
                compared[1] += 1;
            } else if source.starts_with("[Podlubny99]") {
                if (ours - printed).abs() > 0.006 {
                    fail();
                }
                compared[2] += 1;
            } else if source.starts_with("[PV11]") {
                let range = match (source.contains("load"), source.ends_with("1.4")) {
                    (false, true) => 1.40..1.436,
                    (true, true) => 1.435..1.505,
                    (false, false) => 1.93..2.345,
                    (true, false) => 1.98..2.635,
                };
                if !range.contains(ours) {
                    fail();
                }
                compared[3] += 1;
            }
        }
        assert_eq!(compared, [7, 6, 4, 28]);
        // Better than printed: the exact margin, and a smaller Ms.
        let best = |quantity: &str| {
            let row = findings.tables[0].rows.iter().find(|row| {
                matches!(&row[..2], [Cell::Text(source), Cell::Text(found)]
                    if source == "[Monje08], orders free" && found == quantity)
            });
            match &row.unwrap()[3..] {
                [Cell::Number(ours), Cell::Number(printed)] => (*ours, *printed),
                other => panic!("{other:?}"),
            }
        };
        assert!((best("phase margin").0 - 60.0).abs() < 1e-6 && (best("ω_c").0 - 0.008).abs() < 1e-9);
        assert!(best("Ms").0 < best("Ms").1 - 0.05);
    }
}
