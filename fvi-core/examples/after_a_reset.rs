//! A half derivative that outlives a reset: its state is written to bytes and read again, to the bit.

use fvi_core::{
    BdfOrder, FractionalOperator, Kernel, Start, StateReader, StateWriter, Stateful, monic_bdf_table,
};

const SAMPLES: usize = 256;
static WEIGHTS: [f64; SAMPLES] = monic_bdf_table(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 0.01)?;
    let fresh = || -> Result<_, Box<dyn std::error::Error>> {
        Ok(FractionalOperator::new(kernel.full_memory::<f64, 1, SAMPLES>(&WEIGHTS)?, Start::Caputo)?)
    };
    let mut operator = fresh()?;
    for k in 0..100 {
        operator.push(f64::from(k) * 0.01)?;
    }
    let mut bytes = vec![0; operator.state_bytes()];
    let mut writer = StateWriter::new(&mut bytes);
    operator.save(&mut writer)?;

    // After the reset.
    let mut restored = fresh()?;
    restored.restore(&mut StateReader::new(&bytes))?;
    let (one, other) = (operator.push(1.0)?, restored.push(1.0)?);
    println!("{one:.12} {other:.12}");
    if one.to_bits() == other.to_bits() { Ok(()) } else { Err("the bits differ".into()) }
}
