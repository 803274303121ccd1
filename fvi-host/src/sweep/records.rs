//! The file of records: a slot for each run, filled when the run is done.
//!
//! ```text
//! magic (8 bytes), length of the identity (u64), identity, CRC-32 of the three (u32)
//! each run:  status (u8), steps (u64), values (f64 each), length of the message (u16), message (240 bytes),
//!            CRC-32 (u32)
//! ```
//!
//! Integers and floating-point numbers are little-endian. A slot with a wrong checksum belongs to a run that
//! is not done.

use super::SweepError;
use crate::results::files::{FileError, lock, open_in_place};
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Mutex, PoisonError};

const MAGIC: [u8; 8] = *b"fvi\r\n\x1a\nS";

/// Largest length of a run's message, in bytes.
pub(super) const LONGEST_MESSAGE: usize = 240;

/// The part of a sweep that one process makes: the runs whose index has a given remainder on division by the
/// number of shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

/// A text that cannot be read as a shard.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no shard: I/COUNT is, with I from 1 to COUNT, or from 0 to COUNT − 1")]
pub struct ShardError {
    text: String,
}

impl Shard {
    /// All runs.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Shard `index` of `count`. Whether shards are counted from 0 or from 1 does not matter: `count` and 0
    /// name the same one.
    ///
    /// # Errors
    /// If there is no shard, or `index` is larger than `count`.
    pub fn new(index: usize, count: usize) -> Result<Self, ShardError> {
        if count == 0 || index > count {
            return Err(ShardError { text: format!("{index}/{count}") });
        }
        Ok(Self { index: index % count, count })
    }

    /// The shard of a task of a Slurm array, from the variables that Slurm sets; `None` outside of one.
    ///
    /// # Errors
    /// If a variable is not an integer, or the task does not belong to the array.
    pub fn of_slurm(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, ShardError> {
        let (Some(id), Some(count)) = (variable("SLURM_ARRAY_TASK_ID"), variable("SLURM_ARRAY_TASK_COUNT"))
        else {
            return Ok(None);
        };
        let error = || ShardError { text: format!("{id}/{count}") };
        let number = |text: &String| text.trim().parse::<usize>().map_err(|_| error());
        let count = number(&count)?;
        let step = variable("SLURM_ARRAY_TASK_STEP").as_ref().map_or(Ok(1), number)?.max(1);
        let first = variable("SLURM_ARRAY_TASK_MIN").as_ref().map_or(Ok(0), number)?;
        let id = number(&id)?;
        let index = if step == 1 { id } else { id.checked_sub(first).ok_or_else(error)? / step };
        if count == 0 {
            return Err(error());
        }
        Ok(Some(Self { index: index % count, count }))
    }

    fn file(self) -> String {
        match self.count {
            1 => "sweep.fvi".to_owned(),
            count => format!("sweep.shard-{}-of-{count}.fvi", self.number()),
        }
    }

    /// Its number, from 1.
    fn number(self) -> usize {
        if self.index == 0 { self.count } else { self.index }
    }

    /// The shard that a file is named after.
    fn of_file(name: &str) -> Option<Self> {
        if name == Self::WHOLE.file() {
            return Some(Self::WHOLE);
        }
        let (index, count) = name.strip_prefix("sweep.shard-")?.strip_suffix(".fvi")?.split_once("-of-")?;
        let shard = Self::new(index.parse().ok()?, count.parse().ok()?).ok()?;
        (shard.file() == name).then_some(shard)
    }

    /// Number of its runs, in a sweep of `runs` runs.
    pub fn share(self, runs: usize) -> usize {
        runs / self.count + usize::from(runs % self.count > self.index)
    }
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let error = || ShardError { text: text.to_owned() };
        let (index, count) = text.split_once('/').ok_or_else(error)?;
        let number = |text: &str| text.trim().parse().map_err(|_| error());
        Self::new(number(index)?, number(count)?).map_err(|_| error())
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number(), self.count)
    }
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Status {
    /// All its steps were made.
    Completed = 1,
    /// A step failed.
    Failed = 2,
    /// Its scenario was refused.
    Refused = 3,
}

impl Status {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Failed => "failed",
            Self::Refused => "refused",
        }
    }
}

/// Record of a run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Record {
    pub(super) status: Status,
    pub(super) steps: u64,
    pub(super) values: Vec<f64>,
    pub(super) message: String,
}

/// The shape of a file of records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) runs: usize,
    pub(super) columns: usize,
}

impl Layout {
    fn bytes(self) -> usize {
        1 + 8 + 8 * self.columns + 2 + LONGEST_MESSAGE + 4
    }
}

/// The records of one shard.
pub(super) struct Records {
    path: PathBuf,
    shard: Shard,
    layout: Layout,
    head: u64,
    file: File,
    /// Held while the file's cursor is moved.
    cursor: Mutex<()>,
}

impl Records {
    /// Opens the records of a shard for writing, locked against other processes.
    pub(super) fn open(
        directory: &Path,
        identity: &[u8],
        layout: Layout,
        shard: Shard,
    ) -> Result<Self, SweepError> {
        let path = directory.join(shard.file());
        let place = path.clone();
        let failed = FileError::at(&place);
        if let Some(other) = shards_in(directory)?.into_iter().find(|other| other.count != shard.count) {
            let reasons = vec![format!("{}; `--out` names another directory", overlap(other, shard))];
            return Err(SweepError::Incomplete { directory: directory.to_owned(), reasons });
        }
        let file = open_in_place(&path).map_err(&failed)?;
        if let Err(TryLockError::WouldBlock) = lock(&file) {
            return Err(SweepError::InUse { file: path });
        }
        let head = head(identity);
        let mut present = Vec::new();
        (&file).take(head.len() as u64).read_to_end(&mut present).map_err(&failed)?;
        if present.len() < head.len() && head.starts_with(&present) {
            // The file is new, or was left without a complete head.
            let write = || {
                (&file).rewind()?;
                (&file).write_all(&head)
            };
            write().map_err(&failed)?;
        } else if present != head {
            return Err(SweepError::OtherSweep { file: path });
        }
        let length = head.len() as u64 + (shard.share(layout.runs) * layout.bytes()) as u64;
        file.set_len(length).map_err(&failed)?;
        Ok(Self::with(path, shard, layout, head.len() as u64, file))
    }

    fn with(path: PathBuf, shard: Shard, layout: Layout, head: u64, file: File) -> Self {
        Self { path, shard, layout, head, file, cursor: Mutex::new(()) }
    }

    /// Opens the records of a shard for reading.
    pub(super) fn look(
        directory: &Path,
        identity: &[u8],
        layout: Layout,
        shard: Shard,
    ) -> Result<Self, SweepError> {
        let path = directory.join(shard.file());
        let place = path.clone();
        let failed = FileError::at(&place);
        let file = File::open(&path).map_err(&failed)?;
        let head = head(identity);
        let mut present = Vec::new();
        (&file).take(head.len() as u64).read_to_end(&mut present).map_err(&failed)?;
        if present != head {
            return Err(SweepError::OtherSweep { file: path });
        }
        Ok(Self::with(path, shard, layout, head.len() as u64, file))
    }

    /// All shards of a directory, which must be complete and together cover the sweep.
    pub(super) fn all(directory: &Path, identity: &[u8], layout: Layout) -> Result<Vec<Self>, SweepError> {
        let mut shards = shards_in(directory)?;
        shards.sort_by_key(|shard| (shard.count, shard.index));
        let incomplete = |reasons| SweepError::Incomplete { directory: directory.to_owned(), reasons };
        let Some(first) = shards.first() else {
            return Err(incomplete(vec!["there are no records of a sweep".to_owned()]));
        };
        let mut reasons = Vec::new();
        for other in shards.iter().filter(|shard| shard.count != first.count) {
            reasons.push(overlap(*first, *other));
        }
        for index in 0..first.count {
            let shard = Shard { index, count: first.count };
            if !shards.contains(&shard) {
                reasons.push(format!("shard {shard} is missing"));
            }
        }
        if !reasons.is_empty() {
            return Err(incomplete(reasons));
        }
        let records: Vec<Self> = shards
            .into_iter()
            .map(|shard| Self::look(directory, identity, layout, shard))
            .collect::<Result<_, _>>()?;
        for records in &records {
            let (done, share) = (records.done()?, records.share());
            if done < share {
                reasons.push(format!("shard {} has {done} of its {share} runs", records.shard));
            }
        }
        if reasons.is_empty() { Ok(records) } else { Err(incomplete(reasons)) }
    }

    /// Number of runs of the shard.
    pub(super) fn share(&self) -> usize {
        self.shard.share(self.layout.runs)
    }

    /// Index of the run in a slot.
    pub(super) fn run(&self, place: usize) -> usize {
        place * self.shard.count + self.shard.index
    }

    /// Slot of a run, if the run belongs to the shard.
    pub(super) fn place(&self, run: usize) -> Option<usize> {
        (run < self.layout.runs && run % self.shard.count == self.shard.index).then(|| run / self.shard.count)
    }

    /// Number of runs that are done.
    pub(super) fn done(&self) -> Result<usize, FileError> {
        let mut done = 0;
        for place in 0..self.share() {
            done += usize::from(self.read(place)?.is_some());
        }
        Ok(done)
    }

    fn start(&self, place: usize) -> SeekFrom {
        SeekFrom::Start(self.head + (place * self.layout.bytes()) as u64)
    }

    /// The record in a slot, if that run is done.
    pub(super) fn read(&self, place: usize) -> Result<Option<Record>, FileError> {
        let mut bytes = vec![0; self.layout.bytes()];
        let read = self.at(place, |mut file| file.read_exact(&mut bytes));
        match read {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
            read => read.map(|()| Record::decode(&bytes, self.layout)).map_err(FileError::at(&self.path)),
        }
    }

    /// Writes a slot.
    pub(super) fn write(&self, place: usize, record: &Record) -> Result<(), FileError> {
        let bytes = record.encode(self.layout);
        self.at(place, |mut file| file.write_all(&bytes)).map_err(FileError::at(&self.path))
    }

    fn at(&self, place: usize, act: impl FnOnce(&File) -> io::Result<()>) -> io::Result<()> {
        let _cursor = self.cursor.lock().unwrap_or_else(PoisonError::into_inner);
        (&self.file).seek(self.start(place))?;
        act(&self.file)
    }

    /// Flushes everything to the disk.
    pub(super) fn flush(&self) -> Result<(), FileError> {
        self.file.sync_data().map_err(FileError::at(&self.path))
    }
}

/// The shards whose records lie in a directory.
fn shards_in(directory: &Path) -> Result<Vec<Shard>, FileError> {
    let entries = fs::read_dir(directory).map_err(FileError::at(directory))?;
    Ok(entries.flatten().filter_map(|entry| Shard::of_file(entry.file_name().to_str()?)).collect())
}

fn overlap(one: Shard, other: Shard) -> String {
    format!("shards overlap: {one} and {other} divide the runs in different ways")
}

/// The record of a run from the shards, which are sorted by index.
pub(super) fn record_of(shards: &[Records], run: usize) -> Result<Record, FileError> {
    let missing = Record { status: Status::Refused, steps: 0, values: Vec::new(), message: String::new() };
    let Some(records) = shards.get(run % shards.len().max(1)) else { return Ok(missing) };
    Ok(records.read(run / shards.len().max(1))?.unwrap_or(missing))
}

fn head(identity: &[u8]) -> Vec<u8> {
    let mut head = Vec::from(MAGIC);
    head.extend((identity.len() as u64).to_le_bytes());
    head.extend(identity);
    head.extend(crc32fast::hash(&head).to_le_bytes());
    head
}

impl Record {
    /// Its bytes in the file.
    pub(super) fn encode(&self, layout: Layout) -> Vec<u8> {
        let mut end = self.message.len().min(LONGEST_MESSAGE);
        while !self.message.is_char_boundary(end) {
            end -= 1;
        }
        let mut bytes = vec![self.status as u8];
        bytes.extend(self.steps.to_le_bytes());
        let padding = std::iter::repeat(&f64::NAN);
        for value in self.values.iter().chain(padding).take(layout.columns) {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend((end as u16).to_le_bytes());
        bytes.extend(&self.message.as_bytes()[..end]);
        bytes.resize(layout.bytes() - 4, 0);
        bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
        bytes
    }

    /// The record in these bytes; `None` if the checksum is wrong.
    pub(super) fn decode(bytes: &[u8], layout: Layout) -> Option<Self> {
        let (content, checksum) =
            bytes.split_last_chunk::<4>().map(|(content, checksum)| (content, *checksum))?;
        if bytes.len() != layout.bytes() || crc32fast::hash(content) != u32::from_le_bytes(checksum) {
            return None;
        }
        let (&status, rest) = content.split_first()?;
        let status = [Status::Completed, Status::Failed, Status::Refused]
            .into_iter()
            .find(|&known| known as u8 == status)?;
        let (steps, rest) = rest.split_first_chunk::<8>()?;
        let (values, rest) = rest.split_at_checked(8 * layout.columns)?;
        let values = values.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
        let (length, rest) = rest.split_first_chunk::<2>()?;
        let message = rest.get(..u16::from_le_bytes(*length).into())?;
        let message = String::from_utf8_lossy(message).into_owned();
        Some(Self { status, steps: u64::from_le_bytes(*steps), values, message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { runs: 10, columns: 2 };

    fn record(number: f64, message: &str) -> Record {
        Record { status: Status::Failed, steps: 7, values: vec![number, -0.0], message: message.to_owned() }
    }

    #[test]
    fn records_are_read_as_written_and_damaged_ones_are_not_there() {
        let directory = tempfile::tempdir().unwrap();
        let records = Records::open(directory.path(), b"this", LAYOUT, Shard::WHOLE).unwrap();
        let long = "ä".repeat(200);
        records.write(3, &record(0.1, "why")).unwrap();
        records.write(9, &record(0.2, &long)).unwrap();
        assert_eq!(records.read(3).unwrap(), Some(record(0.1, "why")));
        assert_eq!(records.read(9).unwrap().unwrap().message, "ä".repeat(120));
        assert_eq!((records.read(0).unwrap(), records.done().unwrap()), (None, 2));
        let in_use = Records::open(directory.path(), b"this", LAYOUT, Shard::WHOLE).err();
        assert!(matches!(in_use, Some(SweepError::InUse { .. })));
        drop(records);
        let path = directory.path().join("sweep.fvi");
        let whole = fs::read(&path).unwrap();
        let place = head(b"this").len() + 3 * LAYOUT.bytes();
        for offset in 0..LAYOUT.bytes() {
            let mut bytes = whole.clone();
            bytes[place + offset] ^= 1;
            fs::write(&path, &bytes).unwrap();
            let records = Records::open(directory.path(), b"this", LAYOUT, Shard::WHOLE).unwrap();
            assert_eq!(records.done().unwrap(), 1, "byte {offset}");
        }
        let other = Records::open(directory.path(), b"that", LAYOUT, Shard::WHOLE).err();
        assert!(matches!(other, Some(SweepError::OtherSweep { .. })));
    }

    #[test]
    fn shards_take_every_run_once_whether_counted_from_0_or_1() {
        for count in 1..6 {
            for first in [0, 1] {
                let mut runs = Vec::new();
                for index in first..first + count {
                    let directory = tempfile::tempdir().unwrap();
                    let shard = Shard::new(index, count).unwrap();
                    assert_eq!(Shard::of_file(&shard.file()), Some(shard));
                    let records = Records::open(directory.path(), b"", LAYOUT, shard).unwrap();
                    runs.extend((0..records.share()).map(|place| records.run(place)));
                }
                runs.sort_unstable();
                assert_eq!(runs, (0..10).collect::<Vec<_>>());
            }
        }
        for wrong in ["", "1", "3/2", "1/0", "a/2", "-1/2"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_task_of_a_slurm_array_is_a_shard() {
        let task = |variables: &[(&str, &str)]| {
            let find = |name: &str| {
                let found = variables.iter().find(|(known, _)| name == format!("SLURM_ARRAY_TASK_{known}"));
                found.map(|(_, value)| (*value).to_owned())
            };
            Shard::of_slurm(find).ok()
        };
        let shard = |index, count| Some(Some(Shard { index, count }));
        assert_eq!(task(&[]), Some(None));
        assert_eq!(task(&[("ID", "0"), ("COUNT", "4")]), shard(0, 4));
        assert_eq!(task(&[("ID", "4"), ("COUNT", "4"), ("MIN", "1"), ("STEP", "1")]), shard(0, 4));
        assert_eq!(task(&[("ID", "13"), ("COUNT", "3"), ("MIN", "9"), ("STEP", "2")]), shard(2, 3));
        assert_eq!(task(&[("ID", "x"), ("COUNT", "3")]), None);
    }

    #[test]
    fn shards_that_overlap_miss_or_are_not_done_are_named() {
        let directory = tempfile::tempdir().unwrap();
        let all = || match Records::all(directory.path(), b"", LAYOUT) {
            Ok(records) => format!("{} shards", records.len()),
            Err(error) => error.to_string(),
        };
        let fill = |text: &str, count: usize| {
            let records = Records::open(directory.path(), b"", LAYOUT, text.parse().unwrap()).unwrap();
            (0..count).for_each(|place| records.write(place, &record(0.0, "")).unwrap());
        };
        assert!(all().contains("no records"), "{}", all());
        fill("1/3", 4);
        assert!(all().contains("shard 3/3 is missing; shard 2/3 is missing"), "{}", all());
        fill("2/3", 1);
        fill("3/3", 4);
        assert!(all().contains("shard 2/3 has 1 of its 3 runs"), "{}", all());
        fill("2/3", 3);
        assert_eq!(all(), "3 shards");
        let other = Records::open(directory.path(), b"", LAYOUT, "1/2".parse().unwrap());
        let refusal = other.err().map(|error| error.to_string()).unwrap_or_default();
        assert!(refusal.contains("/3 and 1/2 divide the runs in different ways"), "{refusal}");
        // As left by two processes that began at the same moment.
        fs::write(directory.path().join("sweep.shard-1-of-2.fvi"), "").unwrap();
        assert!(all().contains("shards overlap"), "{}", all());
    }
}
