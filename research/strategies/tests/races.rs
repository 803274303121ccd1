//! Races as a user runs them: who is measured, who is found out, what is written.

use fvi_core::Stateful;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fvi_rivals::PlainSum;
use fvi_strategies::fvi_core::{Memory, MemoryError};
use fvi_strategies::{BuiltStrategy, Kind, Lab, LabError, Strategy, Summary};

const SHORT: &str = "lengths = [200]\nrounds = [2, 3]\nseconds = 0.2\n";
const PROGRAM: &str = "[[program]]\nname = \"p\"\ncommand = [\"true\"]\n";
const ROOT: &str = "[[kernel]]\nname = \"root\"\norder = 0.5\n";

fn race(lab: &Lab, directory: &Path, text: &str) -> Result<Summary, LabError> {
    let file = directory.join("race.toml");
    fs::write(&file, text).unwrap();
    lab.run(&file, &directory.join("out"))
}

/// A plain sum that goes wrong in one way or another.
#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    Wrong,
    NotANumber,
    Panics,
    Hangs,
    Refuses,
    /// Does nothing any more when a signal comes that it has heard before.
    Shirks,
}

struct Faulty {
    weights: Vec<f64>,
    samples: Vec<f64>,
    fault: Fault,
    /// First two samples of each signal so far.
    heard: Vec<Vec<f64>>,
    knows: bool,
}

impl Memory<f64> for Faulty {
    fn channels(&self) -> usize {
        1
    }

    fn leading(&self) -> &[f64] {
        &self.weights[..1]
    }

    fn len(&self) -> usize {
        self.samples.len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        if self.fault == Fault::Shirks && self.knows {
            term[0] = 0.0;
            return Ok(());
        }
        let pairs = self.samples.iter().rev().zip(&self.weights[1..]);
        term[0] = pairs.map(|(sample, weight)| sample * weight).sum();
        if self.samples.len() == 150 {
            match self.fault {
                Fault::None | Fault::Shirks => {}
                Fault::Wrong => term[0] *= 1.001,
                Fault::NotANumber => term[0] = f64::NAN,
                Fault::Panics => panic!("out of luck"),
                Fault::Hangs => std::thread::sleep(std::time::Duration::from_secs(3600)),
                Fault::Refuses => return Err(MemoryError::Full { capacity: 150 }),
            }
        }
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.samples.push(sample[0]);
        if self.samples.len() == 2 {
            self.knows = self.heard.contains(&self.samples);
            self.heard.push(self.samples.clone());
        }
        Ok(())
    }

    fn clear(&mut self) {
        self.knows = false;
        self.samples.clear();
    }

    fn bytes(&self) -> usize {
        8 * (self.weights.len() + self.samples.len())
    }
}

impl Stateful for Faulty {}

fn faulty(name: &str, fault: Fault) -> Strategy {
    Strategy::new(name, "a plain sum", move |task| {
        let (weights, samples, heard) = (task.weights.to_vec(), Vec::new(), Vec::new());
        Ok(BuiltStrategy::memory(Faulty { weights, samples, fault, heard, knows: false }))
    })
}

#[test]
fn a_strategy_that_lies_is_found_out_by_name_and_spoils_no_other() {
    let place = tempfile::tempdir().unwrap();
    let lab = Lab::new()
        .with(faulty("honest", Fault::None))
        .with(faulty("wrong", Fault::Wrong))
        .with(faulty("not-a-number", Fault::NotANumber))
        .with(faulty("panics", Fault::Panics))
        .with(faulty("hangs", Fault::Hangs))
        .with(faulty("refuses", Fault::Refuses))
        .with(faulty("shirks", Fault::Shirks))
        .with(Strategy::new("unmade", "", |_| Err("no memory".parse::<f64>().unwrap_err().into())));
    let text = format!("{SHORT}time_limit = 5.0\n{ROOT}");
    let summary = race(&lab, place.path(), &text).unwrap();
    let reason = |name: &str| {
        let found: Vec<_> = summary.found_out.iter().filter(|found| found.strategy == name).collect();
        assert!(found.len() == 1 && found[0].race.starts_with("root, 200 steps"), "{name}: {found:?}");
        found[0].reason.clone()
    };
    assert!(reason("wrong").contains("its error is 1.0e-3"), "{}", reason("wrong"));
    assert!(reason("not-a-number").contains("term of step 150 is NaN"), "{}", reason("not-a-number"));
    assert!(reason("panics").contains("out of luck"), "{}", reason("panics"));
    assert!(reason("hangs").contains("no answer within 5.000 s"), "{}", reason("hangs"));
    assert!(reason("refuses").contains("step 150: the memory is full"), "{}", reason("refuses"));
    assert!(reason("shirks").contains("while it is timed its last term is 0e0"), "{}", reason("shirks"));
    assert!(reason("unmade").contains("invalid float"), "{}", reason("unmade"));
    assert_eq!(summary.found_out.len(), 7, "{:?}", summary.found_out);
    let said = summary.to_string();
    assert!(said.contains("found out: \"hangs\": no answer"), "{said}");
    let race = &summary.record.races[0];
    let row = |name: &str| race.rows.iter().find(|row| row.strategy == name);
    assert!(row("honest").unwrap().within && !row("wrong").unwrap().within);
    assert!(row("hangs").is_none() && row("panics").is_none() && row("not-a-number").is_none());
    assert!(row("shirks").is_none());
    for name in ["direct", "block-fft", "real-time", "exponential-sum", "naive", "gardner", "jiang"] {
        assert!(row(name).unwrap().within, "{name} was spoilt");
    }
    let page = fs::read_to_string(place.path().join("out/strategies.html")).unwrap();
    assert!(page.contains("out of luck") && page.contains("no answer within 5.000 s"));
}

fn unit_of(row: &csv::StringRecord) -> f64 {
    if &row[4] == "f64" { 2f64.powi(-53) } else { 2f64.powi(-24) }
}

fn allowed_by(row: &csv::StringRecord) -> f64 {
    row[5].parse::<f64>().unwrap().max(16.0 * unit_of(row))
}

#[test]
fn every_strategy_is_measured_and_the_table_has_its_columns() {
    let place = tempfile::tempdir().unwrap();
    let text = "lengths = [64, 300]\nchannels = [1, 3]\nprecisions = [\"f64\", \"f32\"]\ntolerances = [1e-4, 1e-10]\n\
                rounds = [2, 2]\n[[kernel]]\nname = \"root, \\\"half\\\"\"\nform = \"power\"\norder = 0.5\n";
    let summary = race(&Lab::new(), place.path(), text).unwrap();
    assert_eq!((summary.races, summary.record.races.len()), (16, 16));
    let table = fs::read_to_string(place.path().join("out/strategies.csv")).unwrap();
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let columns = "strategy,kernel,length,channels,precision,tolerance,error_u,mean_ns,p50_ns,p999_ns,worst_ns,setup_ns,total_ns,break_even,bytes,flops";
    assert_eq!(table.lines().next(), Some(columns));
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    // In double precision all, in single precision the project's own; `tiled` is for one channel.
    assert_eq!(rows.len(), 8 * 18 + 4 + 8 * 5 + 4);
    for row in &rows {
        assert_eq!(&row[1], "root, \"half\"");
        // Beyond the tolerance nothing pays.
        assert_eq!(
            row[13].is_empty(),
            row[6].parse::<f64>().unwrap() * unit_of(row) > allowed_by(row),
            "{row:?}"
        );
        for column in (5..15).filter(|&column| !row[column].is_empty()) {
            let number: f64 = row[column].parse().unwrap();
            assert!(number.is_finite() && number >= 0.0, "{row:?}");
        }
        let (error, unit, allowed) = (row[6].parse::<f64>().unwrap(), unit_of(row), allowed_by(row));
        // A run and its construction, in the rounds between whose numbers the medians lie.
        let [mean, setup, total]: [f64; 3] = [7, 11, 12].map(|column| row[column].parse().unwrap());
        let sum = setup + mean * row[2].parse::<f64>().unwrap();
        assert!((total - sum).abs() <= 1e-3 * sum + 1.0, "{row:?}");
        let bound = !["short-memory", "oustaloup", "matsuda", "any-step"].contains(&&row[0]);
        assert!(!bound || error * unit <= allowed, "{row:?}");
        assert!(row[7].parse::<f64>().unwrap() > 0.0 && row[14].parse::<f64>().unwrap() > 100.0, "{row:?}");
    }
    assert!(summary.found_out.is_empty(), "{:?}", summary.found_out);
    // The page needs nothing from elsewhere.
    let page = fs::read_to_string(place.path().join("out/strategies.html")).unwrap();
    for word in ["<script", "http://", "https://", "src=", "href=", "NaN"] {
        assert!(!page.contains(word), "{word}");
    }
    for word in
        ["fastest is", "Pareto fronts", "Cost against length", "<svg", "root, &quot;half&quot;", "rustc"]
    {
        assert!(page.contains(word), "{word}");
    }
    // Each of its pictures is a file, too: growth of eight families, five views of eight fronts.
    let pictures: Vec<_> =
        fs::read_dir(place.path().join("out/pictures")).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!((pictures.len(), page.matches("<svg").count()), (8 + 5 * 8, 8 + 5 * 8));
    let front = place.path().join("out/pictures/error-time-root---half---300-steps--3-channels--f32.svg");
    assert!(pictures.contains(&front), "{pictures:?}");
    for picture in &pictures {
        let picture = fs::read_to_string(picture).unwrap();
        assert!(picture.starts_with("<svg xmlns=") && picture.ends_with("</svg>\n"), "{picture}");
    }
}

#[test]
fn a_race_that_was_stopped_keeps_what_was_measured_and_goes_on() {
    let place = tempfile::tempdir().unwrap();
    let (file, out) = (place.path().join("race.toml"), place.path().join("out"));
    fs::write(&file, format!("lengths = [50, 60, 70]\nstrategies = [\"naive\"]\nrounds = [2, 2]\n{ROOT}"))
        .unwrap();
    let lab = Lab::new();
    let plan = lab.plan(&file).unwrap();
    let stop = AtomicBool::new(false);
    let summary =
        lab.race(&plan, &out, false, &stop, &mut |done, _| stop.store(done == 1, Ordering::Relaxed));
    let stopped = summary.unwrap();
    assert_eq!((stopped.done, stopped.record.races.len(), stopped.races), (0, 1, 3));
    assert_eq!(fs::read_to_string(out.join("strategies.csv")).unwrap().lines().count(), 2);
    let mut begun = Vec::new();
    let resume = |begun: &mut Vec<usize>| {
        lab.race(&plan, &out, true, &AtomicBool::new(false), &mut |done, needed| {
            if done < needed {
                begun.push(done);
            }
        })
    };
    let all = resume(&mut begun).unwrap();
    // The first round of the two others, then the second one of all.
    assert_eq!((&*begun, all.done, all.record.races.len()), (&[1, 2, 3, 4, 5][..], 3, 3));
    let rounds = |summary: &Summary| summary.record.races[0].rows[0].rounds_ns.clone();
    assert_eq!((rounds(&stopped).len(), rounds(&all).len()), (1, 2));
    assert_eq!(rounds(&all)[0], rounds(&stopped)[0], "what was measured is not measured again");
    begun.clear();
    let again = resume(&mut begun).unwrap();
    assert_eq!((begun, again.record), (vec![], all.record));
    // A record of something else is no beginning.
    fs::write(&file, format!("lengths = [50, 60]\nstrategies = [\"naive\"]\n{ROOT}")).unwrap();
    let other = lab.plan(&file).unwrap();
    let refused = lab.race(&other, &out, true, &AtomicBool::new(false), &mut |_, _| {}).unwrap_err();
    assert!(refused.to_string().contains("another file of strategies"), "{refused}");
    let nothing = lab.race(&other, &place.path().join("new"), true, &AtomicBool::new(false), &mut |_, _| {});
    assert!(nothing.unwrap_err().to_string().contains("nothing to go on from"));
    fs::write(out.join("strategies.json"), "{\"plan\": 3}").unwrap();
    let damaged = lab.race(&other, &out, true, &AtomicBool::new(false), &mut |_, _| {}).unwrap_err();
    assert!(damaged.to_string().contains("no record of strategies"), "{damaged}");
}

#[test]
fn a_stopped_race_does_not_wait_for_a_strategy_that_hangs() {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("race.toml");
    fs::write(&file, format!("lengths = [200]\nstrategies = [\"hangs\"]\n{ROOT}")).unwrap();
    let lab = Lab::new().with(faulty("hangs", Fault::Hangs));
    let (plan, stop) = (lab.plan(&file).unwrap(), AtomicBool::new(false));
    let begin = std::time::Instant::now();
    let summary = std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(std::time::Duration::from_millis(100));
            stop.store(true, Ordering::Relaxed);
        });
        lab.race(&plan, &place.path().join("out"), false, &stop, &mut |_, _| {}).unwrap()
    });
    assert!(begin.elapsed().as_secs() < 20, "the time limit is a minute");
    assert!(summary.found_out.is_empty() && summary.record.races.is_empty(), "{summary}");
    let page = fs::read_to_string(place.path().join("out/strategies.html")).unwrap();
    assert!(page.contains("There are no times yet") && !page.contains("Every median"), "{page}");
}

#[test]
fn a_memory_in_double_precision_sits_out_races_in_single_precision() {
    let place = tempfile::tempdir().unwrap();
    let text = format!(
        "lengths = [20]\nprecisions = [\"f32\"]\nstrategies = [\"mine\", \"direct\"]\nrounds = [1, 1]\n{ROOT}"
    );
    let summary = race(&Lab::new().with(faulty("mine", Fault::None)), place.path(), &text).unwrap();
    let absent = &summary.record.races[0].absent;
    assert!(absent.len() == 1 && absent[0].kind == Kind::SitsOut, "{absent:?}");
    // 16 u of single precision, where the tolerance of 10⁻¹² cannot be kept.
    assert!(summary.to_string().contains("error up to 9.5e-7, rounding: fastest is direct"), "{summary}");
}

#[test]
fn every_one_of_a_few_channels_is_compared() {
    let place = tempfile::tempdir().unwrap();
    let lab = Lab::new().with(Strategy::new("one-wrong", "", |task| {
        let memory = OneWrong(PlainSum::new(&task.weights, task.channels, task.length)?);
        Ok(BuiltStrategy::memory(memory))
    }));
    let text =
        format!("lengths = [20]\nchannels = [5]\nstrategies = [\"one-wrong\"]\nrounds = [1, 1]\n{ROOT}");
    let summary = race(&lab, place.path(), &text).unwrap();
    assert_eq!(summary.found_out.len(), 1, "{summary}");
}

/// A plain sum whose second channel is wrong.
struct OneWrong(PlainSum);

impl Memory<f64> for OneWrong {
    fn channels(&self) -> usize {
        self.0.channels()
    }

    fn leading(&self) -> &[f64] {
        self.0.leading()
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        self.0.next_term(term)?;
        term[1] += 1.0;
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        self.0.push(sample)
    }

    fn clear(&mut self) {
        self.0.clear();
    }

    fn bytes(&self) -> usize {
        self.0.bytes()
    }
}

impl Stateful for OneWrong {}

#[test]
fn results_of_an_earlier_run_are_replaced_pictures_included() {
    let place = tempfile::tempdir().unwrap();
    let text = |length: usize| {
        format!("lengths = [{length}]\nstrategies = [\"naive\"]\nrounds = [1, 1]\n{ROOT}")
            .replace("root", &"r".repeat(300))
    };
    for length in [20, 1] {
        race(&Lab::new(), place.path(), &text(length)).unwrap();
        let names = fs::read_dir(place.path().join("out/pictures")).unwrap();
        let names: Vec<String> =
            names.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        assert_eq!(names.len(), 5, "one front seen in five ways: {names:?}");
    }
}

#[test]
fn a_record_of_other_weights_is_no_beginning() {
    let place = tempfile::tempdir().unwrap();
    let (file, out) = (place.path().join("race.toml"), place.path().join("out"));
    let write = |last: f64| {
        fs::write(place.path().join("w.csv"), format!("n,weight\n0,1\n1,0.5\n2,{last}\n")).unwrap();
    };
    write(0.25);
    let text = "lengths = [3]\nstrategies = [\"naive\"]\nrounds = [1, 1]\n[[kernel]]\nname = \"w\"\nweights = \"w.csv\"\n";
    fs::write(&file, text).unwrap();
    let lab = Lab::new();
    lab.run(&file, &out).unwrap();
    let resume = || lab.race(&lab.plan(&file).unwrap(), &out, true, &AtomicBool::new(false), &mut |_, _| {});
    assert!(resume().is_ok());
    write(0.26);
    assert!(resume().unwrap_err().to_string().contains("another file of strategies"));
    write(0.25);
    assert!(resume().is_ok());
    // Nor is one of another program of the same name.
    fs::write(&file, format!("{text}{PROGRAM}").replace("\"true\"", "\"sh\", \"p.sh\"")).unwrap();
    fs::write(place.path().join("p.sh"), "exit 1").unwrap();
    lab.run(&file, &out).unwrap();
    assert!(resume().is_ok());
    fs::write(place.path().join("p.sh"), "exit 2").unwrap();
    assert!(resume().unwrap_err().to_string().contains("other strategies or programs"));
}

#[test]
fn weights_have_their_own_error_against_the_operator() {
    let place = tempfile::tempdir().unwrap();
    let text = format!(
        "lengths = [1000]\nstrategies = [\"naive\", \"l1\"]\nrounds = [1, 1]\n{ROOT}[[kernel]]\nname = \"random\"\nform = \"random\"\ndecay = 1.0\n\
         [[kernel]]\nname = \"Maxwell\"\nform = \"maxwell\"\norder = 0.6\ntime = 1.0\nstep = 0.01\n"
    );
    let summary = race(&Lab::new(), place.path(), &text).unwrap();
    let of = |race: usize, strategy: &str| {
        let mut rows = summary.record.races[race].rows.iter();
        rows.find(|row| row.strategy == strategy).unwrap().quadrature
    };
    // Grünwald's weights on t², order ½, by Python: 9.13696e-6; L1 has its error of order 2 − β.
    let (grunwald, l1) = (of(0, "naive").unwrap(), of(0, "l1").unwrap());
    assert!((grunwald / 9.136_962_8e-6 - 1.0).abs() < 1e-6, "{grunwald:e}");
    assert!(l1 < 0.1 * grunwald, "{l1:e}");
    assert_eq!(of(1, "naive"), None);
    // An error of the first order: K(d/dt) t² is missed by a part of a step's length over the run's.
    let maxwell = of(2, "naive").unwrap();
    assert!((1e-6..1e-3).contains(&maxwell), "{maxwell:e}");
    let page = fs::read_to_string(place.path().join("out/strategies.html")).unwrap();
    assert!(page.contains("<td>9e-6</td>"));
}

#[test]
fn the_smallest_races_are_run() {
    let place = tempfile::tempdir().unwrap();
    let mut text = "lengths = [1, 2, 3, 17]\nrounds = [1, 1]\ntolerances = [1e-3, 1e-10]\n".to_owned();
    for (name, order) in [("one", 0.0), ("slope", 1.0), ("half", 0.5)] {
        text.push_str(&format!("[[kernel]]\nname = \"{name}\"\norder = {order:?}\n"));
    }
    let summary = race(&Lab::new(), place.path(), &text).unwrap();
    assert_eq!(summary.record.races.len(), 24);
    assert!(summary.found_out.is_empty(), "{:?}", summary.found_out);
    assert!(summary.record.races.iter().all(|race| race.rows.len() >= 8));
}

#[test]
fn kernels_of_every_form_are_raced() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("G.csv"), "t,G\n0,1\n0.5,0.6\n2,0\n").unwrap();
    let weights: Vec<String> = (0..100).map(|n| format!("{n},{}", 0.9f64.powi(n))).collect();
    fs::write(place.path().join("w.csv"), format!("n,weight\n{}\n", weights.join("\n"))).unwrap();
    let forms = [
        "order = 1.3",
        "form = \"power\"\norder = 0.5\nstep = 0.1",
        "kernel = { form = \"power\", order = 0.5 }\nfamily = \"bdf\"\norder = 3\nstep = 0.1",
        "form = \"tempered\"\norder = 0.5\nrate = 0.3",
        "form = \"maxwell\"\norder = 0.6\ntime = 1.0\nstep = 0.01",
        "form = \"havriliak-negami\"\norder = 0.7\npower = 0.5\ntime = 1.0",
        "form = \"prony\"\nstrengths = [1.0, 0.7]\ntimes = [1.0, 0.1]\norder = 2",
        "symbol = \"a*s*(s + 0.1)/((s + 0.1)^2 + 4)\"\norder = 2\nstep = 0.1",
        "relaxation = \"G.csv\"\nstep = 0.1",
        "weights = \"w.csv\"",
        "kernel = { weights = \"w.csv\" }",
        "form = \"random\"\ndecay = 0.8\nseed = 3",
    ];
    let mut text =
        "lengths = [100]\nrounds = [1, 1]\nsignals = [\"stationary\"]\nparameters = { a = 0.5 }\n".to_owned();
    for (index, form) in forms.iter().enumerate() {
        text.push_str(&format!("[[kernel]]\nname = \"k{index}\"\n{form}\n"));
    }
    let summary = race(&Lab::new(), place.path(), &text).unwrap();
    assert_eq!(summary.record.races.len(), forms.len());
    assert!(summary.found_out.is_empty(), "{:?}", summary.found_out);
    for race in &summary.record.races {
        let absent = |name: &str| {
            race.absent.iter().any(|absence| absence.strategy == name && absence.kind == Kind::SitsOut)
        };
        let power = ["k0", "k1", "k2"].contains(&&*race.kernel);
        assert_eq!(absent("oustaloup"), !power, "{}", race.kernel);
        let exact = race.rows.iter().filter(|row| row.error_u < 100.0).count();
        assert!(exact >= 7, "{}: {exact} strategies are exact", race.kernel);
    }
}

#[test]
fn files_that_cannot_be_used_are_refused_with_key_and_value() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("short.csv"), "n,weight\n0,1\n1,0.5\n").unwrap();
    fs::write(place.path().join("gap.csv"), "n,weight\n0,1\n2,0.5\n").unwrap();
    let kernel = |keys: &str| format!("lengths = [100]\n[[kernel]]\nname = \"k\"\n{keys}\n");
    let cases = [
        (format!("length = [10]\n{ROOT}"), "unknown key"),
        (ROOT.to_owned(), "`lengths` is missing"),
        ("lengths = [10]\n".to_owned(), "`kernel` is missing"),
        (format!("lengths = []\n{ROOT}"), "at least one"),
        (format!("lengths = [0]\n{ROOT}"), "from 1 to"),
        (format!("lengths = [10]\ntolerances = [0.0]\n{ROOT}"), "4e-15 ≤ tolerance"),
        (format!("lengths = [16777216]\nchannels = [100]\n{ROOT}"), "samples in a run"),
        (format!("lengths = [10]\nprecisions = [\"f16\"]\n{ROOT}"), "\"f64\", \"f32\""),
        (format!("lengths = [10]\nstrategies = [\"fastest\"]\n{ROOT}"), "\"direct\", \"block-fft\""),
        (format!("lengths = [10]\nrounds = [5, 2]\n{ROOT}"), "the fewest and the most"),
        (format!("lengths = [10]\n{ROOT}{ROOT}"), "no other kernel has"),
        (format!("lengths = [10, 10]\n{ROOT}"), "each entry once"),
        (format!("lengths = [10]\nstrategies = [\"hls\", \"hls\"]\n{ROOT}"), "each entry once"),
        (format!("lengths = [10]\n{ROOT}{PROGRAM}{PROGRAM}"), "no other strategy has"),
        (kernel("order = 2.5"), "0 ≤ β < 2"),
        (kernel("order = 0.5\nfamily = \"radau-iia\""), "\"bdf\""),
        (kernel("order = 0.5\nstep = -1.0"), "a number > 0"),
        (kernel("kernel = { form = \"power\", order = 0.5 }\norder = 7"), "from 1 to 6"),
        (kernel("form = \"maxwell\"\norder = 0.6"), "`time` is missing"),
        (kernel("form = \"maxwell\"\norder = 0.6\ntime = 1.0\ntimes = 2"), "unknown key"),
        (kernel("weights = \"short.csv\""), "at least 100 weights"),
        (kernel("weights = \"gap.csv\""), "n must be 1"),
        (kernel("weights = \"none.csv\""), "cannot be read"),
        (kernel("weights = \"w.csv\"\nform = \"power\""), "unknown key"),
        (
            format!("lengths = [10]\n{ROOT}[[program]]\nname = \"direct\"\ncommand = [\"true\"]\n"),
            "no other strategy has",
        ),
        (
            format!("lengths = [10]\n{ROOT}[[program]]\nname = \"p\"\ncommand = []\n"),
            "the program and its arguments",
        ),
    ];
    for (text, expected) in cases {
        let error = race(&Lab::new(), place.path(), &text).unwrap_err();
        let LabError::Input(error) = error else { panic!("{text}: {error}") };
        let said = format!("{error} {}", error.problem().allowed().unwrap_or_default());
        assert!(said.contains(expected), "{text}\n{said}");
        assert!(error.file().ends_with("race.toml"), "{said}");
        assert!(!place.path().join("out").exists(), "{text}");
    }
    let twice = Lab::new().with(faulty("direct", Fault::None));
    let error = race(&twice, place.path(), &format!("lengths = [10]\n{ROOT}")).unwrap_err();
    assert!(error.to_string().contains("two strategies are named"), "{error}");
}

#[test]
fn long_plain_sums_sit_out() {
    let place = tempfile::tempdir().unwrap();
    let text = format!(
        "lengths = [65536]\nstrategies = [\"direct\", \"naive\", \"gardner\"]\nrounds = [1, 1]\nsignals = [\"constant\"]\n{ROOT}"
    );
    let summary = race(&Lab::new(), place.path(), &text).unwrap();
    let names: Vec<&str> =
        summary.record.races[0].absent.iter().map(|absence| absence.strategy.as_str()).collect();
    assert_eq!(names, ["direct", "naive"]);
    assert!(summary.found_out.is_empty());
}

/// A program of the shell: what it answers to a sample.
#[cfg(unix)]
fn program(name: &str, answer: &str) -> String {
    let script = format!(
        "while read word rest; do case $word in begin) ;; weights) echo ready 16 ;; clear) k=0; echo ok ;; *) k=$((k+1)); {answer} ;; esac; done"
    );
    format!("[[program]]\nname = \"{name}\"\ntime_limit = 5.0\ncommand = [\"sh\", \"-c\", '''{script}''']\n")
}

#[cfg(unix)]
#[test]
fn programs_over_pipes_are_measured_and_found_out() {
    let place = tempfile::tempdir().unwrap();
    // Weights 0, 1 on a signal of tenths: every term but the first is a tenth.
    let kernel = format!("[[kernel]]\nname = \"delay\"\nweights = [0.0, 1.0{}]\n", ", 0.0".repeat(98));
    let mut text = format!("lengths = [100]\nsignals = [\"constant\"]\nrounds = [1, 2]\n{kernel}");
    text.push_str(&program("honest", "echo 0.1"));
    text.push_str(&program("wrong", "echo 0.2"));
    text.push_str(&program("not-a-number", "echo nan"));
    text.push_str(&program("talks", "echo hello"));
    text.push_str(&program("dies", "if [ $k -gt 50 ]; then exit 3; fi; echo 0.1"));
    text.push_str(&program("floods", "head -c 100000 /dev/zero | tr '\\0' x"));
    text.push_str(&program("hangs", "if [ $k -gt 50 ]; then sleep 60; fi; echo 0.1"));
    text.push_str("[[program]]\nname = \"absent\"\ncommand = [\"./there-is-none\"]\n");
    text.push_str("[[program]]\nname = \"declines\"\ncommand = [\"sh\", \"-c\", \"read a; read b; echo declined too short; read c\"]\n");
    let summary = race(&Lab::new(), place.path(), &text).unwrap();
    let reason = |name: &str| {
        let found: Vec<_> = summary.found_out.iter().filter(|found| found.strategy == name).collect();
        assert_eq!(found.len(), 1, "{name}: {:?}", summary.found_out);
        found[0].reason.clone()
    };
    assert!(reason("wrong").contains("its error is 1.0e0"), "{}", reason("wrong"));
    assert!(reason("not-a-number").contains("NaN"), "{}", reason("not-a-number"));
    assert!(reason("talks").contains("`hello` in place of 1 numbers"), "{}", reason("talks"));
    assert!(reason("dies").contains("exit status: 3"), "{}", reason("dies"));
    assert!(reason("hangs").contains("no answer within 5.000 s"), "{}", reason("hangs"));
    assert!(reason("floods").contains("a line of more than 4496 letters"), "{}", reason("floods"));
    assert!(reason("absent").contains("there-is-none"), "{}", reason("absent"));
    assert_eq!(summary.found_out.len(), 7, "{:?}", summary.found_out);
    let race = &summary.record.races[0];
    let honest = race.rows.iter().find(|row| row.strategy == "honest").unwrap();
    assert!(honest.within && honest.error_u == 0.0 && honest.mean_ns > 100.0);
    // It says 16 bytes; what a shell takes is measured, where the system tells.
    if cfg!(target_os = "linux") {
        assert!((100_000..100_000_000).contains(&honest.bytes.unwrap()), "{:?}", honest.bytes);
    } else {
        assert_eq!(honest.bytes, None);
    }
    let declined = race.absent.iter().find(|absence| absence.strategy == "declines").unwrap();
    assert_eq!((declined.kind, declined.reason.as_str()), (Kind::SitsOut, "too short"));
}

#[cfg(unix)]
#[test]
fn a_program_that_leaves_another_one_behind_is_noticed_at_once_and_both_end() {
    let place = tempfile::tempdir().unwrap();
    // The shell exits at once, and the process behind it keeps the pipes open and answers nothing; or it dies
    // in the middle of a run, and that process has none of its pipes.
    let at_once = "sleep 600 & echo $! > left; exit 3";
    let later = "sleep 600 </dev/null >/dev/null 2>&1 & echo $! > left; \
        read a; read b; echo ready; read c; echo ok; read d; echo 0.1; read e; exit 3";
    for script in [at_once, later] {
        let text = format!(
            "lengths = [100]\nstrategies = [\"forks\"]\n{ROOT}[[program]]\nname = \"forks\"\ntime_limit = 500.0\n\
             command = [\"sh\", \"-c\", '''{script}''']\n"
        );
        // It would be the limit of the race, or of the program, that ends it otherwise.
        let summary = race(&Lab::new(), place.path(), &text).unwrap();
        let reason = &summary.found_out[0].reason;
        assert!(reason.contains("it ended in the middle of the race (exit status: 3)"), "{reason}");
        let left = fs::read_to_string(place.path().join("left")).unwrap();
        let is_alive = || {
            let state =
                std::process::Command::new("ps").args(["-o", "stat=", "-p", left.trim()]).output().unwrap();
            let state = String::from_utf8(state.stdout).unwrap();
            !state.trim().is_empty() && !state.trim().starts_with('Z')
        };
        // Two seconds.
        let ends = (0..100).any(|_| {
            std::thread::sleep(Duration::from_millis(20));
            !is_alive()
        });
        assert!(ends, "process {left} lives");
    }
}

#[test]
fn rounds_are_divided_among_the_processes_that_the_file_asks_for() {
    let place = tempfile::tempdir().unwrap();
    let (file, out) = (place.path().join("race.toml"), place.path().join("out"));
    let text = format!(
        "lengths = [64]\nstrategies = [\"direct\", \"hls\"]\nrounds = [5, 5]\nprocesses = 3\nsignals = [\"stationary\"]\n{ROOT}"
    );
    fs::write(&file, &text).unwrap();
    // All in this process would be something else than what is asked for.
    let refused = Lab::new().run(&file, &out).unwrap_err().to_string();
    assert!(refused.contains("`processes = 3`"), "{refused}");
    let mut rounds = Vec::new();
    for process in 0..3 {
        let lab = Lab::new().in_process(process);
        let plan = lab.plan(&file).unwrap();
        assert_eq!(plan.processes(), 3);
        let stop = AtomicBool::new(false);
        let summary = lab.race(&plan, &out, process > 0, &stop, &mut |_, _| {}).unwrap();
        let race = &summary.record.races[0];
        rounds.push(race.rounds);
        assert_eq!(summary.done, usize::from(process == 2));
        assert_eq!(race.parts, [2, 2, 1][..=process]);
        assert!(race.rows.iter().all(|row| row.rounds_ns.len() == race.rounds));
    }
    assert_eq!(rounds, [2, 4, 5]);
    let lab = Lab::new().in_process(3);
    let plan = lab.plan(&file).unwrap();
    assert!(lab.race(&plan, &out, true, &AtomicBool::new(false), &mut |_, _| {}).is_err());
    fs::write(&file, text.replace("processes = 3", "processes = 6")).unwrap();
    let refused = Lab::new().run(&file, &out).unwrap_err().to_string();
    assert!(refused.contains("race.toml:4:13: processes = 6"), "{refused}");
}

#[cfg(unix)]
#[test]
fn a_program_does_not_outlive_the_time_limit_of_the_race() {
    let place = tempfile::tempdir().unwrap();
    // Its own limit of an answer is longer.
    let text = format!(
        "lengths = [100]\nstrategies = [\"lingers\"]\ntime_limit = 1.0\n{ROOT}[[program]]\nname = \"lingers\"\ncommand = [\"sh\", \"-c\", \"echo $$ > process; sleep 60\"]\n"
    );
    let summary = race(&Lab::new(), place.path(), &text).unwrap();
    assert!(summary.found_out[0].reason.contains("no answer within 1.000 s, the time limit"), "{summary}");
    let process = fs::read_to_string(place.path().join("process")).unwrap();
    let lives = std::process::Command::new("kill").args(["-0", process.trim()]).output().unwrap();
    assert!(!lives.status.success(), "process {process} lives");
}
