//! The house has one way up: imports run from higher layers to lower ones, and no two files need each other.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The crates of the host with their layers, lowest first; those in one row do not know each other.
const HOST: [(&str, &[&[&str]]); 6] = [
    (
        "fvi-fft",
        &[
            &["aligned", "dense", "sums"],
            &["engines", "growing_ring", "rational"],
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
    (
        "fvi-host",
        &[
            &["results"],
            &["output_sink"],
            &["checkpoint"],
            &["gradient"],
            &["run"],
            &["batch", "converge", "response", "sweep"],
            &["fit", "tune"],
            &["prelude"],
            &["lib"],
        ],
    ),
    ("fvi", &[&["command"], &["main"]]),
    ("research/exhibits", &[&["two_point", "reproduce"], &["lib"]]),
];

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Every source file below a folder, by its path without the ending, with its text up to its unit tests.
fn sources(folder: &Path) -> BTreeMap<PathBuf, String> {
    let files = all_sources(folder).into_iter();
    let files = files.filter(|(path, _)| !path.to_string_lossy().ends_with("tests"));
    let code = |text: String| {
        let code = text.split("#[cfg(test)]\nmod").next().unwrap();
        let code = code.lines().filter(|line| !line.trim_start().starts_with("//"));
        code.collect::<Vec<_>>().join("\n")
    };
    files.map(|(path, text)| (path, code(text))).collect()
}

/// Every source file below a folder, by its path without the ending, with its text.
fn all_sources(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                // Programs with lock files of their own keep what they build beside them.
                folders.extend((path.file_name().unwrap() != "target").then_some(path));
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                let key = path.strip_prefix(folder).unwrap().with_extension("");
                found.insert(key, fs::read_to_string(&path).unwrap());
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
    let others = ["fvi-core", "fvi-threads", "fvi-sparse", "research/rivals", "research/strategies"];
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
fn what_users_link_knows_nothing_of_the_research_wing() {
    for folder in ["fvi-core", "fvi-fft", "fvi-scenario", "fvi-simulation", "fvi-host", "fvi"] {
        let wanted = dependencies(folder);
        for research in ["fvi-rivals", "fvi-strategies", "fvi-exhibits"] {
            assert!(!wanted.contains(&research.to_owned()), "{folder} depends on {wanted:?}");
        }
        assert!(folder == "fvi-core" || wanted.contains(&"fvi-core".to_owned()), "{folder}: {wanted:?}");
    }
}

/// A crate or a folder more is a decision, not an accident. Where the source is no checkout, as in an
/// archive, every folder with a manifest counts, since nothing tells the others from a user's own.
#[test]
fn the_house_has_eight_crates_and_fifteen_folders() {
    let files = Command::new("git").arg("ls-files").current_dir(workspace()).output();
    let tracked = files.ok().filter(|listed| listed.status.success());
    let folders: BTreeSet<String> = match tracked {
        Some(listed) => {
            let listed = String::from_utf8(listed.stdout).unwrap();
            listed.lines().filter_map(|file| Some(file.split_once('/')?.0.to_owned())).collect()
        }
        None => {
            let entries = fs::read_dir(workspace()).unwrap().map(|entry| entry.unwrap());
            let known = entries.filter(|entry| entry.path().join("Cargo.toml").is_file());
            known.map(|entry| entry.file_name().into_string().unwrap()).collect()
        }
    };
    let folders: Vec<&String> = folders.iter().filter(|name| !name.starts_with('.')).collect();
    let crates = folders.iter().filter(|name| name.starts_with("fvi")).count();
    assert!(crates >= 7, "{folders:?}: does this test still see them?");
    assert!(crates <= 8 && folders.len() <= 15, "{crates} crates, {} folders: {folders:?}", folders.len());
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
        ("fvi/tests/program", "main", roots(&["main"])),
        ("fvi/tests/hostile", "main", roots(&["main"])),
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
    let folders = [root.clone(), root.join("research")].map(|folder| fs::read_dir(folder).unwrap());
    for folder in folders.into_iter().flatten().map(|entry| entry.unwrap().path()) {
        let Ok(manifest) = fs::read_to_string(folder.join("Cargo.toml")) else { continue };
        let name =
            manifest.split("name = \"").nth(1).and_then(|rest| rest.split('"').next()).unwrap_or_default();
        if !name.starts_with("fvi") || manifest.contains("publish = false") {
            continue;
        }
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
    assert!(crates >= 11, "{crates}");
}

/// What a number that is not there is replaced by.
const FALLBACKS: [&str; 13] = [
    "unwrap_or(0.0)",
    "unwrap_or(T::zero())",
    "unwrap_or(f64::NAN)",
    "unwrap_or_default()",
    "map_or(0.0,",
    "map_or(T::zero(),",
    "map_or(f64::NAN,",
    "_ => f64::NAN",
    "constant(f64::NAN)",
    "unwrap_or_else(|| DMatrix::zeros",
    "unwrap_or_else(|| zero",
    "unwrap_or_else(zero",
    "f64::max)",
];

/// What the types or the construction exclude; a panic would be reachable without.
const SHAPE: &str = "a place that the shapes checked at construction exclude";
/// Coefficients of a polynomial, entries of a sparse matrix, weights of a finite memory.
const BEYOND: &str = "what lies beyond the last entry is zero";
const PADDING: &str = "lanes without a channel compute with zeros that nobody reads";
const NONE: &str = "there is none of what is summed, compared or drawn";
const REFUSED: &str = "not a number where the input was refused before, so that it would show";
const NAMED: &str = "a length that is given with each step, not a number until then";
const TEXT: &str = "letters";

/// Where fallbacks stand, how many, and why each is the value and hides nothing.
const TRUE_VALUES: [(&str, usize, &str); 51] = [
    ("fvi-core/src/damped_motion.rs", 6, SHAPE),
    ("fvi-core/src/exponential_sum.rs", 1, SHAPE),
    ("fvi-core/src/galerkin.rs", 4, BEYOND),
    ("fvi-core/src/kernel.rs", 5, REFUSED),
    ("fvi-core/src/linear.rs", 3, SHAPE),
    ("fvi-core/src/pid.rs", 1, NAMED),
    ("fvi-core/src/pid_law.rs", 2, NAMED),
    ("fvi-core/src/resolvent.rs", 1, SHAPE),
    ("fvi-core/src/saving.rs", 1, SHAPE),
    ("fvi-core/src/space.rs", 6, SHAPE),
    ("fvi-core/src/variable_steps.rs", 2, SHAPE),
    ("fvi-fft/src/engines/complex_exponential_sum.rs", 1, PADDING),
    ("fvi-fft/src/engines/level.rs", 1, BEYOND),
    ("fvi-fft/src/engines/near.rs", 2, BEYOND),
    ("fvi-fft/src/engines/stream/near.rs", 2, BEYOND),
    ("fvi-fft/src/engines/stream/prepared.rs", 1, BEYOND),
    ("fvi-fft/src/engines/wide_exponential_sum.rs", 1, PADDING),
    ("fvi-fft/src/exponentials/controller_source.rs", 1, TEXT),
    ("fvi-fft/src/exponentials/exponential_table.rs", 1, NONE),
    ("fvi-fft/src/exponentials/shorter_rules.rs", 3, NONE),
    ("fvi-fft/src/exponentials/rate_rules.rs", 1, NONE),
    ("fvi-fft/src/quadrature/multistep_weights.rs", 1, NONE),
    ("fvi-fft/src/quadrature/principal_cut.rs", 2, NONE),
    ("fvi-fft/src/quadrature/starting.rs", 2, SHAPE),
    ("fvi-fft/src/transfer/forms/given.rs", 1, REFUSED),
    ("fvi-fft/src/transfer/fractions.rs", 1, BEYOND),
    ("fvi-fft/src/transfer/relaxation.rs", 1, NONE),
    ("fvi-sparse/src/kernels.rs", 1, PADDING),
    ("fvi-sparse/src/product.rs", 2, PADDING),
    ("fvi-sparse/src/solve.rs", 1, PADDING),
    ("fvi-scenario/src/scenario/gyroscopic.rs", 1, BEYOND),
    ("fvi-scenario/src/scenario/symbol.rs", 2, REFUSED),
    ("fvi-scenario/src/scenario/load.rs", 1, NONE),
    ("fvi-scenario/src/scenario/matrix.rs", 1, BEYOND),
    ("fvi-scenario/src/scenario/sampled_input.rs", 1, NONE),
    ("fvi-scenario/src/scenario/sparse_matrix.rs", 2, BEYOND),
    ("fvi-simulation/src/model/band.rs", 1, PADDING),
    ("fvi-simulation/src/model/force_moments.rs", 1, NAMED),
    ("fvi-simulation/src/model/massless.rs", 2, NONE),
    ("fvi-simulation/src/model/mechanics.rs", 3, NONE),
    ("fvi-simulation/src/model/rough_forces.rs", 1, NONE),
    ("fvi-simulation/src/model/tape/program/assembly.rs", 1, NONE),
    ("fvi-simulation/src/model/unbounded_forces.rs", 1, NONE),
    ("fvi-simulation/src/simulation/adaptive.rs", 2, NONE),
    ("fvi-simulation/src/simulation/breaks.rs", 1, NONE),
    ("fvi-simulation/src/simulation/control.rs", 1, NONE),
    ("fvi-simulation/src/simulation/crossings.rs", 1, NONE),
    ("fvi-simulation/src/simulation/energy_guard.rs", 1, NONE),
    ("fvi-simulation/src/simulation/memory_energy.rs", 1, NONE),
    ("fvi-simulation/src/simulation/momentum_offset.rs", 1, REFUSED),
    ("fvi-simulation/src/simulation/step_batch.rs", 3, NONE),
];

#[test]
fn what_is_unknown_is_not_replaced_by_a_number() {
    let mut known: BTreeMap<PathBuf, (usize, &str)> = TRUE_VALUES
        .iter()
        .map(|&(path, count, reason)| (Path::new(path).with_extension(""), (count, reason)))
        .collect();
    for crate_ in ["fvi-core", "fvi-fft", "fvi-sparse", "fvi-scenario", "fvi-simulation"] {
        let source = Path::new(crate_).join("src");
        for (path, text) in sources(&workspace().join(&source)) {
            // Texts of scenarios may be empty.
            let looked_for =
                FALLBACKS.iter().filter(|fallback| crate_ != "fvi-scenario" || !fallback.contains("default"));
            let found: usize = looked_for.map(|fallback| text.matches(fallback).count()).sum();
            let path = source.join(path);
            let (allowed, reason) = known.remove(&path).unwrap_or((0, "what is not known is an error"));
            assert_eq!(found, allowed, "{}: {reason}", path.display());
        }
    }
    assert!(known.is_empty(), "files that do not exist: {known:?}");
}

/// What stands in the parentheses behind each occurrence of `name(`.
fn arguments<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    let until_closed = |rest: &'a str| -> &'a str {
        let mut open = 1;
        let end = rest.find(|letter| {
            open += i32::from(letter == '(') - i32::from(letter == ')');
            open == 0
        });
        &rest[..end.unwrap_or(rest.len())]
    };
    text.split(&format!("{name}(")).skip(1).map(until_closed).collect()
}

/// What leaves out NaN: it returns the other number.
const DROPS: [&str; 6] = ["f64::max", "f32::max", "f64::min", "f32::min", ".max(", ".min("];

#[test]
fn largest_numbers_keep_what_is_no_number() {
    let crates = ["core", "fft", "sparse", "scenario", "simulation"].map(|name| format!("fvi-{name}/src"));
    // Pictures leave out what they cannot draw.
    let others = [
        "tests",
        "benches",
        "fvi-host",
        "fvi",
        "research/exhibits",
        "fvi-simulation/tests",
        "fvi-scenario/tests",
    ];
    let mut folds = 0;
    for folder in crates.iter().map(String::as_str).chain(others) {
        for (path, text) in all_sources(&workspace().join(folder)) {
            if folder == "fvi-host" && path.starts_with("src/results/picture") {
                continue;
            }
            for argument in arguments(&text, ".fold") {
                let drops = DROPS.iter().find(|drops| argument.contains(**drops));
                // The length to begin with may be the larger of two; and this file names what it looks for.
                let counts = argument.contains("usize::max") || path.ends_with("house");
                assert!(counts || drops.is_none(), "{folder}/{}: fold({argument})", path.display());
                folds += 1;
            }
        }
    }
    assert!(folds > 200, "only {folds} folds seen: does this test still read them?");
}

#[test]
fn what_a_fold_is_given_would_be_seen() {
    let text = "x.fold(0.0, |a: f64, b| a.max(b.abs())); y.fold(0.0, max_or_nan);";
    assert_eq!(arguments(text, ".fold"), ["0.0, |a: f64, b| a.max(b.abs())", "0.0, max_or_nan"]);
}

#[test]
fn errors_of_tests_keep_what_is_no_number() {
    // `f64::max` leaves NaN out, and a broken result would pass.
    for folder in ["tests", "fvi/tests", "fvi-simulation/tests", "fvi-scenario/tests", "benches"] {
        for (path, text) in all_sources(&workspace().join(folder)) {
            let own = path.ends_with("house");
            for (number, line) in text.lines().enumerate() {
                let drops = ["f64::max", "f32::max"].iter().any(|max| line.contains(max));
                assert!(own || !drops, "{folder}/{}.rs:{}: {line}", path.display(), number + 1);
            }
        }
    }
}

/// The part of a page below a heading of the second order.
fn section<'a>(page: &'a str, heading: &str) -> &'a str {
    let (_, rest) = page.split_once(&format!("## {heading}\n")).unwrap();
    rest.split("\n## ").next().unwrap()
}

#[test]
fn the_lists_of_what_an_addition_touches_name_every_file() {
    let page = fs::read_to_string(workspace().join("book/src/develop/adding.md")).unwrap();
    let lists = [
        (
            "A scheme",
            "Scheme::",
            &["LowOrder", "Galerkin", "Collocation", "ExplicitEuler", "ImplicitEuler"][..],
        ),
        ("An engine", "Engine::", &["Direct", "BlockFft", "RealTime", "ExponentialSum", "AnyStep"]),
    ];
    for (heading, of, variants) in lists {
        let list = section(&page, heading);
        let mut files = 0;
        for (name, _) in HOST {
            let source = Path::new(name).join("src");
            for (path, text) in sources(&workspace().join(&source)) {
                let names = names_after(&text, of);
                let path = source.join(path).with_extension("rs").to_string_lossy().into_owned();
                // Exhibits fix the scheme and engine that they exhibit.
                if path.contains("/reproduce/") || !variants.iter().any(|&variant| names.contains(variant)) {
                    continue;
                }
                files += 1;
                assert!(list.contains(&path), "{heading}: the list does not name {path}, which has {of}…");
            }
        }
        assert!(files > 2, "{heading}: {files} files found");
    }
    // Nothing but the list of forms and the constructors knows the type of a form.
    let own = "fvi-fft/src/transfer/forms/distributed.rs";
    let (list, of) = (section(&page, "A kernel"), "Distributed");
    let mut files = 0;
    for (name, _) in HOST {
        for (path, text) in sources(&workspace().join(name).join("src")) {
            let path =
                Path::new(name).join("src").join(path).with_extension("rs").to_string_lossy().into_owned();
            if text.contains(of) && path != own {
                files += 1;
                assert!(list.contains(&path), "A kernel: the list does not name {path}, which has {of}");
            }
        }
    }
    assert_eq!(files, 2, "files that name a form beside its own");
}
