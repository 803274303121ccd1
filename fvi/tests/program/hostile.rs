//! Every command with every kind of input that asks for more than there is, under limits on memory: it may be
//! refused, fail or go on, but neither abort nor panic.

use crate::workplace::{Workplace, text};
use std::fs;
use std::io::Write;
use std::os::unix::fs::symlink;
use std::os::unix::process::ExitStatusExt;
use std::process::Output;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

const FREE: &str = "[system]\nmass = [1.0]\n[initial]\nposition = [0.0]\n[time]\nstep = 0.1\nsteps = 3\n";

/// Commands that read a document, in place of which stands `FILE`.
const OF_DOCUMENTS: [&str; 12] = [
    "run FILE",
    "sweep FILE",
    "converge FILE",
    "fit FILE",
    "response FILE",
    "tune FILE",
    "extremal FILE",
    "strategies FILE",
    "controller FILE --format c",
    "weights --kernel FILE",
    "exponentials --kernel FILE",
    "rates --stages 2 --shortest 1 --horizon 10 --kernel FILE",
];

/// Scenarios, and what is asked of them, that refer to a file.
const OF_FILES: [(&str, &str); 6] = [
    ("[system]\nmass = \"FILE\"\n[time]\nstep = 0.1\nsteps = 3\n", "run SCENARIO"),
    ("[system]\nmass = \"FILE\"\n[time]\nstep = 0.1\nsteps = 3\n", "response SCENARIO"),
    ("[system]\nmass = [1.0]\n[input]\nfile = \"FILE\"\n[time]\nstep = 0.1\nsteps = 3\n", "run SCENARIO"),
    (
        "[system]\nmass = [1.0]\n[[system.damping]]\ncoefficient = [1.0]\nkernel = { weights = \"FILE\" }\n\
         [time]\nstep = 0.1\nsteps = 3\n",
        "run SCENARIO",
    ),
    (
        "[system]\nmass = [1.0]\n[[system.damping]]\ncoefficient = [1.0]\nkernel = { relaxation = \"FILE\" }\n\
         [time]\nstep = 0.1\nsteps = 3\n",
        "run SCENARIO",
    ),
    (
        "[system]\nmass = [1.0]\n[reference]\nfile = \"FILE\"\n[time]\nstep = 0.1\nsteps = 3\n",
        "converge SCENARIO --levels 2..3",
    ),
];

/// Commands that take a number, in place of which stands `NUMBER`.
const OF_NUMBERS: [&str; 16] = [
    "weights --exponent 0.5 --count NUMBER",
    "weights --exponent NUMBER",
    "weights --exponent 0.5 --step NUMBER",
    "weights --symbol s^NUMBER",
    "exponentials --exponent 0.5 --horizon NUMBER",
    "exponentials --exponent 0.5 --step NUMBER",
    "exponentials --exponent 0.5 --tolerance NUMBER",
    "rates --exponent 0.5 --stages 2 --shortest NUMBER --horizon 1",
    "rates --exponent 0.5 --stages NUMBER --shortest 1 --horizon 10",
    "response free.toml --points NUMBER",
    "run free.toml --steps NUMBER",
    "run free.toml --until NUMBER",
    "converge free.toml --levels NUMBER..NUMBER",
    "compare-engines --lengths NUMBER",
    "compare-engines --lengths 2 --repetitions NUMBER",
    "sweep free.toml --jobs NUMBER",
];

/// Scenarios with a number in place of which stands `NUMBER`.
const WITH_NUMBERS: [&str; 4] = [
    "[system]\nmass = [1.0]\n[time]\nstep = NUMBER\nsteps = 3\n",
    "[system]\nmass = [1.0]\n[time]\nstep = 0.1\nsteps = NUMBER\n",
    "[system]\nmass = [NUMBER]\n[time]\nstep = 0.1\nsteps = 3\n",
    "[system]\nmass = [1.0]\npotential = \"NUMBER*q0^2\"\n[[system.damping]]\norder = 0.5\n\
     coefficient = [NUMBER]\n[time]\nstep = 0.1\nsteps = 3\n",
];

/// A sparse matrix whose whole numbers of one byte fill 100 MB and are stored in a thousandth of it.
fn bomb(path: &std::path::Path) {
    let entries = 100_000_000_usize;
    let head = |kind: &str, shape: &str| {
        let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
        let text = format!("{text:<117}\n");
        [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat()
    };
    let whole = |numbers: [usize; 2]| numbers.map(|number| (number as u64).to_le_bytes()).concat();
    let mut archive = zip::ZipWriter::new(fs::File::create(path).unwrap());
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    let small = [
        ("format.npy", [head("|S3", "()"), b"csr".to_vec()].concat()),
        ("shape.npy", [head("<i8", "(2,)"), whole([1, entries])].concat()),
        ("indptr.npy", [head("<i8", "(2,)"), whole([0, entries])].concat()),
    ];
    for (name, bytes) in small {
        archive.start_file(name, options).unwrap();
        archive.write_all(&bytes).unwrap();
    }
    for name in ["indices.npy", "data.npy"] {
        archive.start_file(name, options).unwrap();
        archive.write_all(&head("|i1", &format!("({entries},)"))).unwrap();
        let zeros = vec![0; 1 << 20];
        (0..entries.div_ceil(zeros.len())).for_each(|_| archive.write_all(&zeros).unwrap());
    }
    archive.finish().unwrap();
}

/// Makes the inputs; the names of the documents among them, and of files of numbers.
fn inputs(place: &Workplace) -> [Vec<&'static str>; 2] {
    for (name, target) in [
        ("zero.toml", "/dev/zero"),
        ("zero.npz", "/dev/zero"),
        ("zero.csv", "/dev/zero"),
        ("random.mtx", "/dev/urandom"),
        ("nowhere.toml", "no/such"),
        ("nowhere.mtx", "no/such"),
        ("dangling", "no/such"),
    ] {
        symlink(target, place.path(name)).unwrap();
    }
    assert!(place.shell("mkfifo pipe.toml pipe.csv pipe.mtx").status.success());
    place.write("free.toml", FREE);
    place.write("empty.toml", "");
    place.write("list.toml", &format!("x = [{}]\n{FREE}", "0,".repeat(300_000)));
    place.write("large.toml", &format!("x = [{}]\n{FREE}", "0,".repeat(10_000_000)));
    place.write("deep.toml", &format!("x = {}\n", "[".repeat(100_000)));
    for (name, potential) in [
        ("brackets.toml", format!("{}q0{}", "(".repeat(50_000), ")".repeat(50_000))),
        ("signs.toml", format!("{}q0", "-".repeat(100_000))),
        ("powers.toml", format!("q0{}", "^2".repeat(100_000))),
    ] {
        place.write(name, &FREE.replace("[initial]", &format!("potential = \"{potential}\"\n[initial]")));
    }
    bomb(&place.path("bomb.npz"));
    let documents = vec![
        "/dev/zero",
        "zero.toml",
        "nowhere.toml",
        "pipe.toml",
        ".",
        "empty.toml",
        "list.toml",
        "large.toml",
        "deep.toml",
        "brackets.toml",
        "signs.toml",
        "powers.toml",
        "bomb.npz",
    ];
    let files = vec![
        "/dev/zero",
        "zero.npz",
        "zero.csv",
        "random.mtx",
        "nowhere.mtx",
        "pipe.mtx",
        "pipe.csv",
        "bomb.npz",
    ];
    [documents, files]
}

/// All lines of commands.
fn lines(place: &Workplace) -> Vec<String> {
    let [documents, files] = inputs(place);
    let mut lines = Vec::new();
    for document in documents {
        lines.extend(OF_DOCUMENTS.map(|command| command.replace("FILE", document)));
    }
    let scenario = |text: &str, command: &str, lines: &mut Vec<String>| {
        let name = format!("scenario-{}.toml", lines.len());
        place.write(&name, text);
        lines.push(command.replace("SCENARIO", &name));
    };
    for file in files {
        for (text, command) in OF_FILES {
            scenario(&text.replace("FILE", file), command, &mut lines);
        }
    }
    let (long, small) = ("7".repeat(300), format!("0.{}1", "0".repeat(300)));
    for number in
        ["1000000000000", "18446744073709551615", "1e300", "nan", &long, &format!("-{long}"), &small]
    {
        lines.extend(OF_NUMBERS.map(|command| command.replace("NUMBER", number)));
        for text in WITH_NUMBERS {
            scenario(&text.replace("NUMBER", number), "run SCENARIO", &mut lines);
        }
    }
    lines
        .extend(["run", "response", "converge"].map(|command| format!("{command} free.toml --out dangling")));
    lines.push("weights --exponent 0.5 --out dangling".to_owned());
    lines
}

/// True if a program has ended by itself, with one of its exit codes, or was ended after its time.
fn is_orderly(output: &Output) -> bool {
    let code = output.status.code();
    let said = text(&output.stderr);
    let ended = matches!(code, Some(0 | 1 | 2 | 124 | 130 | 141)) && output.status.signal().is_none();
    ended && !said.contains("panicked") && !said.contains("memory allocation of")
}

#[test]
fn nothing_aborts_or_panics_whatever_it_is_given() {
    let place = Workplace::new();
    let lines = lines(&place);
    let jobs: Vec<(usize, String)> = [1_000_000, 4_000_000]
        .into_iter()
        .flat_map(|kilobytes| lines.iter().map(move |line| (kilobytes, line.clone())))
        .collect();
    let (next, aborts) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        // Most of them wait for their time to end.
        for _ in 0..16 {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some((kilobytes, line)) = jobs.get(index) else { break };
                    // Listings go to the standard output.
                    let is_listing =
                        ["weights", "exponentials", "rates", "controller"].iter().any(|name| line.starts_with(name));
                    let out = match () {
                        () if is_listing || line.contains("--out") => String::new(),
                        () => format!("--out out-{index}"),
                    };
                    let program = env!("CARGO_BIN_EXE_fvi");
                    let shell = format!(
                        "ulimit -v {kilobytes}; timeout 1 '{program}' {line} {out} </dev/null | head -c 10000 >/dev/null; \
                         exit ${{PIPESTATUS[0]}}"
                    );
                    let output = place.shell(&shell);
                    if !is_orderly(&output) {
                        aborts.lock().unwrap().push(format!(
                            "{kilobytes} kB: {line}: {}\n{}",
                            output.status,
                            text(&output.stderr)
                        ));
                    }
                }
            });
        }
    });
    let aborts = aborts.into_inner().unwrap();
    assert!(aborts.is_empty(), "{} of {}:\n{}", aborts.len(), jobs.len(), aborts.join("\n"));
}
