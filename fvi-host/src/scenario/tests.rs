use super::*;

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

/// The good scenario with one passage replaced, and what is said about it: (key, line of the file, message).
fn refused(passage: &str, replacement: &str) -> (String, usize, String) {
    assert!(GOOD.contains(passage), "{passage}");
    let error = read(&GOOD.replacen(passage, replacement, 1)).unwrap_err();
    (error.key().to_owned(), error.line().unwrap(), error.to_string())
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
    assert_eq!(scenario.time, TimeGrid { step: 0.1, steps: 300, allow_unstable: false });
    assert_eq!(scenario.history.engine, Some(Engine::Direct));
    assert_eq!(scenario.history.capacity, Some(64));
    assert_eq!(scenario.history.overflow, Overflow::Forget);
    assert_eq!(scenario.output.every, 10);
    let orders: Vec<_> = scenario.system.damping.iter().map(|term| (term.order, term.derivative)).collect();
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
    assert_eq!(record["scheme"]["kappa"], 0.5);
    assert_eq!(record["convolution"]["family"], "bdf");
    assert_eq!(record["system"]["potential"], "0.5*k*q0^2 + cos(q1)");
    assert_eq!(record["system"]["mass"][0][1], 0.5);
    assert_eq!(record["system"]["damping"][1]["derivative"], "riemann-liouville");
    assert_eq!(record["time"]["steps"], 300);
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
        ("[[2.0, 0.5], [0.5, 1.0]]", "[2.0, 0.0]", "system.mass", 4, "not positive definite"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[2.0, nan]", "system.mass[1]", 4, "not allowed"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[[2.0, 0.5], [0.5]]", "system.mass[1]", 4, "1 entries instead of 2"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "2.0", "system.mass", 4, "a number instead of a list"),
        ("[[2.0, 0.5], [0.5, 1.0]]", "[1.0, 1, 1, 1, 1, 1, 1, 1, 1]", "system.mass", 4, "9 coordinates"),
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
        ("velocity = [1.0, -1.0]", "", "initial", 15, "`momentum` or `velocity` is missing"),
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
    assert_eq!(help, "did you mean `capacity`? Keys here: engine, tolerance, horizon, capacity, overflow");
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
