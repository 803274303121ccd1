//! A strategy that is an external program, which reads lines and answers with lines.

use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use fvi_core::{Memory, MemoryError, Stateful, check_channels};
use fvi_scenario::language::InputError;
use fvi_scenario::language::document::{Document, Table};

use crate::kernel::hash;
use crate::strategy::{AnyMemory, BuiltStrategy, Declined, Strategy, Task, require_double};

/// A `[[program]]` of the file.
#[derive(Clone, Debug)]
pub(crate) struct Program {
    pub(crate) name: String,
    command: Vec<String>,
    directory: PathBuf,
    /// Longest time to wait for an answer.
    limit: Duration,
}

impl Program {
    pub(crate) fn read(table: &Table<'_>, document: &Document) -> Result<Self, InputError> {
        table.allow(&["name", "command", "time_limit"])?;
        let name = table.required("name")?;
        let word = name.text()?;
        if word.is_empty() || word.chars().any(|letter| letter.is_control() || letter.is_whitespace()) {
            return Err(name.out_of_range("one word"));
        }
        let command = table.required("command")?;
        let words = command.list("a list of texts: the program and its arguments")?;
        let words: Vec<String> =
            words.iter().map(|word| word.text().map(str::to_owned)).collect::<Result<_, _>>()?;
        if words.first().is_none_or(String::is_empty) {
            return Err(command.out_of_range("the program and its arguments"));
        }
        let limit = match table.optional("time_limit") {
            None => 10.0,
            Some(value) => match value.number()? {
                seconds if seconds > 0.0 && seconds <= 1e6 => seconds,
                _ => return Err(value.out_of_range("a number of seconds > 0 and at most 1e6")),
            },
        };
        let limit = Duration::from_secs_f64(limit);
        Ok(Self { name: word.to_owned(), command: words, directory: document.resolve(""), limit })
    }

    /// Hash of the command and of the files that it names, by which a record knows what was measured.
    pub(crate) fn fingerprint(&self) -> u64 {
        // Devices, which may never end, are no files.
        let paths = self.command.iter().map(|word| self.directory.join(word));
        let files = paths.filter(|path| path.is_file()).filter_map(|path| std::fs::read(path).ok());
        let words = self.command.iter().flat_map(|word| word.bytes().chain([0]));
        hash(words.chain(files.flatten()))
    }

    pub(crate) fn strategy(&self) -> Strategy {
        let program = self.clone();
        let description = format!("a program over pipes, their time included: {}", self.command.join(" "));
        Strategy::new(self.name.clone(), description, move |task| program.made(task))
    }

    fn made(&self, task: &Task) -> Result<BuiltStrategy, Declined> {
        require_double(task)?;
        let trouble = Arc::new(Mutex::new(None));
        let memory = Pipe::start(self, task, Arc::clone(&trouble))?;
        let group = memory.group;
        let mut made = BuiltStrategy::of(AnyMemory::F64(Box::new(memory)));
        made.resident = Some(Arc::new(move || resident(group)));
        made.trouble = Some(Arc::new(move || trouble.lock().unwrap_or_else(PoisonError::into_inner).clone()));
        Ok(made)
    }
}

/// Bytes that the processes of a group have in memory, those that they share counted in each: what a program
/// and all that it has started take. `None` where the system does not tell (it does on Linux), or if none is
/// there any more.
fn resident(group: u32) -> Option<usize> {
    let processes = std::fs::read_dir("/proc").ok()?.filter_map(Result::ok);
    let of_group = processes.filter_map(|process| {
        let stat = std::fs::read_to_string(process.path().join("stat")).ok()?;
        // The name, in parentheses, may hold anything; then state, parent and group.
        let found: u32 = stat.rsplit_once(')')?.1.split_ascii_whitespace().nth(2)?.parse().ok()?;
        (found == group).then_some(process.path())
    });
    let bytes = of_group.filter_map(|process| {
        let status = std::fs::read_to_string(process.join("status")).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(1024 * line.split_ascii_whitespace().next()?.parse::<usize>().ok()?)
    });
    Some(bytes.sum()).filter(|&bytes| bytes > 0)
}

/// Letters of an answer beyond which it is none: so many, and so many for each number.
const LONGEST_LINE: u64 = 4096;
const LONGEST_NUMBER: u64 = 400;

/// Ends a program that does not answer in time, that nobody waits for any more, or that has exited and left
/// others behind.
struct Watchdog {
    child: Arc<Mutex<Started>>,
    begin: Instant,
    /// Deadline of the answer, in milliseconds since the start; 0 if no answer is pending.
    due: Arc<AtomicU64>,
    struck: Arc<AtomicBool>,
    over: Arc<AtomicBool>,
    limit: Duration,
}

impl Watchdog {
    fn new(child: Child, limit: Duration, abandoned: &Arc<AtomicBool>) -> Self {
        let watchdog = Self {
            child: Arc::new(Mutex::new(Started { child, is_over: false })),
            begin: Instant::now(),
            due: Arc::default(),
            struck: Arc::default(),
            over: Arc::default(),
            limit,
        };
        let child = Arc::clone(&watchdog.child);
        let (due, struck, over) =
            (Arc::clone(&watchdog.due), Arc::clone(&watchdog.struck), Arc::clone(&watchdog.over));
        let (begin, abandoned) = (watchdog.begin, Arc::clone(abandoned));
        thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                let due = due.load(Ordering::Relaxed);
                let is_late = due != 0 && begin.elapsed().as_millis() as u64 >= due;
                if is_late || abandoned.load(Ordering::Relaxed) {
                    struck.store(true, Ordering::Relaxed);
                    let _ = child.lock().unwrap_or_else(PoisonError::into_inner).end();
                    return;
                }
                let mut child = child.lock().unwrap_or_else(PoisonError::into_inner);
                if child.has_exited() {
                    let _ = child.end();
                    return;
                }
                drop(child);
                thread::sleep(Duration::from_millis(20));
            }
        });
        watchdog
    }

    fn arm(&self) {
        let due = (self.begin.elapsed() + self.limit).as_millis() as u64;
        self.due.store(due.max(1), Ordering::Relaxed);
    }

    fn disarm(&self) {
        self.due.store(0, Ordering::Relaxed);
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _ = self.child.lock().unwrap_or_else(PoisonError::into_inner).end();
    }
}

/// A program that was started, the first process of its group.
struct Started {
    child: Child,
    is_over: bool,
}

impl Started {
    /// True if the first process has exited. It is not waited for yet, so that the number of its group is no
    /// other's.
    #[cfg(unix)]
    fn has_exited(&self) -> bool {
        use rustix::process::{Pid, WaitId, WaitIdOptions, waitid};
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        self.is_over || !matches!(waitid(WaitId::Pid(Pid::from_child(&self.child)), options), Ok(None))
    }

    #[cfg(not(unix))]
    fn has_exited(&mut self) -> bool {
        self.is_over || !matches!(self.child.try_wait(), Ok(None))
    }

    /// Kills the program and the processes that it has started, which may keep its pipes open, and waits for
    /// its end.
    fn end(&mut self) -> std::io::Result<ExitStatus> {
        if !self.is_over {
            self.is_over = true;
            #[cfg(unix)]
            let _ = rustix::process::kill_process_group(
                rustix::process::Pid::from_child(&self.child),
                rustix::process::Signal::KILL,
            );
            let _ = self.child.kill();
        }
        self.child.wait()
    }
}

/// A memory implemented by a program.
///
/// The program returns a term after each sample, so that a step costs one line in each direction.
struct Pipe {
    watchdog: Watchdog,
    to: BufWriter<ChildStdin>,
    from: BufReader<ChildStdout>,
    line: String,
    leading: [f64; 1],
    term: Vec<f64>,
    capacity: usize,
    len: usize,
    /// Number of its group of processes.
    group: u32,
    trouble: Arc<Mutex<Option<String>>>,
}

impl Pipe {
    fn start(program: &Program, task: &Task, trouble: Arc<Mutex<Option<String>>>) -> Result<Self, Declined> {
        let failed = |reason: String| Declined::Failed(reason);
        let mut command = Command::new(&program.command[0]);
        command.args(&program.command[1..]).stdin(Stdio::piped()).stdout(Stdio::piped());
        if !program.directory.as_os_str().is_empty() {
            command.current_dir(&program.directory);
        }
        // A process group of its own: it can be killed as a whole, and does not receive an interrupt from the
        // terminal.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child =
            command.spawn().map_err(|error| failed(format!("`{}`: {error}", program.command[0])))?;
        let (Some(to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(failed("it has no pipes".to_owned()));
        };
        let group = child.id();
        let mut pipe = Self {
            watchdog: Watchdog::new(child, program.limit, &task.abandoned),
            to: BufWriter::new(to),
            from: BufReader::new(from),
            line: String::new(),
            leading: [task.weights.first().copied().unwrap_or(0.0)],
            term: vec![0.0; task.channels],
            capacity: task.length,
            len: 0,
            group,
            trouble,
        };
        let mut head = format!(
            "begin {} {} {:e} {:e}\nweights",
            task.length,
            task.channels,
            task.step(),
            task.tolerance
        );
        for weight in task.weights.iter() {
            head.push_str(&format!(" {weight:e}"));
        }
        head.push('\n');
        let answer = pipe.exchange(&head).map_err(failed)?;
        if let Some(reason) = answer.strip_prefix("declined") {
            return Err(Declined::SitsOut(shortened(reason.trim())));
        }
        // A program may say how much it takes, too; what it takes is measured.
        match answer.split_ascii_whitespace().next() {
            Some("ready") => Ok(pipe),
            _ => Err(failed(format!("it answered `{}` in place of `ready`", shortened(&answer)))),
        }
    }

    /// Sends lines and waits for the line that answers them.
    fn exchange(&mut self, lines: &str) -> Result<String, String> {
        self.watchdog.arm();
        let sent = self.to.write_all(lines.as_bytes()).and_then(|()| self.to.flush());
        self.line.clear();
        let longest = LONGEST_LINE + LONGEST_NUMBER * self.term.len() as u64;
        let read = sent.and_then(|()| self.from.by_ref().take(longest).read_line(&mut self.line));
        self.watchdog.disarm();
        let limit = self.watchdog.limit.as_secs_f64();
        match read {
            Ok(count) if count > 0 && self.line.ends_with('\n') => Ok(self.line.trim_end().to_owned()),
            Ok(count) if count as u64 == longest => {
                let _ = self.watchdog.child.lock().unwrap_or_else(PoisonError::into_inner).end();
                Err(format!("it answered a line of more than {longest} letters: ended"))
            }
            _ if self.watchdog.struck.load(Ordering::Relaxed) => {
                Err(format!("no answer within {limit:.3} s: ended"))
            }
            _ => {
                let mut child = self.watchdog.child.lock().unwrap_or_else(PoisonError::into_inner);
                // Its pipe is closed, so it has exited or is about to.
                for _ in 0..50 {
                    if !child.has_exited() {
                        thread::sleep(Duration::from_millis(2));
                    }
                }
                let status = child.end().map_or_else(|error| error.to_string(), |status| status.to_string());
                Err(format!("it ended in the middle of the race ({status})"))
            }
        }
    }

    fn told(&self, reason: String) -> MemoryError {
        *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(reason);
        MemoryError::Full { capacity: self.len }
    }
}

/// A line shortened for an error message.
fn shortened(line: &str) -> String {
    let shown: String = line.chars().filter(|letter| !letter.is_control()).take(80).collect();
    if shown.len() < line.len() { format!("{shown} …") } else { shown }
}

impl Memory<f64> for Pipe {
    fn channels(&self) -> usize {
        self.term.len()
    }

    fn leading(&self) -> &[f64] {
        &self.leading
    }

    fn len(&self) -> usize {
        self.len
    }

    fn next_term(&mut self, term: &mut [f64]) -> Result<(), MemoryError> {
        check_channels(self.term.len(), term.len())?;
        if self.len == self.capacity {
            return Err(MemoryError::Full { capacity: self.capacity });
        }
        term.copy_from_slice(&self.term);
        Ok(())
    }

    fn push(&mut self, sample: &[f64]) -> Result<(), MemoryError> {
        check_channels(self.term.len(), sample.len())?;
        if self.len == self.capacity {
            return Err(MemoryError::Full { capacity: self.capacity });
        }
        let mut line = String::from("push");
        for number in sample {
            line.push_str(&format!(" {number:e}"));
        }
        line.push('\n');
        let answer = self.exchange(&line).map_err(|reason| self.told(reason))?;
        let mut words = answer.split_ascii_whitespace();
        let numbers: Option<Vec<f64>> = (0..self.term.len()).map(|_| words.next()?.parse().ok()).collect();
        match numbers.filter(|_| words.next().is_none()) {
            Some(numbers) => self.term.copy_from_slice(&numbers),
            None => {
                let expected = self.term.len();
                let found = shortened(&answer);
                return Err(self.told(format!("it answered `{found}` in place of {expected} numbers")));
            }
        }
        self.len += 1;
        Ok(())
    }

    fn clear(&mut self) {
        self.len = 0;
        self.term.fill(0.0);
        match self.exchange("clear\n") {
            Ok(answer) if answer == "ok" => {}
            Ok(answer) => {
                self.told(format!("it answered `{}` in place of `ok`", shortened(&answer)));
                self.capacity = 0;
            }
            Err(reason) => {
                self.told(reason);
                self.capacity = 0;
            }
        }
    }

    fn bytes(&self) -> usize {
        resident(self.group).unwrap_or(0)
    }
}

impl Stateful for Pipe {}
