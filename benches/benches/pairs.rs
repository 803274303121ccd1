//! What a factor in pairs of rows, that of two unknown nodes at each coordinate, costs beside one of single
//! rows: a table for book/src/use/large.md.
//!
//! `cargo bench -p fvi-benches --bench pairs`

use fvi_core::min_or_nan;
use fvi_sparse::{Analysis, FactorError, Pattern};
use std::time::Instant;

/// Points of a box, each with its neighbours along the axes.
fn grid(sides: [usize; 3]) -> Pattern {
    let [x, y, z] = sides;
    let near = move |own: usize| {
        let place = [own % x, own / x % y, own / (x * y)];
        let steps = [1, x, x * y];
        let below = [2, 1, 0].map(|axis| (place[axis] > 0).then(|| own - steps[axis]));
        let above = [0, 1, 2].map(|axis| (place[axis] + 1 < sides[axis]).then(|| own + steps[axis]));
        below.into_iter().chain([Some(own)]).chain(above).flatten()
    };
    Pattern::from_rows((0..x * y * z).map(near))
}

/// The shortest time of some.
fn seconds<R>(mut measured: impl FnMut() -> R) -> f64 {
    let once = |_| {
        let start = Instant::now();
        std::hint::black_box(measured());
        start.elapsed().as_secs_f64()
    };
    (0..7).map(once).fold(f64::INFINITY, min_or_nan)
}

fn main() -> Result<(), FactorError> {
    println!("| matrix | rows | MB, order 2 | MB, pairs | factor, s | pairs | solution, s | pairs |");
    println!("|---|---|---|---|---|---|---|---|");
    for (name, sides) in [("membrane", [316, 316, 1]), ("beam", [200, 14, 14]), ("cube", [30, 30, 30])] {
        let pattern = grid(sides);
        let rows = pattern.rows().enumerate();
        let places = rows.flat_map(|(row, slots)| slots.map(move |slot| (row, slot)));
        // Springs and a mass: those of order 2, and what two Gauss points make of them.
        let springs: Vec<(f64, f64)> = places
            .map(|(row, slot)| if pattern.columns()[slot] as usize == row { (6.0, 0.1) } else { (-1.0, 0.0) })
            .collect();
        let single: Vec<f64> = springs.iter().map(|(k, m)| k + 4.0 * m).collect();
        let coupling = 6.0 * 3.0_f64.sqrt();
        let pairs: Vec<f64> = springs
            .iter()
            .flat_map(|(k, m)| [k + 6.0 * m, coupling * m, coupling * m, -k - 6.0 * m])
            .collect();
        let one = Analysis::new(&pattern);
        let analyses = [(one.clone(), &single), (one.of_pairs(), &pairs)];
        let mut cells = [Vec::new(), Vec::new(), Vec::new()];
        for (analysis, values) in analyses {
            let factor = analysis.factor(&pattern, values)?;
            let vector = vec![1.0; factor.size()];
            cells[0].push(format!("{:.0}", factor.bytes() as f64 / f64::from(1 << 20)));
            cells[1].push(format!("{:.3}", seconds(|| analysis.factor(&pattern, values))));
            cells[2].push(format!("{:.4}", seconds(|| factor.solve(&mut vector.clone()))));
        }
        println!("| {name} | {} | {} |", pattern.size(), cells.concat().join(" | "));
    }
    Ok(())
}
