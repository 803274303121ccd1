//! Prints a header of the C interface, made from its source: that of fvi-core, or with the argument `streams`
//! that of streams.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (library, sources): (_, &[&str]) = match std::env::args().nth(1).as_deref() {
        None => {
            (library, &["status", "memory", "operator", "weights", "stepper", "saving", "pid", "fixed_pid"])
        }
        Some("streams") => (library.join("streams"), &["status", "stream", "single", "double"]),
        Some(other) => return Err(format!("there is no header {other}: streams, or no argument").into()),
    };
    let config = cbindgen::Config::from_file(library.join("cbindgen.toml"))?;
    let mut builder = cbindgen::Builder::new().with_config(config);
    for source in sources {
        builder = builder.with_src(library.join("src").join(source).with_extension("rs"));
    }
    builder.generate()?.write(std::io::stdout());
    Ok(())
}
