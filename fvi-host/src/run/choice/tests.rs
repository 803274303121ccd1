//! Ten problems at three tolerances, each against another method or a closed form.

use super::*;
use fvi_scenario::scenario::Feature;
use std::convert::Infallible;

/// Steps of the reference where nothing forbids steps that differ: an error per step near rounding.
const ADAPTIVE: &str = "scheme = { kind = \"collocation\" }\ntime = { end = END, tolerance = 1e-12 }\n";

struct Case {
    name: &'static str,
    /// Tables of the scenario but those of schemes and times.
    tables: &'static str,
    end: f64,
    /// Time between rows.
    spacing: f64,
    /// Scheme and grid of the reference, with `END` in place of the end.
    reference: &'static str,
    /// The smallest tolerance of three that is reached.
    reaches: f64,
}

const CASES: [Case; 10] = [
    Case {
        name: "oscillator",
        tables: "[system]\nmass = [1.0]\npotential = '2*q0^2'\ndamping = [{ order = 0.5, coefficient = [0.2] }]\n[initial]\nposition = [1.0]\n",
        end: 20.0,
        spacing: 0.5,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "pendulum",
        tables: "[system]\nmass = [0.25]\npotential = '4.905*(1 - cos(q0))'\ndamping = [{ order = 0.6, coefficient = [0.12] }]\n[initial]\nposition = [2.0]\n",
        end: 10.0,
        spacing: 0.25,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "plate in a fluid, with a jump of the force",
        tables: "[system]\nmass = [1.0]\npotential = '0.5*q0^2'\nforce = ['8*(1 - step(t - 1))']\ndamping = [{ order = 1.5, coefficient = [0.5] }]\n[initial]\nposition = [0.0]\n",
        end: 20.0,
        spacing: 0.5,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "stiff Zener solid",
        tables: "[system]\nmass = [1.0]\npotential = '0.5*q0^2'\ndamping = [{ kernel = { form = 'maxwell', order = 0.6, time = 0.001 }, coefficient = [1000.0] }]\n[initial]\nposition = [1.0]\n",
        end: 10.0,
        spacing: 0.25,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "chain",
        tables: "[system]\nmass = [1.0, 1.0, 1.0]\nstiffness = [[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]]\nforce = ['-0.1*q0^3', '0', '0']\ndamping = [{ order = 0.4, coefficient = [[0.2, -0.1, 0.0], [-0.1, 0.2, -0.1], [0.0, -0.1, 0.2]] }]\n[initial]\nposition = [1.0, 0.0, 0.0]\n",
        end: 20.0,
        spacing: 0.5,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "controlled stage",
        tables: "[system]\nmass = [1.0]\npotential = '2*q0^2'\ndamping = [{ order = 0.5, coefficient = [0.4] }]\n[initial]\nposition = [0.0]\n[controller]\nmeasures = 'q0'\nsetpoint = '1'\ndrives = [1.0]\nkp = 3.0\nki = 1.0\nlambda = 0.9\nsample = 0.02\n",
        end: 1.0,
        spacing: 0.02,
        reference: "scheme = { kind = \"galerkin\", degree = 3 }\nconvolution = { order = 5 }\ntime = { end = END, step = 0.0002 }\n",
        reaches: 1e-7,
    },
    Case {
        name: "wall",
        tables: "[system]\nmass = [1.0]\npotential = '0.5*q0^2 + 50*max(q0 - 0.8, 0)^2'\ndamping = [{ order = 0.5, coefficient = [0.1] }]\n[initial]\nposition = [0.0]\nvelocity = [2.0]\n",
        end: 5.0,
        spacing: 0.25,
        reference: ADAPTIVE,
        reaches: 1e-7,
    },
    Case {
        name: "forced",
        tables: "[system]\nmass = [1.0]\npotential = '0.5*q0^2 + 0.1*q0^4'\nforce = ['sin(2*t)']\ndamping = [{ order = 0.7, coefficient = [0.3] }]\n[initial]\nposition = [0.0]\n",
        end: 20.0,
        spacing: 0.5,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "creep over decades",
        tables: "[system]\nmass = [1.0]\npotential = '0.5*q0^2'\nforce = ['1']\ndamping = [{ order = 0.3, coefficient = [2.0] }]\n[initial]\nposition = [0.0]\n",
        end: 1e4,
        spacing: 100.0,
        reference: ADAPTIVE,
        reaches: 1e-10,
    },
    Case {
        name: "floating body",
        tables: "[system]\nmass = [1.0]\npotential = '2*q0^2'\ndamping = [{ kernel = { symbol = '2*s*(s + 0.5)/((s + 0.5)^2 + 4)' }, coefficient = [0.5] }]\n[initial]\nposition = [1.0]\n",
        end: 20.0,
        spacing: 0.25,
        reference: "scheme = { kind = \"galerkin\", degree = 3 }\nconvolution = { order = 6 }\ntime = { end = END, step = 0.002 }\n",
        reaches: 1e-10,
    },
];

fn scenario(text: &str) -> Scenario {
    text.parse().unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn chosen(scenario: &Scenario) -> Result<Chosen, RunError> {
    choose(scenario, Precision::F64, &Tables::default(), &AtomicBool::new(false))
}

/// The rows of the trajectory.
fn rows(scenario: &Scenario) -> Rows {
    let mut rows = Rows::for_run(scenario);
    let mut run = Run::of(scenario).start().unwrap();
    let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
        portion.keep(std::slice::from_mut(&mut rows));
        Ok::<_, Infallible>(())
    });
    assert_eq!(end, RunEnd::Completed);
    rows
}

impl Case {
    fn asked(&self, tolerance: f64) -> Scenario {
        let Self { tables, end, spacing, .. } = self;
        scenario(&format!(
            "scheme = {{ kind = 'auto', tolerance = {tolerance:e} }}\ntime = {{ end = {end:?}, step = {spacing:?} }}\n{tables}"
        ))
    }

    fn exact(&self) -> Rows {
        let Self { tables, end, spacing, reference, .. } = self;
        let count = (end / spacing).round() as usize;
        let times: Vec<f64> = (0..count).map(|row| row as f64 * spacing).chain([*end]).collect();
        let reference = match reference.contains("tolerance") {
            // Grid points at the rows, whose states are more accurate than those between.
            true => reference.replace("tolerance", &format!("must_hit = {:?}, tolerance", &times[1..count])),
            false => (*reference).to_owned(),
        };
        let reference = reference.replace("END", &format!("{end:?}"));
        rows(&scenario(&format!("{reference}output = {{ times = {times:?} }}\n{tables}")))
    }
}

#[test]
fn ten_problems_reach_their_tolerance_or_are_refused() {
    for case in &CASES {
        let exact = case.exact();
        for tolerance in [1e-4, 1e-7, 1e-10] {
            let name = case.name;
            let found = chosen(&case.asked(tolerance));
            if let Err(error) = &found
                && tolerance < case.reaches
            {
                assert!(error.to_string().contains("scheme.tolerance"), "{name}: {error}");
                continue;
            }
            let Chosen { scenario, choice } = found.unwrap_or_else(|error| panic!("{name}: {error}"));
            let found = rows(&scenario);
            assert_eq!(found.len(), exact.len(), "{name}");
            // The reference has an error of some 10⁻¹¹ itself.
            let error = difference(&exact, &found, true).unwrap();
            assert!(error <= tolerance + 3e-11, "{name} to {tolerance:e}: {error:.1e}, {choice:?}");
        }
    }
}

#[test]
fn an_undamped_oscillation_has_the_error_that_was_told() {
    let text = "[system]\nmass = [1.0]\npotential = '2*q0^2'\n[initial]\nposition = [1.0]\n[scheme]\nkind = 'auto'\ntolerance = 1e-8\n[time]\nend = 50.0\n";
    let Chosen { scenario, choice } = chosen(&scenario(text)).unwrap();
    let rows = rows(&scenario);
    let error = rows.time.iter().zip(&rows.position).map(|(t, q)| (q - libm::cos(2.0 * t)).abs());
    let error = error.fold(0.0, max_or_nan);
    assert!(error <= 1e-8, "{error:.1e}");
    assert!((0.3..3.0).contains(&(error / choice.estimated_error)), "{error:.1e}: {choice:?}");
}

/// The force acts for a thousandth of the time only, and everything rests before: steps that do not look
/// for it agree that nothing moves.
#[test]
fn a_short_push_is_not_overlooked() {
    for push in ["1000*(step(t - 7.003) - step(t - 7.004))", "1000*exp(-((t - 7.0031)/0.0005)^2)"] {
        let tables = format!(
            "[system]\nmass = [1.0]\npotential = '2*q0^2'\nforce = ['{push}']\ndamping = [{{ order = 0.5, coefficient = [0.2] }}]\n[initial]\nposition = [0.0]\n"
        );
        let asked = format!(
            "scheme = {{ kind = 'auto', tolerance = 1e-5 }}\ntime = {{ end = 10.0, step = 0.5 }}\n{tables}"
        );
        let Chosen { scenario: found, .. } = chosen(&scenario(&asked)).unwrap();
        let exact = format!(
            "scheme = {{ kind = 'collocation' }}\ntime = {{ grid = 'points', points = [{}] }}\noutput = {{ every = 1000 }}\n{tables}",
            (0..=20000).map(|k| format!("{:?}", k as f64 / 2000.0)).collect::<Vec<_>>().join(", ")
        );
        let (found, exact) = (rows(&found), rows(&scenario(&exact)));
        let error = difference(&exact, &found, true).unwrap();
        assert!(error <= 1e-5, "{push}: {error:.1e}");
    }
}

/// The first rows of steps of one length have errors that are thousands of times those of the others.
#[test]
fn the_first_grid_points_of_a_singular_start_are_within_the_tolerance() {
    let tables = "[system]\nmass = [1.0]\npotential = '0.5*q0^2 + 0.25*q0^4'\ndamping = [{ order = 0.8, coefficient = [0.042] }]\n[initial]\nposition = [1.0]\nvelocity = [1.0]\n";
    let asked = format!("scheme = {{ kind = 'auto', tolerance = 1e-9 }}\ntime = {{ end = 60.0 }}\n{tables}");
    let Chosen { scenario: found, choice } = chosen(&scenario(&asked)).unwrap();
    let found = rows(&found);
    let times: Vec<f64> = found.time.iter().copied().filter(|&time| time > 0.0).take(8).collect();
    let exact = format!(
        "scheme = {{ kind = 'collocation' }}\nconvolution = {{ family = 'radau-iia', stages = 7 }}\noutput = {{ times = {times:?} }}\n\
         time = {{ end = {:?}, tolerance = 1e-12, must_hit = {:?} }}\n{tables}",
        times[7],
        &times[..7]
    );
    // Both motions reach about 1.4 and 1.5 later.
    let exact = rows(&scenario(&exact));
    let error = difference(&exact, &found, true).unwrap();
    assert!(error <= 1e-9, "{error:.1e}: {choice:?}");
}

/// Where in a step the position meets the kink is the same for steps twice as short, again and again, so that
/// such runs agree to ten digits and are wrong in the third.
#[test]
fn runs_that_agree_by_chance_at_a_kink_are_not_taken_for_exact() {
    let tables = "[system]\nmass = [1.0]\npotential = '0.5*q0^2 + 20*abs(q0 - 0.5)'\nforce = ['exp(-t)']\ndamping = [{ order = 0.1, coefficient = [0.0148] }]\n[initial]\nposition = [1.0]\n";
    let exact = format!(
        "scheme = {{ kind = 'collocation' }}\nconvolution = {{ family = 'radau-iia', stages = 7 }}\noutput = {{ times = [0.2, 0.4, 0.6, 0.8, 1.0] }}\n\
         time = {{ end = 1.0, tolerance = 1e-11, must_hit = [0.2, 0.4, 0.6, 0.8] }}\n{tables}"
    );
    let exact = rows(&scenario(&exact));
    for spacing in ["0.05", "0.2"] {
        let asked = format!(
            "scheme = {{ kind = 'auto', tolerance = 1e-4 }}\ntime = {{ end = 1.0, step = {spacing} }}\n{tables}"
        );
        match chosen(&scenario(&asked)) {
            Ok(Chosen { scenario: found, choice }) => {
                let error = difference(&exact, &rows(&found), true).unwrap();
                assert!(error <= 1e-4, "{error:.1e}: {choice:?}");
            }
            Err(error) => assert!(error.to_string().contains("scheme.tolerance"), "{error}"),
        }
    }
}

#[test]
fn a_tolerance_that_rounding_forbids_is_refused_with_what_is_reachable() {
    let text = "[system]\nmass = [1.0]\npotential = '2*q0^2'\n[initial]\nposition = [1.0]\n[scheme]\nkind = 'auto'\ntolerance = 1e-10\n[time]\nend = 50.0\n";
    let scenario = scenario(text);
    let (tables, stop) = (Tables::default(), AtomicBool::new(false));
    let error = choose(&scenario, Precision::F32, &tables, &stop).unwrap_err().to_string();
    assert!(error.contains("scheme.tolerance = 1e-10"), "{error}");
    stop.store(true, std::sync::atomic::Ordering::Relaxed);
    assert!(matches!(choose(&scenario, Precision::F64, &tables, &stop), Err(RunError::Stopped)));
}

#[test]
fn a_motion_that_ends_or_a_force_without_impulse_is_refused_for_that_reason() {
    for (system, told) in
        [("potential = '-q0^4'", "scheme.kind"), ("potential = '2*q0^2'\nforce = ['1/t']", "no impulse")]
    {
        let text = format!(
            "[system]\nmass = [1.0]\n{system}\n[initial]\nposition = [1.0]\n[scheme]\nkind = 'auto'\ntolerance = 1e-5\n[time]\nend = 10.0\n"
        );
        let error = chosen(&scenario(&text)).unwrap_err().to_string();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn the_choice_is_the_same_every_time_and_an_ordinary_scenario() {
    let asked = CASES[1].asked(1e-6);
    let (one, other) = (chosen(&asked).unwrap(), chosen(&asked).unwrap());
    assert_eq!(one.choice, other.choice);
    assert_eq!(rows(&one.scenario), rows(&other.scenario));
    // What its record says is the scenario that ran.
    let read = Scenario::from_value(&one.scenario).unwrap();
    assert!(!Feature::Automatic.is_in(&read));
    assert_eq!(rows(&read), rows(&one.scenario));
}

#[test]
fn keys_that_contradict_the_choice_are_refused_by_name() {
    let base = "[system]\nmass = [1.0]\n[initial]\nposition = [1.0]\n";
    for (rest, told) in [
        ("[scheme]\nkind = 'auto'\n[time]\nend = 1.0\n", "tolerance"),
        ("[scheme]\nkind = 'auto'\ntolerance = 0.0\n[time]\nend = 1.0\n", "scheme.tolerance = 0.0"),
        ("[scheme]\nkind = 'auto'\ntolerance = 1e-6\ndegree = 2\n[time]\nend = 1.0\n", "scheme.degree"),
        (
            "[scheme]\nkind = 'auto'\ntolerance = 1e-6\n[convolution]\norder = 2\n[time]\nend = 1.0\n",
            "convolution",
        ),
        (
            "[scheme]\nkind = 'auto'\ntolerance = 1e-6\n[time]\nend = 1.0\ntolerance = 1e-3\n",
            "time.tolerance",
        ),
        ("[scheme]\nkind = 'auto'\ntolerance = 1e-6\n[time]\nsteps = 10\n", "time.steps"),
        ("[scheme]\nkind = 'auto'\ntolerance = 1e-6\n[time]\nend = 1.0\nstep = 0.3\n", "time.end"),
        ("[scheme]\nkind = 'auto'\ntolerance = 1e-6\n[time]\nend = 0.0\n", "time.end"),
    ] {
        let error = format!("{base}{rest}").parse::<Scenario>().unwrap_err().to_string();
        assert!(error.contains(told), "{rest}: {error}");
    }
    let asked = format!("{base}[scheme]\nkind = 'auto'\ntolerance = 1e-6\n[time]\nend = 1.0\n");
    let asked = scenario(&asked);
    let error = Run::of(&asked).start().err().unwrap().to_string();
    assert!(error.contains("scheme.kind") && error.contains("a motion"), "{error}");
    for used in [Feature::Sweep, Feature::Fit, Feature::Converge, Feature::Response, Feature::AnotherEnd] {
        assert!(asked.check_use(used).is_err(), "{used:?}");
    }
}
