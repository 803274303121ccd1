//! The texts that mutations begin with: the files of the repository, and some that once did harm.

use std::path::Path;

/// The files of a directory, relative to the package's, whose names end in `ending`.
pub(crate) fn files(directory: &str, ending: &str) -> Vec<String> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join(directory);
    let mut paths: Vec<_> =
        std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == ending));
    paths.sort();
    paths.iter().map(|path| std::fs::read_to_string(path).unwrap()).collect()
}

/// The lines of a file of the corpus.
pub(crate) fn lines(name: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hostile/corpus").join(name);
    std::fs::read_to_string(path).unwrap().lines().map(str::to_owned).collect()
}
