//! Every key that a scenario may have is explained in its reference, `examples/scenarios/README.md`, and
//! those that Python takes as arguments are all in one table.

use fvi_scenario::language::Problem;
use fvi_scenario::scenario::{KEYS, Scenario};
use std::collections::BTreeSet;

/// A complete scenario but for the table that is asked.
const BASE: [(&str, &str); 3] =
    [("system", "mass = [1.0]\n"), ("initial", "position = [1.0]\n"), ("time", "step = 0.1\nsteps = 10\n")];

/// Tables by their headers, with what else they need to be read as far as their keys.
const TABLES: [(&str, &str); 39] = [
    ("[equation]", "order = 0.5\nright = [\"-x0\"]\ninitial = [1.0]"),
    ("[system]", "mass = [1.0]"),
    ("[[system.damping]]", "order = 0.5\ncoefficient = [1.0]"),
    ("[[system.element]]", "potential = \"x0^2\"\ncoordinates = [[0]]"),
    ("[[system.load]]", "pattern = [1.0]\namplitude = \"t\""),
    ("[system.load.pattern]", "coordinate = 0"),
    ("[system.load.amplitude]", "file = \"record.csv\""),
    ("[initial]", "position = [1.0]"),
    ("[scheme]", "kind = \"auto\""),
    ("[scheme]", "kind = \"low-order\""),
    ("[scheme]", "kind = \"galerkin\"\ndegree = 2"),
    ("[scheme]", "kind = \"collocation\""),
    ("[convolution]", "family = \"bdf\""),
    ("[convolution]", "symbol = \"trapezoidal\""),
    ("[convolution]", "family = \"radau-iia\"\nstages = 1"),
    ("[time]", "step = 0.1\nsteps = 10"),
    ("[time]", "grid = \"graded\"\nend = 1.0\nsteps = 10\nexponent = 2.0"),
    ("[time]", "grid = \"geometric\"\nend = 1.0\nfirst = 0.1\nratio = 1.1"),
    ("[time]", "grid = \"points\"\npoints = [0.0, 1.0]"),
    ("[time]", "grid = \"adaptive\"\nend = 1.0\ntolerance = 1e-6"),
    ("[history]", "engine = \"direct\""),
    ("[output]", "every = 1"),
    ("[input]", "samples = [1.0]\nperiod = 0.1"),
    ("[reference]", "energy = \"1\""),
    ("[[event]]", "when = \"q0\""),
    ("[[case]]", "name = \"one\""),
    ("[sensitivity]", "parameters = []"),
    ("[controller]", "measures = \"q0\"\nsetpoint = \"1\"\ndrives = [1.0]\nsample = 0.1"),
    ("[system.damping.kernel]", "form = \"power\"\norder = 0.5"),
    ("[system.damping.kernel]", "form = \"tempered\"\norder = 0.5\nrate = 1.0"),
    ("[system.damping.kernel]", "form = \"maxwell\"\norder = 0.5\ntime = 1.0"),
    ("[system.damping.kernel]", "form = \"prony\"\nstrengths = [1.0]\ntimes = [1.0]"),
    ("[system.damping.kernel]", "form = \"havriliak-negami\"\norder = 0.5\npower = 0.5\ntime = 1.0"),
    ("[system.damping.kernel]", "form = \"distributed\"\nfrom = 0.1\nto = 0.5\ntime = 1.0"),
    ("[system.damping.kernel]", "symbol = \"s^0.5\""),
    ("[system.damping.kernel]", "relaxation = \"G.csv\""),
    ("[system.damping.kernel]", "radiation = \"table.csv\""),
    ("[system.damping.kernel]", "states = \"file.npz\""),
    ("title = \"\"", ""),
];

/// The keys that a table may have, by the message about one that it may not have.
fn keys(header: &str, content: &str) -> Vec<String> {
    let mut text = String::new();
    let table = header.trim_matches(['[', ']']);
    if !header.starts_with('[') {
        text += "unknown_key = 1\n";
    }
    for (name, lines) in BASE {
        // An equation stands in place of a system and its initial state.
        if table != name && (table != "equation" || name == "time") {
            text += &format!("[{name}]\n{lines}");
        }
        if name == "system" && table.starts_with("system.damping.") {
            // Hydrodynamics are a matrix of kernels, with coefficients of its own.
            let is_matrix = content.starts_with("radiation") || content.starts_with("states");
            text +=
                if is_matrix { "[[system.damping]]\n" } else { "[[system.damping]]\ncoefficient = [1.0]\n" };
        }
        if name == "system" && table.starts_with("system.load.") {
            let other = if table.ends_with("pattern") { "amplitude = \"t\"" } else { "pattern = [1.0]" };
            text += &format!("[[system.load]]\n{other}\n");
        }
        if name == "system" && table.starts_with("system.") {
            text += &format!("{header}\n{content}\nunknown_key = 1\n");
        }
    }
    if header.starts_with('[') && !table.starts_with("system.") {
        text += &format!("{header}\n{content}\nunknown_key = 1\n");
    }
    let error = text.parse::<Scenario>().err().unwrap_or_else(|| panic!("{header} takes any key:\n{text}"));
    match error.problem() {
        Problem::UnknownKey { allowed, .. } => allowed.split(", ").map(str::to_owned).collect(),
        _ => panic!("{header}: {error}\n{text}"),
    }
}

#[test]
fn the_reference_explains_every_key_of_a_scenario() {
    let page = include_str!("../../examples/scenarios/README.md");
    let explained =
        |key: &str| {
            let tables = [format!("[{key}]"), format!("[[{key}]]"), format!(".{key}]]")];
            // As code on the page, or as a key in an example there.
            tables.iter().any(|table| page.contains(table))
                || page.split('`').skip(1).step_by(2).any(|code| {
                    code.split(|c: char| !(c.is_alphanumeric() || c == '_')).any(|word| word == key)
                })
        };
    let mut missing = BTreeSet::new();
    for (header, content) in TABLES {
        let keys = keys(header, content);
        assert!(!keys.is_empty(), "{header}");
        missing
            .extend(keys.into_iter().filter(|key| !explained(key)).map(|key| format!("{key} of {header}")));
    }
    assert!(missing.is_empty(), "not in examples/scenarios/README.md: {missing:?}");
}

#[test]
fn the_table_of_keys_has_those_that_the_readers_take() {
    for (table, listed) in KEYS {
        let readers = TABLES.iter().filter(|(header, _)| *header == format!("[{table}]"));
        let taken: BTreeSet<String> = readers.flat_map(|(header, content)| keys(header, content)).collect();
        let listed: BTreeSet<String> = listed.iter().map(|&key| key.to_owned()).collect();
        assert_eq!(listed, taken, "[{table}]");
    }
}
