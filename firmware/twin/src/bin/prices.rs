//! Prints what steps and controllers cost, for book/src/use/firmware.md: `prices COSTS`, with the file that
//! `.ci/firmware` measures.

use std::collections::HashMap;
use std::error::Error;
use std::fs;

/// Rows of the file by their names.
struct Costs(HashMap<String, Vec<f64>>);

impl Costs {
    fn read(text: &str) -> Result<Self, Box<dyn Error>> {
        let mut rows = HashMap::new();
        for line in text.lines().filter(|line| !line.starts_with('#') && !line.starts_with("name,")) {
            let mut cells = line.split(',');
            let name = cells.next().unwrap_or_default().to_owned();
            rows.insert(name, cells.map(str::parse).collect::<Result<_, _>>()?);
        }
        Ok(Self(rows))
    }

    fn row(&self, name: &str) -> Result<&[f64], Box<dyn Error>> {
        self.0.get(name).map(Vec::as_slice).ok_or_else(|| format!("no cost of {name}").into())
    }

    /// Instructions on average.
    fn mean(&self, name: &str) -> Result<f64, Box<dyn Error>> {
        Ok(self.row(name)?[0])
    }

    /// Instructions on average and at worst, or flash and RAM.
    fn both(&self, name: &str) -> Result<[f64; 2], Box<dyn Error>> {
        let row = self.row(name)?;
        Ok([row[0], row[1]])
    }

    /// Flash in KiB.
    fn flash(&self, name: &str) -> Result<f64, Box<dyn Error>> {
        Ok(self.mean(name)? / 1024.0)
    }
}

const PROCESSORS: [(&str, &str); 3] =
    [("Cortex-M4F", ""), ("Cortex-M0+", "Cortex-M0+: "), ("RV32IMC", "RV32IMC: ")];

/// What is counted of every processor, and its row.
const COUNTED: [(&str, &str); 8] = [
    ("operator on an exponential sum, a sample", "operator: exponential sum x 1"),
    ("stepper of one coordinate with an exponential sum, a step", "stepper: exponential sum x 1"),
    ("controller of orders 1, a tick", "generated controller: orders 1 with a fixed law"),
    ("fractional controller for 10⁸ ticks, a tick", "generated controller: 10^8 ticks with a fixed law"),
    ("endless fractional controller, a tick", "generated controller: endless with a fixed law"),
    ("its set-up", "set-up of a generated controller: endless with a fixed law"),
    (
        "fractional controller within 1 % over five decades, a tick",
        "generated controller: 1 % over five decades",
    ),
    ("the same in whole numbers, a tick", "generated controller: 1 % over five decades in whole numbers"),
];

const STORED: [(&str, &str); 4] = [
    ("controller of orders 1, flash", "flash of a generated controller: orders 1 with a fixed law"),
    ("endless fractional controller, flash", "flash of a generated controller: endless with a fixed law"),
    (
        "fractional controller within 1 % over five decades in whole numbers, flash",
        "flash of a generated controller: 1 % over five decades in whole numbers",
    ),
    (
        "endless fractional controller with limits, gains and modes that change, saving, flash",
        "flash of a generated controller: endless with all that changes",
    ),
];

fn main() -> Result<(), Box<dyn Error>> {
    let Some(file) = std::env::args().nth(1) else { return Err("usage: prices COSTS".into()) };
    let costs = Costs::read(&fs::read_to_string(file)?)?;
    println!("| instructions, and bytes of flash | {} |", PROCESSORS.map(|(name, _)| name).join(" | "));
    println!("|---|---:|---:|---:|");
    for (what, row) in COUNTED.into_iter().chain(STORED) {
        let mut cells = Vec::new();
        for (_, processor) in PROCESSORS {
            cells.push(format!("{:.0}", costs.mean(&format!("{processor}{row}"))?));
        }
        println!("| {what} | {} |", cells.join(" | "));
    }
    let history = costs.mean("direct 1024 x 1: term")? / 1024.0;
    let [small, large] = [costs.mean("tiled 256 x 1: push")?, costs.mean("tiled 1024 x 1: push")?];
    let [tiled, tiled_worst] = costs.both("tiled 1024 x 1")?;
    let [direct, direct_worst] = costs.both("direct 1024 x 1")?;
    let [sum, _] = costs.both("exponential sum x 1")?;
    let [endless, endless_worst] = costs.both("endless exponential sum x 1")?;
    println!(
        "
* **History sum** on the Cortex-M4F, 1024 samples in two slices of a ring: {history:.1} instructions per product with
  everything around it.
* **Far history**, eight outputs at a time: {:.2} per further product; {:.2} with all that surrounds it at 1024 samples.
  A whole step with 1024 samples: {tiled:.0} on average, {tiled_worst:.0} at worst, where the direct memory needs {direct:.0} and
  {direct_worst:.0}.
* **Exponential sum**: {sum:.0}, mean and worst alike; {endless:.0} and {endless_worst:.0} without an end.
* **Stepper** (low-order scheme, linear spring, one correction with the factors it keeps): {:.0} without damping, {:.0} with
  an exponential sum; with two coordinates {:.0} and {:.0}.
* **Flash** from C: {:.0} KiB for the operators, {:.0} KiB for a stepper of one coordinate, {:.0} KiB for six.",
        (large - small) / 768.0,
        large / 1024.0,
        costs.mean("stepper: no damping x 1")?,
        costs.mean("stepper: exponential sum x 1")?,
        costs.mean("stepper: no damping x 2")?,
        costs.mean("stepper: exponential sum x 2")?,
        costs.flash("C operator")?,
        costs.flash("C stepper x 1")?,
        costs.flash("C stepper x 6")?,
    );
    Ok(())
}
