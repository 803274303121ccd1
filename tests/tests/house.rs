//! The house has one way up: imports run from higher layers to lower ones, and no two files need each other.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates of the host with their layers, lowest first; those in one row do not know each other.
const HOST: [(&str, &[&[&str]]); 5] = [
    (
        "fvi-fft",
        &[
            &["aligned", "dense", "engines", "growing_ring"],
            &["baseline"],
            &["transfer"],
            &["quadrature"],
            &["exponentials"],
            &["memory"],
            &["lib"],
        ],
    ),
    ("fvi-scenario", &[&["language"], &["scenario"], &["lib"]]),
    ("fvi-simulation", &[&["column"], &["model"], &["simulation"], &["lib"]]),
    ("fvi-lab", &[&["results"], &["lab"], &["lib"]]),
    ("fvi-host", &[&["reproduce"], &["command"], &["main", "lib"]]),
];

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Every source file below a folder, by its path without the ending, with its text up to its unit tests.
fn sources(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") && !name.ends_with("tests") {
                let text = fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]\nmod").next().unwrap().to_owned();
                let code = code.lines().filter(|line| !line.trim_start().starts_with("//"));
                let key = path.strip_prefix(folder).unwrap().with_extension("");
                found.insert(key, code.collect::<Vec<_>>().join("\n"));
            }
        }
    }
    assert!(!found.is_empty(), "{}", folder.display());
    found
}

/// The names that follow each occurrence of `prefix`, such as `a` in `crate::a::b`.
fn names_after(text: &str, prefix: &str) -> BTreeSet<String> {
    let name = |rest: &str| -> String {
        rest.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').collect()
    };
    text.split(prefix).skip(1).map(name).collect()
}

#[test]
fn layers_of_the_host_use_lower_layers_only() {
    let mut arrows = 0;
    for (name, layers) in HOST {
        let layer = |module: &str| {
            let found = layers.iter().position(|layer| layer.contains(&module));
            found.unwrap_or_else(|| panic!("the module `{module}` of {name} has no layer in this test"))
        };
        let files = sources(&workspace().join(name).join("src"));
        let first = |path: &Path| path.iter().next().unwrap().to_string_lossy().into_owned();
        let modules: BTreeSet<String> = files.keys().map(|path| first(path)).collect();
        for (path, text) in &files {
            let own = first(path);
            // What is no module is an item that the crate has at its root.
            for other in names_after(text, "crate::").into_iter().filter(|other| modules.contains(other)) {
                assert!(
                    other == own || layer(&other) < layer(&own),
                    "{} of {name} uses `{other}`, which is not below `{own}`",
                    path.display()
                );
                arrows += 1;
            }
        }
    }
    assert!(arrows > 100, "only {arrows} imports seen: does this test still read them?");
}

/// The paths that follow each occurrence of `prefix`, such as `a/b/c` in `crate::a::b::c`.
fn paths_after(text: &str, prefix: &str) -> BTreeSet<PathBuf> {
    let path = |rest: &str| -> PathBuf {
        let letters = |letter: &char| letter.is_alphanumeric() || matches!(letter, '_' | ':');
        rest.chars().take_while(letters).collect::<String>().split("::").collect()
    };
    text.split(prefix).skip(1).map(path).collect()
}

/// The files that each file names by `crate::` or `super::`. A file that only gathers the modules below it
/// may be named by them.
fn arrows(files: &BTreeMap<PathBuf, String>) -> BTreeMap<&Path, Vec<&Path>> {
    let named = |path: &Path, text: &str| {
        let siblings = paths_after(text, "super::").into_iter().map(|name| path.with_file_name(name));
        siblings.chain(paths_after(text, "crate::")).collect::<BTreeSet<_>>()
    };
    // The longest part of a path that is a file: what follows are items in it.
    let file =
        |other: &Path| other.ancestors().find_map(|part| files.get_key_value(part)).map(|(key, _)| key);
    let known = |path: &Path, others: BTreeSet<PathBuf>| {
        others
            .iter()
            .filter_map(|other| file(other))
            .map(PathBuf::as_path)
            .filter(|other| *other != path)
            .collect()
    };
    files.iter().map(|(path, text)| (path.as_path(), known(path, named(path, text)))).collect()
}

/// A file that leads back to itself, if there is one.
fn circle<'a>(arrows: &BTreeMap<&'a Path, Vec<&'a Path>>) -> Option<&'a Path> {
    arrows.keys().copied().find(|&start| {
        let (mut seen, mut next) = (BTreeSet::new(), arrows[start].clone());
        while let Some(path) = next.pop() {
            if path == start {
                return true;
            }
            if seen.insert(path) {
                next.extend(&arrows[path]);
            }
        }
        false
    })
}

#[test]
fn no_two_files_need_each_other() {
    let others = ["fvi-core", "fvi-threads", "fvi-sparse", "fvi-rivals", "fvi-strategies"];
    for name in others.into_iter().chain(HOST.map(|(name, _)| name)) {
        let files = sources(&workspace().join(name).join("src"));
        let arrows = arrows(&files);
        assert_eq!(circle(&arrows), None, "in {name}");
    }
}

#[test]
fn a_circle_would_be_seen() {
    let files = [("a", "use crate::b::B;"), ("b", "use super::c::C;"), ("c", "use crate::a::A;")];
    let mut files: BTreeMap<_, _> = files.map(|(path, text)| (PathBuf::from(path), text.to_owned())).into();
    assert_eq!(circle(&arrows(&files)), Some(Path::new("a")));
    files.insert("c".into(), "use crate::d::A;".to_owned());
    assert_eq!(circle(&arrows(&files)), None);
}

#[test]
fn the_core_names_neither_std_nor_the_rooms_above_it() {
    let core = workspace().join("fvi-core/src");
    let for_tests = names_after(&fs::read_to_string(core.join("lib.rs")).unwrap(), "#[cfg(test)]\nmod ");
    let mut core = sources(&core);
    core.retain(|path, _| !for_tests.iter().any(|name| path == Path::new(name)));
    for (path, text) in core {
        for word in ["std::", "alloc::", "fvi_fft", "fvi_host"] {
            assert!(!text.contains(word), "{} names {word}", path.display());
        }
    }
    for (path, text) in sources(&workspace().join("fvi-fft/src")) {
        assert!(!text.contains("fvi_host"), "{} names fvi_host", path.display());
    }
}

/// What a manifest depends on, those dependencies aside that only a feature brings.
fn dependencies(crate_: &str) -> Vec<String> {
    let manifest = fs::read_to_string(workspace().join(crate_).join("Cargo.toml")).unwrap();
    let after = manifest.split("\n[dependencies]\n").nth(1).unwrap_or_default();
    let lines = after.lines().take_while(|line| !line.starts_with('['));
    let wanted = lines.filter(|line| line.starts_with("fvi-") && !line.contains("optional = true"));
    wanted.map(|line| line.split(['.', ' ']).next().unwrap().to_owned()).collect()
}

#[test]
fn what_users_link_knows_no_rivals() {
    for folder in ["fvi-core", "fvi-fft", "fvi-scenario", "fvi-simulation", "fvi-lab", "fvi-host"] {
        let wanted = dependencies(folder);
        for lab in ["fvi-rivals", "fvi-strategies"] {
            assert!(!wanted.contains(&lab.to_owned()), "{folder} depends on {wanted:?}");
        }
        assert!(folder == "fvi-core" || wanted.contains(&"fvi-core".to_owned()), "{folder}: {wanted:?}");
    }
}

/// The names behind `mod` in a file.
fn modules(path: &Path) -> BTreeSet<String> {
    names_after(&fs::read_to_string(path).unwrap(), "\nmod ")
}

#[test]
fn every_file_of_tests_is_part_of_a_program() {
    let files = |folder: &str| -> BTreeSet<String> {
        let names = fs::read_dir(workspace().join(folder)).unwrap().map(|entry| entry.unwrap().path());
        let rust = names.filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
        rust.map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect()
    };
    let roots = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    let folders = [
        ("tests/tests", "across", roots(&["across", "allocations"])),
        ("fvi-host/tests/program", "main", roots(&["main"])),
        ("fvi-host/tests/hostile", "main", roots(&["main"])),
    ];
    for (folder, main, roots) in folders {
        let declared = modules(&workspace().join(folder).join(main).with_extension("rs"));
        let found: BTreeSet<String> = files(folder).difference(&roots).cloned().collect();
        assert_eq!(found, declared, "{folder}/{main}.rs does not name the files beside it");
    }
}

#[test]
fn every_page_of_the_summary_is_a_file_of_the_repository() {
    let book = workspace().join("book/src");
    let summary = fs::read_to_string(book.join("SUMMARY.md")).unwrap();
    let pages: Vec<&str> = summary.split("](").skip(1).map(|rest| rest.split(')').next().unwrap()).collect();
    assert!(pages.len() > 30, "only {} pages seen: does this test still read them?", pages.len());
    for page in pages {
        assert!(book.join(page).is_file(), "SUMMARY.md names {page}");
    }
}

#[test]
fn comments_are_no_wider_than_the_code() {
    const WIDTH: usize = 110;
    let folders = fs::read_dir(workspace()).unwrap().map(|entry| entry.unwrap().file_name());
    let crates = folders.filter(|name| name.to_string_lossy().starts_with("fvi-"));
    let folders = crates.chain(["benches", "tests", "firmware", "bindings"].map(Into::into));
    let mut folders: Vec<PathBuf> = folders.map(|folder| workspace().join(folder)).collect();
    let mut comments = 0;
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                let mut formula = false;
                for (line, number) in
                    text.lines().zip(1..).filter(|(line, _)| line.trim_start().starts_with("//"))
                {
                    formula ^= line.contains("```");
                    // A formula or a table is not broken.
                    let fits = formula || line.chars().count() <= WIDTH;
                    assert!(fits, "{}:{number} has more than {WIDTH} columns", path.display());
                    comments += 1;
                }
            }
        }
    }
    assert!(comments > 5000, "only {comments} lines of comments seen: does this test still read them?");
}

#[test]
fn every_crate_that_is_published_carries_its_licences_and_says_where_its_documentation_is() {
    let (mut crates, root) = (0, workspace());
    for entry in fs::read_dir(&root).unwrap() {
        let folder = entry.unwrap().path();
        let name = folder.file_name().unwrap().to_string_lossy().into_owned();
        if !name.starts_with("fvi-") {
            continue;
        }
        let manifest = fs::read_to_string(folder.join("Cargo.toml")).unwrap();
        let documentation = format!("documentation = \"https://docs.rs/{name}\"");
        for line in [&*documentation, "license.workspace = true", "readme = \"README.md\""] {
            assert!(manifest.lines().any(|found| found == line), "{name}: {line}");
        }
        for licence in ["LICENSE-APACHE", "LICENSE-MIT"] {
            let text = |folder: &Path| fs::read_to_string(folder.join(licence)).unwrap_or_default();
            assert!(text(&folder) == text(&root) && !text(&root).is_empty(), "{name}: {licence}");
        }
        crates += 1;
    }
    assert!(crates >= 9, "{crates}");
}
