use super::*;
use fvi_fft::memory::{Engine, Overflow, States};
use fvi_fft::quadrature::ConvolutionFamily;

const GOOD: &str = r#"
title = "Two masses"
[system]
mass = [[2.0, 0.5], [0.5, 1.0]]
potential = "0.5*k*q0^2 + cos(q1)"
force = ["8*step(1 - t)", "0"]
parameters = { k = 3 }
[[system.damping]]
order = 0.5
coefficient = [0.1, 0.2]
[[system.damping]]
order = 1.5
coefficient = [[1.0, -1.0], [-1.0, 1.0]]
derivative = "riemann-liouville"
[initial]
position = [1.0, 2]
velocity = [1.0, -1.0]
[scheme]
kind = "low-order"
kappa = 0.3
[convolution]
family = "bdf"
order = 3
[time]
step = 0.1
end = 30.0
[history]
capacity = 64
overflow = "forget"
[output]
every = 10
[input]
period = 0.2
samples = [[1.0, 0.0], [0.0, 2.0]]
[reference]
position = ["t^2.5", "0"]
"#;

fn read(text: &str) -> Result<Scenario, InputError> {
    Scenario::from_document(Document::new("test.toml", Path::new(""), text))
}

/// The good scenario with one passage replaced, and the resulting error as (key, line of the file, message).
fn refused(passage: &str, replacement: &str) -> (String, usize, String) {
    assert!(GOOD.contains(passage), "{passage}");
    let error = read(&GOOD.replacen(passage, replacement, 1)).unwrap_err();
    (error.key().to_owned(), error.line().unwrap(), error.to_string())
}

#[test]
fn rest_is_where_neither_momentum_nor_velocity_is_given() {
    let scenario = read(&GOOD.replacen("velocity = [1.0, -1.0]", "", 1)).unwrap();
    assert_eq!((scenario.initial.position, scenario.initial.momentum), (vec![1.0, 2.0], vec![0.0; 2]));
}

#[test]
fn every_key_is_read() {
    let scenario = read(GOOD).unwrap();
    assert_eq!(scenario.heading(), "Two masses");
    assert_eq!(scenario.coordinates(), 2);
    assert_eq!(scenario.initial.position, [1.0, 2.0]);
    assert_eq!(scenario.initial.momentum, [1.5, -0.5]);
    assert_eq!(scenario.scheme, Scheme::LowOrder { kappa: 0.3 });
    assert_eq!(scenario.convolution.family, ConvolutionFamily::Bdf { order: 3 });
    assert_eq!(
        scenario.time,
        TimeGrid { start: 0.0, step: 0.1, steps: 300, grid: None, allow_unstable: false, energy_guard: None }
    );
    assert_eq!(scenario.history.engine, Some(Engine::Direct));
    assert_eq!(scenario.history.capacity, Some(64));
    assert_eq!(scenario.history.overflow, Overflow::Forget);
    assert_eq!(scenario.output.every, 10);
    let orders: Vec<_> =
        scenario.system.damping.iter().map(|term| (term.transfer.growth(), term.derivative)).collect();
    assert_eq!(orders, [(0.5, Derivative::Caputo), (1.5, Derivative::RiemannLiouville)]);
    assert_eq!(scenario.system.damping[0].coefficient, SymmetricMatrix::Diagonal(vec![0.1, 0.2]));
    let row = scenario.reference.unwrap().at_step(10, 0.1, 2).unwrap();
    assert_eq!((row.position, row.momentum), (vec![Some(1.0), Some(0.0)], vec![None, None]));
}

#[test]
fn samples_are_held_until_the_next_one() {
    let input = read(GOOD).unwrap().input.unwrap();
    let held: Vec<_> = (0..5).map(|step| input.at_step(step).unwrap().to_vec()).collect();
    let (first, second) = (vec![1.0, 0.0], vec![0.0, 2.0]);
    assert_eq!(held, [first.clone(), first, second.clone(), second.clone(), second]);
}

#[test]
fn the_record_of_the_inputs_holds_values_and_defaults() {
    let text = GOOD.replacen("[scheme]\nkind = \"low-order\"\nkappa = 0.3\n", "", 1);
    let record = serde_json::to_value(read(&text).unwrap()).unwrap();
    assert_eq!(record["scheme"]["kind"], "low-order");
    let text = GOOD.replacen("kind = \"low-order\"\n", "", 1);
    assert_eq!(read(&text).unwrap().scheme, Scheme::LowOrder { kappa: 0.3 });
    assert_eq!(record["scheme"]["kappa"], 0.5);
    assert_eq!(record["convolution"]["family"], "bdf");
    assert_eq!(record["convolution"]["at"], "nodes");
    assert_eq!(record["output"]["momentum"], "mean");
    assert_eq!(record["system"]["potential"], "0.5*k*q0^2 + cos(q1)");
    assert_eq!(record["system"]["mass"][0][1], 0.5);
    assert_eq!(record["system"]["damping"][1]["derivative"], "riemann-liouville");
    assert_eq!(record["time"]["steps"], 300);
}

#[test]
fn a_scenario_that_does_not_say_is_damped_at_the_nodes_with_order_two() {
    let start = GOOD.find("[scheme]").unwrap();
    let end = GOOD.find("[time]").unwrap();
    let with = |passage: &str| read(&format!("{}{passage}\n{}", &GOOD[..start], &GOOD[end..]));
    let form = |passage: &str| {
        let scenario = with(passage).unwrap_or_else(|error| panic!("{passage}: {error}"));
        let ConvolutionFamily::Bdf { order } = scenario.convolution.family else { panic!("{passage}") };
        (order, scenario.convolution.at, scenario.output.momentum)
    };
    let (nodes, main) = (DampedAt::Nodes, DampedAt::MainNodes);
    let (mean, one_sided) = (ReportedMomentum::Mean, ReportedMomentum::OneSided);
    assert_eq!(with("").unwrap().scheme, Scheme::LowOrder { kappa: 0.5 });
    assert_eq!(form(""), (2, nodes, mean));
    assert_eq!(form("[scheme]\nkind = \"galerkin\"\ndegree = 3"), (2, nodes, mean));
    assert_eq!(form("[convolution]\norder = 4"), (4, nodes, mean));
    assert_eq!(form("[convolution]\nat = \"main-nodes\""), (2, main, mean));
    assert_eq!(form("[convolution]\nstarting = [2.0]"), (2, main, mean));
    assert_eq!(form("[convolution]\nstarting = []"), (2, nodes, mean));
    for euler in ["explicit-euler", "implicit-euler"] {
        assert_eq!(form(&format!("[scheme]\nkind = \"{euler}\"")), (1, main, one_sided));
        for (key, wrong) in [("convolution.at", "nodes"), ("output.momentum", "mean")] {
            let (table, name) = key.split_once('.').unwrap();
            // GOOD already has a table `[output]`.
            let text = format!("[scheme]\nkind = \"{euler}\"\n[{table}]\n{name} = \"{wrong}\"");
            let text =
                format!("{}{text}\n{}", &GOOD[..start], &GOOD[end..].replace("[output]\nevery = 10\n", ""));
            let error = read(&text).unwrap_err();
            assert!(error.key() == key && error.to_string().contains("go together"), "{error}");
        }
    }
    let error = with("[convolution]\nat = \"nodes\"\nstarting = [2.0]").unwrap_err();
    assert_eq!(error.key(), "convolution.starting");
}

/// A mass is positive definite whatever the units of its coordinates are: here metres and nanometres.
#[test]
fn a_mass_may_have_entries_of_any_size() {
    let of = |mass: &str| read(&GOOD.replace("[[2.0, 0.5], [0.5, 1.0]]", mass));
    assert!(of("[[1.2, 3e8], [3e8, 9e17]]").is_ok());
    assert!(of("[[1.2e-30, 3e-31], [3e-31, 9e-31]]").is_ok());
    for singular in
        ["[[1.2, 1.2e9], [1.2e9, 1.2e18]]", "[[1.2, 3e9], [3e9, 9e17]]", "[[-1.2, 3e8], [3e8, 9e17]]"]
    {
        assert_eq!(of(singular).unwrap_err().key(), "system.mass", "{singular}");
    }
}

#[test]
fn mistakes_are_told_with_key_line_value_and_what_is_allowed() {
    let cases = [
        ("mass = [[2.0, 0.5]", "mas = [[2.0, 0.5]", "system.mas", 4, "unknown key"),
        (
            "mass = [[2.0, 0.5], [0.5, 1.0]]",
            "mass = [[2.0, 0.5], [0.4, 1.0]]",
            "system.mass",
            4,
            "not symmetric",
        ),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[[1.0, 2.0], [2.0, 1.0]]", "system.mass", 4, "not positive definite"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[2.0, -0.5]", "system.mass", 4, "not positive definite"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[2.0, 5e-324]", "system.mass", 4, "not positive definite"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[2.0, nan]", "system.mass[1]", 4, "not allowed"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[[2.0, 0.5], [0.5]]", "system.mass[1]", 4, "1 entries instead of 2"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "2.0", "system.mass", 4, "a number instead of a list"),
        (
            "[[2.0, 0.5], [0.5, 1.0]]",
            "[1.0, 1, 1, 1, 1, 1, 1, 1, 1]",
            "system.force",
            6,
            "2 entries instead of 9",
        ),
        ("0.5*k*q0^2", "0.5*k*(q0^2", "system.potential", 5, "this bracket is never closed (column 7)"),
        ("0.5*k*q0^2", "0.5*k*q2^2", "system.potential", 5, "unknown name `q2` (column 7)"),
        ("0.5*k*q0^2", "0.5*t*q0^2", "system.potential", 5, "unknown name `t`"),
        ("\"8*step(1 - t)\", ", "", "system.force", 6, "1 entries instead of 2"),
        ("8*step(1 - t)", "", "system.force[0]", 6, "the expression is empty"),
        ("k = 3", "pi = 3", "system.parameters.pi", 7, "cannot be a parameter"),
        ("k = 3", "k = inf", "system.parameters.k", 7, "not allowed"),
        ("order = 0.5", "order = 2.0", "system.damping[0].order", 9, "not allowed"),
        ("order = 0.5", "order = -0.1", "system.damping[0].order", 9, "not allowed"),
        ("order = 1.5", "order = nan", "system.damping[1].order", 12, "not allowed"),
        ("[0.1, 0.2]", "[0.1, -0.2]", "system.damping[0].coefficient", 10, "not positive semidefinite"),
        ("[0.1, 0.2]", "[0.1]", "system.damping[0].coefficient", 10, "1 rows instead of 2"),
        ("[-1.0, 1.0]]", "[-1.0, 0.5]]", "system.damping[1].coefficient", 13, "not positive semidefinite"),
        ("riemann-liouville", "riemann", "system.damping[1].derivative", 14, "not allowed"),
        ("position = [1.0, 2]", "position = [1.0]", "initial.position", 16, "1 entries instead of 2"),
        ("position = [1.0, 2]", "", "initial", 15, "`position` is missing"),
        ("velocity =", "momentum = [0.0, 0.0]\nvelocity =", "initial.velocity", 18, "cannot stand beside"),
        ("kappa = 0.3", "kappa = 1.5", "scheme.kappa", 20, "not allowed"),
        ("kappa = 0.3", "kapa = 0.3", "scheme.kapa", 20, "unknown key"),
        ("kind = \"low-order\"", "kind = \"high-order\"", "scheme.kind", 19, "not allowed"),
        ("order = 3", "order = 7", "convolution.order", 23, "not allowed"),
        (
            "family = \"bdf\"\norder = 3",
            "family = \"radau-iia\"\nstages = 2",
            "convolution.family",
            22,
            "go together",
        ),
        (
            "kind = \"low-order\"\nkappa = 0.3",
            "kind = \"galerkin\"\ndegree = 7",
            "scheme.degree",
            20,
            "not allowed",
        ),
        (
            "kind = \"low-order\"\nkappa = 0.3",
            "kind = \"galerkin\"\ndegree = 3\npoints = 2",
            "scheme.points",
            21,
            "not allowed",
        ),
        ("step = 0.1", "step = 0.0", "time.step", 25, "not allowed"),
        ("step = 0.1", "step = -0.1", "time.step", 25, "not allowed"),
        ("step = 0.1", "step = nan", "time.step", 25, "not allowed"),
        ("step = 0.1", "step = \"0.1\"", "time.step", 25, "a text instead of a number"),
        ("end = 30.0", "end = 30.05", "time.end", 26, "not allowed"),
        ("end = 30.0", "steps = -3", "time.steps", 26, "not allowed"),
        ("end = 30.0", "steps = 2.5", "time.steps", 26, "not allowed"),
        ("end = 30.0", "end = 30.0\nsteps = 300", "time.end", 26, "cannot stand beside"),
        ("end = 30.0", "", "time", 24, "`steps` or `end` is missing"),
        ("capacity = 64", "capacity = 0", "history.capacity", 28, "not allowed"),
        ("capacity = 64", "engine = \"block-fft\"", "history.overflow", 29, "go together"),
        ("capacity = 64", "engine = \"fast\"", "history.engine", 28, "not allowed"),
        ("overflow = \"forget\"", "horizon = 400", "history.horizon", 29, "go together"),
        ("capacity = 64\noverflow = \"forget\"", "tolerance = 1e-15", "history.tolerance", 28, "not allowed"),
        // 301 samples
        ("capacity = 64\noverflow = \"forget\"", "horizon = 300", "history.horizon", 28, "not allowed"),
        ("every = 10", "every = 0", "output.every", 31, "not allowed"),
        ("period = 0.2", "", "input", 32, "`period` is missing"),
        ("[0.0, 2.0]]", "2.0]", "input.samples[1]", 34, "one number instead of a row"),
        ("\"t^2.5\"", "\"q0\"", "reference.position[0]", 36, "unknown name `q0`"),
        ("[output]", "[outptu]", "outptu", 30, "unknown key"),
        ("[output]", "[output", "", 30, "not valid TOML"),
    ];
    for (passage, replacement, key, line, message) in cases {
        let (found_key, found_line, text) = refused(passage, replacement);
        assert_eq!((found_key.as_str(), found_line), (key, line), "{replacement}: {text}");
        assert!(text.contains(message), "{replacement}: {text}");
        assert!(text.starts_with(&format!("test.toml:{line}:")), "{text}");
    }
}

#[test]
fn an_expression_error_points_at_the_character() {
    let error = read(&GOOD.replacen("0.5*k*q0^2", "0.5*k*q2^2", 1)).unwrap_err();
    assert!(error.to_string().starts_with("test.toml:5:20: system.potential = "), "{error}");
    let help = miette::Diagnostic::help(&error).unwrap().to_string();
    assert!(help.contains("q0, q1, k, pi"), "{help}");
}

#[test]
fn a_misspelt_key_is_answered_with_the_right_one() {
    let error = read(&GOOD.replacen("capacity", "capcity", 1)).unwrap_err();
    let help = miette::Diagnostic::help(&error).unwrap().to_string();
    assert_eq!(
        help,
        "did you mean `capacity`? Keys here: engine, tolerance, horizon, capacity, overflow, states, threads"
    );
}

#[test]
fn an_end_is_a_whole_number_of_steps_up_to_rounding() {
    let steps = |step: &str, end: &str| {
        let text = GOOD.replacen("step = 0.1", &format!("step = {step}"), 1);
        read(&text.replacen("end = 30.0", &format!("end = {end}"), 1)).map(|scenario| scenario.time.steps)
    };
    assert_eq!(steps("0.1", "0.3").unwrap(), 3);
    assert_eq!(steps("0.1", "0").unwrap(), 0);
    assert_eq!(steps("0.001", "1000000.0").unwrap(), 1_000_000_000);
    assert_eq!(steps("0.07", "7.0").unwrap(), 100);
    assert!(steps("0.3", "1.0").is_err());
    assert!(steps("0.1", "-1.0").is_err());
    assert!(steps("1e-300", "1e300").is_err());
    // An end within the first step does not count as an end at its beginning.
    let error = steps("1.0", "1e-10").unwrap_err();
    assert!(error.to_string().contains("time.end = 1e-10: not allowed"), "{error}");
    let allowed = "allowed: a whole number of steps of 1, such as 0 or 1; or give `steps` instead";
    assert_eq!(error.problem().allowed().unwrap(), allowed);
}

#[test]
fn where_no_step_is_stable_no_step_is_named() {
    let unstable = |largest_step| Problem::Unstable { largest_step, advice: String::new() };
    assert_eq!(unstable(None).to_string(), "unstable: motions grow at every shorter step too");
    assert_eq!(unstable(Some(0.25)).to_string(), "unstable: the largest stable step is about 2.50e-1");
}

#[test]
fn steps_are_few_enough_to_be_counted() {
    let steps = |count: &str| read(&GOOD.replacen("end = 30.0", &format!("steps = {count}"), 1));
    assert_eq!(steps("9007199254740992").unwrap().time.steps, MOST_STEPS);
    for count in ["9007199254740993", "9223372036854775807", "18446744073709551613", "18446744073709551615"] {
        assert_eq!(steps(count).unwrap_err().key(), "time.steps", "{count}");
    }
}

#[test]
fn nothing_of_a_file_steers_the_terminal() {
    let error = read(&GOOD.replacen("capacity", "\"cap\\u001b[2Jcity\"", 1)).unwrap_err();
    assert!(error.to_string().contains("unknown key") && !error.to_string().contains('\u{1b}'), "{error}");
    let error = read("title = \"bell \u{7} \u{9b}\"\n").unwrap_err();
    let mut report = String::new();
    let theme = miette::GraphicalTheme::unicode_nocolor();
    miette::GraphicalReportHandler::new_themed(theme).render_report(&mut report, &error).unwrap();
    assert!(report.contains("bell ?") && !report.contains(['\u{7}', '\u{9b}']), "{report}");
}

#[test]
fn a_start_where_the_potential_is_not_finite_is_refused() {
    let (key, line, text) = refused("cos(q1)", "log(q1 - 2)");
    assert_eq!((key.as_str(), line), ("system.potential", 5));
    assert!(text.contains("the potential is not finite at t = 0"), "{text}");
    let (key, ..) = refused("\"0\"]", "\"sqrt(-q1)\"]");
    assert_eq!(key, "system.force[1]");
}

#[test]
fn an_error_about_what_the_file_does_not_say_names_the_key_without_a_line() {
    let problem = Problem::OutOfRange { allowed: "something else".to_owned() };
    let error = read(GOOD).unwrap().error_at("history.engine", problem.clone());
    assert_eq!((error.line(), error.to_string().as_str()), (None, "test.toml: history.engine: not allowed"));
    let error = read(GOOD).unwrap().error_at("system.damping[1].order", problem);
    assert_eq!(error.to_string(), "test.toml:12:9: system.damping[1].order = 1.5: not allowed");
}

#[test]
fn a_galerkin_scheme_takes_its_quadrature_from_where_it_is_given() {
    let with = |scheme: &str, convolution: &str| {
        let text =
            GOOD.replacen("kind = \"low-order\"\nkappa = 0.3", &format!("kind = \"galerkin\"\n{scheme}"), 1);
        read(&text.replacen("family = \"bdf\"\norder = 3", convolution, 1)).map(|scenario| scenario.scheme)
    };
    let galerkin = |degree, quadrature| Scheme::Galerkin { degree, quadrature };
    assert_eq!(with("degree = 3", "").unwrap(), galerkin(3, Some(Quadrature::Gauss(3))));
    let lobatto = with("degree = 3\nquadrature = \"lobatto\"", "").unwrap();
    assert_eq!(lobatto, galerkin(3, Some(Quadrature::Lobatto(4))));
    let radau = "family = \"radau-iia\"\nstages = 3";
    assert_eq!(with("degree = 3", radau).unwrap(), galerkin(3, None));
    assert!(with("degree = 3\npoints = 3", radau).is_err());
    let error = with("degree = 3", "family = \"lobatto-iiic\"\nstages = 2").unwrap_err();
    assert!(
        error.to_string().contains("convolution.stages = 2: does not go together with `scheme.degree` = 3")
    );
}

/// The good scenario with one passage replaced and an attached table file.
fn with_table(passage: &str, replacement: &str, table: &str) -> Result<Scenario, InputError> {
    assert!(GOOD.contains(passage), "{passage}");
    let text = GOOD.replacen(passage, replacement, 1);
    Scenario::from_document(
        Document::new("test.toml", Path::new(""), &text).with_attached("table.csv", table),
    )
}

#[test]
fn files_that_promise_many_rows_take_no_room_for_them() {
    const HEAD: &str = "%%MatrixMarket matrix coordinate real general\n";
    let full = format!("{HEAD}2 2 2\n1 1 1.0\n2 2 1.0\n");
    let [empty, column] = ["2000000000", "1"].map(|columns| format!("{HEAD}2000000000 {columns} 0\n"));
    let with = |mass: &str, stiffness: &str, position: &str| {
        let text = "[system]\nmass = \"m.mtx\"\nstiffness = \"k.mtx\"\n[initial]\nposition = \"q.mtx\"\nmomentum = [0.0, 0.0]\n\
                    [time]\nstep = 0.1\nsteps = 1\n";
        let document = Document::new("test.toml", Path::new(""), text);
        let document = document.with_attached("m.mtx", mass).with_attached("k.mtx", stiffness);
        Scenario::from_document(document.with_attached("q.mtx", position)).unwrap_err().to_string()
    };
    let position = format!("{HEAD}2 1 1\n1 1 0.5\n");
    for (message, said) in [
        (with(&empty, &full, &position), "0 entries in 2000000000 rows"),
        (with(&full, &empty, &position), "2000000000 rows"),
        (with(&full, &full, &column), "2000000000 entries"),
    ] {
        assert!(message.contains(said), "{message}");
    }
}

const INLINE_INPUT: &str = "period = 0.2\nsamples = [[1.0, 0.0], [0.0, 2.0]]";
const INLINE_REFERENCE: &str = "position = [\"t^2.5\", \"0\"]";
const TABLE: &str = "file = \"table.csv\"";

#[test]
fn a_sample_beyond_all_steps_never_acts() {
    for late in ["1e308", "1.7e308", "31"] {
        let table = format!("t,u0\n0,1\n{late},5\n");
        let input = with_table(INLINE_INPUT, TABLE, &table).unwrap().input.unwrap();
        assert_eq!(input.at_step(0), Some([1.0, 0.0].as_slice()), "{late}");
        assert_eq!(input.at_step(299), Some([1.0, 0.0].as_slice()), "{late}");
    }
    let endless = INLINE_INPUT.replace("0.2", "1.7e308").replace("]]", "], [0.0, 0.0]]");
    let error = read(&GOOD.replacen(INLINE_INPUT, &endless, 1)).unwrap_err();
    assert_eq!(error.key(), "input.period");
}

#[test]
fn a_reference_that_nothing_can_be_compared_with_is_refused() {
    for (expressions, key) in [
        (r#"position = ["sqrt(-1 - t)", "0"]"#, "reference.position[0]"),
        (r#"position = ["0", "1e308*10^(1 + t)"]"#, "reference.position[1]"),
        (r#"momentum = ["log(-t)", "0"]"#, "reference.momentum[0]"),
        (r#"energy = "log(t - 40)""#, "reference.energy"),
    ] {
        let (found, line, text) = refused(INLINE_REFERENCE, expressions);
        assert_eq!((found.as_str(), line), (key, 36), "{text}");
        assert!(text.contains("the reference is not finite at any of the 301 grid points"), "{text}");
    }
    for (table, told) in [
        ("t\n0\n1\n", "line 1: there is no column beside t; columns after t: q0, q1, p0, p1, energy"),
        ("t,q0\n0.05,1\n31,1\n", "none of its times is a grid point k·0.1, k = 0…300"),
    ] {
        let text = with_table(INLINE_REFERENCE, TABLE, table).unwrap_err().to_string();
        assert!(text.contains(told), "{text}");
    }
    let text = with_table(INLINE_INPUT, TABLE, "t\n0\n").unwrap_err().to_string();
    assert!(text.contains("there is no column beside t"), "{text}");
}

#[test]
fn values_that_are_not_finite_and_times_off_the_grid_are_counted() {
    let scenario = read(&GOOD.replacen("\"t^2.5\", \"0\"", "\"1/t\", \"log(t - 1)\"", 1)).unwrap();
    let undefined = |index| scenario.reference.as_ref().unwrap().at_step(index, 0.1, 2).unwrap().undefined;
    assert_eq!((undefined(0), undefined(5), undefined(10), undefined(11)), (2, 1, 1, 0));
    let rows = "t,q0\n0,1\n0.1,1\n0.15,1\n0.25,1\n30.05,1\n";
    let warnings = with_table(INLINE_REFERENCE, TABLE, rows).unwrap().warnings();
    assert!(
        warnings.iter().any(|warning| warning.contains("2 of its times are not grid points")),
        "{warnings:?}"
    );
}

#[test]
fn a_state_in_single_precision_is_for_tolerances_that_allow_it() {
    let history = "capacity = 64\noverflow = \"forget\"";
    let with = |keys: &str| read(&GOOD.replacen(history, keys, 1));
    let scenario = with("tolerance = 1e-6\nstates = \"f32\"\nthreads = 2").unwrap();
    assert_eq!((scenario.history.states, scenario.history.threads()), (Some(States::F32), 2));
    assert_eq!(scenario.history.engine, Some(Engine::ExponentialSum));
    for (keys, key) in [
        ("states = \"f32\"", "history.states"),
        ("tolerance = 1e-9\nstates = \"f32\"", "history.states"),
        ("engine = \"exponential-sum-core\"\ntolerance = 1e-6\nstates = \"f32\"", "history.states"),
        ("engine = \"direct\"\nstates = \"f64\"", "history.states"),
        ("states = \"f16\"", "history.states"),
        ("threads = 0", "history.threads"),
    ] {
        assert_eq!(with(keys).unwrap_err().key(), key, "{keys}");
    }
}

#[test]
fn a_tolerance_is_small_and_belongs_to_exponentials_of_plain_weights() {
    let history = "capacity = 64\noverflow = \"forget\"";
    let with = |tolerance: &str| GOOD.replacen(history, &format!("tolerance = {tolerance}"), 1);
    for tolerance in ["4e-15", "1e-6"] {
        assert_eq!(read(&with(tolerance)).unwrap().history.engine, Some(Engine::ExponentialSum));
    }
    for tolerance in ["1e-15", "2e-6", "0.1"] {
        let error = read(&with(tolerance)).unwrap_err();
        let help = miette::Diagnostic::help(&error).unwrap().to_string();
        assert_eq!((error.key(), help.as_str()), ("history.tolerance", "allowed: 4e-15 ≤ tolerance ≤ 1e-6"));
    }
    let text = with("1e-8")
        .replacen("kind = \"low-order\"\nkappa = 0.3", "kind = \"galerkin\"\ndegree = 2", 1)
        .replacen("family = \"bdf\"\norder = 3", "family = \"radau-iia\"\nstages = 2", 1);
    assert!(
        read(&text)
            .unwrap_err()
            .to_string()
            .contains("does not go together with a quadrature other than BDF (`convolution.family`)")
    );
}

#[test]
fn starting_exponents_whose_weights_grow_are_refused() {
    // The orders of the good scenario are ½ and 3/2, its quadrature is of order 3.
    let with = |exponents: &str| {
        read(&GOOD.replacen("order = 3", &format!("order = 3\nstarting = {exponents}"), 1)).map(|_| ())
    };
    assert!(with("[0.5, 2, 3.5]").is_ok());
    let error = with("[2, 3.51]").unwrap_err();
    assert_eq!((error.key(), error.line()), ("convolution.starting[1]", Some(24)));
    let help = miette::Diagnostic::help(&error).unwrap().to_string();
    assert!(help.contains("exponents up to 3.5"), "{help}");
    // 2^ν is the same number for both.
    assert_eq!(with("[0.5, 0.5000000000000001]").unwrap_err().key(), "convolution.starting");
    let allowed = GOOD.replacen("order = 3", "order = 3\nstarting = [3.51]\n", 1);
    let allowed = read(&allowed.replacen("end = 30.0", "end = 30.0\nallow_unstable = true", 1)).unwrap();
    assert!(allowed.warnings().iter().any(|warning| warning.contains("above 3.5 grow with time")));
}

#[test]
fn forces_that_jump_are_warned_of_and_dampers_that_vanish_with_the_velocity_are_not() {
    let warned = |force: &str| {
        let text = format!(
            "[system]\nmass = [1.0]\npotential = \"q0^2\"\nforce = [\"{force}\"]\n[initial]\nposition = [1.0]\n\
             momentum = [0.5]\n[scheme]\nkind = \"galerkin\"\ndegree = 2\n[time]\nstep = 0.01\nend = 1.0\n"
        );
        read(&text).unwrap().warnings().concat()
    };
    for force in
        ["-0.1*sign(v0)", "-sign(v0)*(1 + abs(v0))", "-sign(v0)/abs(v0)^0.3", "-sign(v0)*abs(q0)^0.3"]
    {
        assert!(warned(force).contains("of a velocity jumps inside of steps"), "{force}: {}", warned(force));
    }
    assert!(warned("-sign(q0)").contains("of the position jumps inside of steps"));
    for force in [
        "-0.3*sign(v0)*abs(v0)^0.4",
        "sign(-v0)*abs(v0)^0.4 - v0",
        "-(abs(v0)^0.4*(2*sign(v0)))",
        "-sign(q0)*sqrt(abs(q0))",
        "-sign(v0 - q0)*(v0 - q0)^2",
    ] {
        assert_eq!(warned(force), "", "{force}");
    }
}

#[test]
fn a_singular_force_of_the_initial_position_is_warned_of() {
    let warned = |order: &str, family: &str, position: &str| {
        let text = GOOD
            .replacen("order = 1.5", &format!("order = {order}"), 1)
            .replacen("order = 3", &format!("{family}\nat = \"main-nodes\""), 1)
            .replacen("position = [1.0, 2]", &format!("position = {position}"), 1);
        read(&text).unwrap().warnings().concat()
    };
    assert!(warned("1.5", "order = 1", "[1.0, 2]").contains("damping[1].derivative"));
    assert!(warned("1.5", "order = 1", "[1.0, 2]").contains("no limit"));
    assert!(warned("1.0", "order = 2", "[1.0, 2]").contains("differently by each `convolution.order`"));
    assert!(warned("0.25", "order = 2", "[1.0, 2]").contains("h^0.750"));
    // The force acts on the difference of the coordinates; with BDF 1 and order 1 it is a linear damper's.
    for (order, family, position) in
        [("1.5", "order = 1", "[2.0, 2]"), ("1.0", "order = 1", "[1.0, 2]"), ("0", "order = 2", "[1.0, 2]")]
    {
        assert_eq!(warned(order, family, position), "", "{order} {family} {position}");
    }
}

#[test]
fn lobatto_quadrature_has_one_point_more_than_the_degree_up_to_the_highest() {
    let text = GOOD.replacen(
        "kind = \"low-order\"\nkappa = 0.3",
        "kind = \"galerkin\"\ndegree = 6\nquadrature = \"lobatto\"",
        1,
    );
    assert_eq!(read(&text).unwrap().scheme.quadrature(), Some(Quadrature::Lobatto(7)));
    let text = text.replacen("\"lobatto\"", "\"gauss\"\npoints = 7", 1);
    assert!(read(&text).unwrap_err().to_string().contains("scheme.points = 7: not allowed"));
}

#[test]
fn an_end_that_no_step_reaches_is_refused_with_two_that_are_reached() {
    let refused = |step: &str, end: &str| {
        let text = GOOD.replacen("step = 0.1", &format!("step = {step}"), 1);
        let error = read(&text.replacen("end = 30.0", &format!("end = {end}"), 1)).unwrap_err();
        miette::Diagnostic::help(&error).unwrap().to_string()
    };
    assert!(refused("0.3", "1.0").contains("such as 0.8999999999999999 or 1.2"), "{}", refused("0.3", "1.0"));
    assert!(refused("1.0", "1e-10").contains("such as 0 or 1"));
    assert!(refused("1e-10", "1e300").contains("at most 9007199254740992 steps"));
}

#[test]
fn long_and_binary_input_is_told_in_short() {
    let long = "x".repeat(1_000_000);
    let cell = format!("t,u0\n0,{long}\n");
    for error in [
        with_table(INLINE_INPUT, TABLE, &cell).unwrap_err(),
        with_table(INLINE_INPUT, TABLE, &format!("t,{long}\n0,1\n")).unwrap_err(),
        read(&GOOD.replacen("title =", &format!("{long} ="), 1)).unwrap_err(),
        read(&GOOD.replacen("[0.1, 0.2]", &format!("\"{long}\""), 1)).unwrap_err(),
        read(&GOOD.replacen("k*q0^2", &format!("{long}*q0^2"), 1)).unwrap_err(),
    ] {
        assert!(error.to_string().len() < 400, "{}", error.to_string().len());
        let shown = miette::Diagnostic::source_code(&error).is_some();
        assert_eq!(shown, error.key().starts_with("input"), "a line that long is not shown");
    }
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("binary.toml");
    std::fs::write(&path, b"title = \"a\"\n\nb = \xff\n").unwrap();
    let error = Scenario::read(&path).unwrap_err();
    assert_eq!(error.line(), Some(3));
    assert!(error.to_string().contains("not text in UTF-8: line 3, byte 18 of the file"), "{error}");
}

#[test]
fn a_scenario_that_is_written_out_reads_as_it_was() {
    for kind in ["kind = \"low-order\"\nkappa = 0.25", "kind = \"galerkin\"\ndegree = 2"] {
        let start = GOOD.find("[scheme]").unwrap();
        let end = start + GOOD[start..].find("\n[").unwrap();
        let text = format!("{}[scheme]\n{kind}{}", &GOOD[..start], &GOOD[end..]);
        let scenario = read(&text).unwrap();
        let again = Scenario::from_value(&scenario).unwrap();
        let json = |scenario: &Scenario| serde_json::to_string(scenario).unwrap();
        assert_eq!(json(&again), json(&scenario));
    }
}

#[test]
fn starting_weights_that_lower_the_order_are_warned_of() {
    let warned = |order: f64, starting: &str, start: [f64; 2], derivative: &str| {
        let text = format!(
            "[system]\nmass = [1.0]\n[[system.damping]]\norder = {order}\ncoefficient = [1.0]\n\
             derivative = \"{derivative}\"\n[initial]\nposition = [{:?}]\nvelocity = [{:?}]\n\
             [convolution]\norder = 2\nstarting = {starting}\n[time]\nstep = 0.1\nsteps = 10\n",
            start[0], start[1]
        );
        let document = Document::new("test.toml", std::path::Path::new(""), &text);
        let warnings = Scenario::from_document(document).unwrap().warnings();
        warnings.iter().any(|warning| warning.contains("lower the order"))
    };
    for starting in ["[1.0]", "[0.5, 1.5]", "[2.0]", "[2.5]"] {
        assert!(warned(0.5, starting, [0.0, 0.5], "caputo"), "{starting}");
        assert!(warned(1.5, starting, [1.0, 0.0], "caputo"), "{starting}");
        // A motion from rest at zero: no warning.
        assert!(!warned(0.5, starting, [0.0, 0.0], "caputo"), "{starting}");
        assert_eq!(warned(0.5, starting, [1.0, 0.0], "caputo"), starting == "[2.5]", "{starting}");
    }
    assert!(!warned(0.5, "[]", [1.0, 0.5], "caputo"));
    assert!(!warned(0.5, "[1.0]", [0.0, 0.5], "riemann-liouville"));
}

/// A scenario that begins at t = 1, with a past of three steps and gyroscopic forces.
const LATER: &str = r#"
[system]
mass = [1.0, 1.0]
gyroscopic = [[0.0, -0.5], [0.5, 0.0]]
[[system.damping]]
order = 0.5
coefficient = [0.1, 0.2]
[initial]
position = [0.3, 0.0]
past = [[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]]
[time]
start = 1.0
step = 0.25
end = 3.0
"#;

#[test]
fn a_start_a_past_and_a_gyroscopic_matrix_are_read_and_written() {
    let scenario = read(LATER).unwrap();
    assert_eq!((scenario.time.steps, scenario.time.time(0), scenario.time.time(8)), (8, 1.0, 3.0));
    assert_eq!((scenario.time.index_of(1.5), scenario.time.first_step_from(1.1)), (Some(2), 1));
    assert_eq!((scenario.samples(), scenario.initial.base()), (12, &[0.0, 0.0][..]));
    let past = scenario.initial.past.as_ref().unwrap();
    assert_eq!((past.steps(), past.end(0), past.end(2)), (3, Some(&[0.1, 0.0][..]), None));
    assert!(past.nodes(1).is_empty());
    assert_eq!(scenario.system.gyroscopic.as_ref().unwrap().entries(), [(0, 1, -0.5), (1, 0, 0.5)]);
    let value = serde_json::to_value(&scenario).unwrap();
    assert_eq!(value["time"]["start"], 1.0);
    let again = Scenario::from_value(&scenario).unwrap();
    assert_eq!(serde_json::to_value(&again).unwrap(), value);
    // A run that begins at zero does not serialise these keys.
    let value = serde_json::to_value(read(GOOD).unwrap()).unwrap();
    assert!(value["time"].get("start").is_none() && value["initial"].get("past").is_none());
    // With two nodes a step of the past has three rows.
    let nodes = LATER.replacen("[time]", "[scheme]\nkind = \"galerkin\"\ndegree = 2\n[time]", 1);
    let past = read(&nodes).unwrap().initial.past.unwrap();
    assert_eq!((past.steps(), past.nodes(0)), (1, &[0.1, 0.0, 0.2, 0.0][..]));
}

#[test]
fn what_does_not_go_with_a_start_a_past_or_a_gyroscopic_matrix_is_refused() {
    let cases = [
        ("start = 1.0", "start = -1.0", "time.start", "a start ≥ 0"),
        ("end = 3.0", "end = 0.5", "time.end", "an end ≥ `start`"),
        ("end = 3.0", "end = 3.1", "time.end", "such as 3 or 3.25"),
        ("[[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]]", "[[0.0], [0.1]]", "initial.past", "rows of 2 numbers"),
        ("[[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]]", "[]", "initial.past", "one row at least"),
        (
            "[time]",
            "[scheme]\nkind = \"galerkin\"\ndegree = 3\n[time]",
            "initial.past",
            "4 rows for each step",
        ),
        (
            "[time]",
            "[convolution]\nstarting = [0.5]\nat = \"main-nodes\"\n[time]",
            "convolution.starting",
            "no starting",
        ),
        ("[time]", "[input]\nsamples = [[1.0, 0.0]]\nperiod = 0.25\n[time]", "input", "[[system.load]]"),
        ("[[0.0, -0.5], [0.5, 0.0]]", "[[0.0, -0.5], [0.4, 0.0]]", "system.gyroscopic", "(0, 1) is -0.5"),
        ("[[0.0, -0.5], [0.5, 0.0]]", "[[0.1, -0.5], [0.5, 0.0]]", "system.gyroscopic", "(0, 0) is 0.1"),
        ("[[0.0, -0.5], [0.5, 0.0]]", "[[0.0, -0.5]]", "system.gyroscopic", "2 rows of 2"),
        ("[time]", "[convolution]\nat = \"main-nodes\"\n[time]", "convolution.at", "\"nodes\""),
        ("[time]", "[scheme]\nkind = \"implicit-euler\"\n[time]", "scheme", "Gauss points"),
        ("[time]", "[output]\ntimes = [0.5]\n[time]", "output.times", "times from 1 to the end"),
    ];
    for (passage, replacement, key, words) in cases {
        assert!(LATER.contains(passage), "{passage}");
        let error = read(&LATER.replacen(passage, replacement, 1)).unwrap_err();
        let told = format!("{error}; {}", error.problem().allowed().unwrap_or_default());
        assert_eq!(error.key(), key, "{replacement}: {told}");
        assert!(told.contains(words), "{replacement}: {told}");
    }
}
