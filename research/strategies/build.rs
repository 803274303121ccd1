//! Notes the compiler, for what is said beside measured times.

use std::process::Command;

fn main() {
    let compiler = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = Command::new(compiler).arg("--version").output();
    let version = version.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
    let optimised = std::env::var("OPT_LEVEL").unwrap_or_default();
    println!("cargo::rustc-env=COMPILER={}", version.unwrap_or_else(|_| "unknown compiler".to_owned()));
    println!("cargo::rustc-env=OPTIMISATION={optimised}");
    println!("cargo::rerun-if-changed=build.rs");
}
