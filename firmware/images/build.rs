//! Puts the memory map of the processor's board where the linker looks for it.
use std::error::Error;
use std::path::Path;
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    let processor = env::var("CARGO_CFG_TARGET_ARCH")?;
    let map = Path::new("memory").join(format!("{processor}.x"));
    println!("cargo::rerun-if-changed={}", map.display());
    let out = env::var("OUT_DIR")?;
    fs::copy(&map, Path::new(&out).join("memory.x"))?;
    println!("cargo::rustc-link-search={out}");
    Ok(())
}
