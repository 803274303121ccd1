//! Prints the header of the C interface, made from its source.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let config = cbindgen::Config::from_file(library.join("cbindgen.toml"))?;
    let sources = ["status", "memory", "operator", "weights", "stepper", "saving", "pid"];
    let mut builder = cbindgen::Builder::new().with_config(config);
    for source in sources {
        builder = builder.with_src(library.join("src").join(source).with_extension("rs"));
    }
    builder.generate()?.write(std::io::stdout());
    Ok(())
}
