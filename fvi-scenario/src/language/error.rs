//! Errors in scenario files, with their location and the allowed values.

use crate::language::escape::{short_numbers, visible};
use crate::language::expression::{ExpressionError, ParameterNameError};
use core::ops::Range;
use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};
use std::error::Error;
use std::fmt;
use std::sync::Arc;

/// Something in an input file that cannot be used.
///
/// Its text is one line, `file:line:column: key = value: problem; allowed`; as a [`Diagnostic`] it shows the
/// line of the file as well.
#[derive(Debug)]
pub struct InputError(Box<Details>);

#[derive(Debug)]
struct Details {
    source: NamedSource<String>,
    /// The key, as a path such as `system.damping[0].order`; empty for the file as a whole.
    key: String,
    value: String,
    /// Location in the file; `None` for a value that is not written there.
    place: Option<SourcePlace>,
    problem: Problem,
}

/// Longest line of a file, in bytes, that is shown in a message.
const LONGEST_LINE: usize = 240;

#[derive(Debug)]
struct SourcePlace {
    span: Range<usize>,
    line: usize,
    column: usize,
    /// True if the surrounding lines are short enough to be shown.
    showable: bool,
}

impl SourcePlace {
    fn new(text: &str, span: Range<usize>) -> Self {
        let before = text.get(..span.start).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        let line = before.matches('\n').count() + 1;
        // The line itself and its neighbours.
        let from = before[..line_start.saturating_sub(1)].rfind('\n').map_or(0, |newline| newline + 1);
        let rest = text.get(from..).unwrap_or_default();
        let lines_around = before[from..].matches('\n').count() + 2;
        let showable = rest.split('\n').take(lines_around).all(|line| line.len() <= LONGEST_LINE);
        Self { line, column: before[line_start..].chars().count() + 1, span, showable }
    }
}

impl InputError {
    /// An error about the bytes `span` of the file `name` with content `text`, which belong to `key`.
    pub(crate) fn new(
        name: &str,
        text: &str,
        key: &str,
        value: String,
        span: Option<Range<usize>>,
        problem: Problem,
    ) -> Self {
        let place = span.map(|span| SourcePlace::new(text, span));
        // Control characters of the file are not sent to the terminal. Byte offsets stay valid.
        let source = NamedSource::new(visible(name), visible(text).into_owned());
        let (key, value) = (visible(key).into_owned(), visible(&value).into_owned());
        Self(Box::new(Details { source, key, value, place, problem }))
    }

    /// An error about a file that cannot be read at all.
    pub(crate) fn unreadable(name: &str, problem: Problem) -> Self {
        Self::new(name, "", "", String::new(), None, problem)
    }

    /// The name of the file.
    pub fn file(&self) -> &str {
        self.0.source.name()
    }

    /// The key that the error is about, as a path such as `system.damping[0].order`; empty for the whole
    /// file.
    pub fn key(&self) -> &str {
        &self.0.key
    }

    /// The value that the error is about, as written; empty if there is none.
    pub fn value(&self) -> &str {
        &self.0.value
    }

    /// Line in the file, counted from 1; `None` for a value that is not written in the file.
    pub fn line(&self) -> Option<usize> {
        self.0.place.as_ref().map(|place| place.line)
    }

    /// The problem.
    pub fn problem(&self) -> &Problem {
        &self.0.problem
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.source.name())?;
        if let Some(SourcePlace { line, column, .. }) = &self.0.place {
            write!(f, ":{line}:{column}")?;
        }
        match (self.0.key.as_str(), self.0.value.as_str()) {
            ("", _) => {}
            (key, "") => write!(f, ": {key}")?,
            (key, value) => write!(f, ": {key} = {value}")?,
        }
        write!(f, ": {}", short_numbers(&visible(&self.0.problem.to_string())))
    }
}

impl std::error::Error for InputError {}

impl Diagnostic for InputError {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        let allowed = self.0.problem.allowed()?;
        Some(Box::new(short_numbers(&visible(&allowed)).into_owned()))
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.0.place.as_ref().filter(|place| place.showable).map(|_| &self.0.source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let place = self.0.place.as_ref().filter(|place| place.showable)?;
        let span = LabeledSpan::new_with_span(Some("here".to_owned()), place.span.clone());
        Some(Box::new(core::iter::once(span)))
    }
}

/// Error of a higher layer. Two are equal if their texts are.
#[derive(Clone, Debug)]
pub struct Cause(Arc<dyn Error + Send + Sync>);

impl Cause {
    /// The cause of a problem.
    pub fn new(error: impl Error + Send + Sync + 'static) -> Self {
        Self(Arc::new(error))
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl Error for Cause {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.0.source()
    }
}

impl PartialEq for Cause {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_string() == other.0.to_string()
    }
}

/// Problem with a key or its value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The file cannot be read.
    #[error("cannot be read: {reason}")]
    Unreadable {
        /// Message of the operating system.
        reason: String,
    },
    /// The file is not TOML.
    #[error("not valid TOML: {reason}")]
    Syntax {
        /// Message of the parser.
        reason: String,
    },
    /// A key that does not exist.
    #[error("unknown key")]
    UnknownKey {
        /// The most similar existing key.
        suggestion: Option<String>,
        /// The keys allowed here.
        allowed: String,
    },
    /// A required key is missing.
    #[error("the key `{key}` is missing")]
    MissingKey {
        /// The key.
        key: String,
    },
    /// Two keys with the same meaning, or that contradict each other.
    #[error("cannot stand beside `{other}`: give one of them")]
    Conflict {
        /// The other key.
        other: String,
    },
    /// A value of another type.
    #[error("{found} instead of {expected}")]
    WrongType {
        /// Expected type or shape.
        expected: &'static str,
        /// Found type or shape.
        found: &'static str,
    },
    /// A value outside what is allowed.
    #[error("not allowed")]
    OutOfRange {
        /// Allowed values.
        allowed: String,
    },
    /// A list or matrix of another size.
    #[error("{found} instead of {expected}")]
    WrongShape {
        /// The shape it should have.
        expected: String,
        /// The shape it has.
        found: String,
    },
    /// A matrix that is not symmetric.
    #[error("not symmetric: entry ({row}, {column}) is {upper}, entry ({column}, {row}) is {lower}")]
    NotSymmetric {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The entry.
        upper: f64,
        /// Its mirror image.
        lower: f64,
    },
    /// A mass that is not positive definite.
    #[error("not positive definite (smallest eigenvalue {smallest:e})")]
    NotPositiveDefinite {
        /// The smallest eigenvalue.
        smallest: f64,
    },
    /// A damping coefficient that is not positive semidefinite.
    #[error("not positive semidefinite (smallest eigenvalue {smallest:e})")]
    NotPositiveSemidefinite {
        /// The smallest eigenvalue.
        smallest: f64,
    },
    /// An expression that cannot be used.
    #[error("{0}")]
    Expression(ExpressionError),
    /// A parameter with a name that cannot be one.
    #[error("this name cannot be a parameter: {0}")]
    ParameterName(ParameterNameError),
    /// A value that is not finite where the run begins.
    #[error("{what} is not finite at {place}")]
    NotFinite {
        /// Name of the quantity that is not finite.
        what: &'static str,
        /// Position or time at which it is not finite.
        place: String,
    },
    /// The step is so long that the numerical solution grows although the exact one does not.
    #[error("unstable: {}", largest_stable(*.largest_step))]
    Unstable {
        /// The largest stable step; `None` if there is none of practical size.
        largest_step: Option<f64>,
        /// Advice.
        advice: String,
    },
    /// A value that fvi-core refuses in the precision of the run.
    #[error("cannot be used in this precision: {reason}")]
    Precision {
        /// Error of fvi-core.
        reason: String,
    },
    /// The memory engine cannot serve the scheme.
    #[error("{0}")]
    Engine(Cause),
    /// Two settings that cannot be combined.
    #[error("does not go together with {with}")]
    Incompatible {
        /// The other setting.
        with: String,
        /// Values that can be combined.
        allowed: String,
    },
    /// A value that another file, to which this one refers, does not allow.
    #[error("{file} cannot take it: {reason}")]
    Refused {
        /// The other file.
        file: String,
        /// The problem, and what is allowed.
        reason: String,
    },
    /// A value that cannot be used for a reason given in a sentence.
    #[error("{reason}")]
    Unusable {
        /// The reason.
        reason: String,
    },
    /// A file of numbers that cannot be used.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: String,
        /// The problem, with its place in the file.
        reason: String,
    },
    /// A line of a table file that cannot be used.
    #[error("{file}, line {line}: {reason}")]
    Table {
        /// The table file.
        file: String,
        /// Its line, from 1.
        line: u64,
        /// The problem there.
        reason: String,
    },
}

fn largest_stable(step: Option<f64>) -> String {
    match step {
        Some(step) => format!("the largest stable step is about {step:.2e}"),
        None => "motions grow at every shorter step too".to_owned(),
    }
}

impl Problem {
    /// Allowed values, if they can be stated.
    pub fn allowed(&self) -> Option<String> {
        match self {
            Self::UnknownKey { suggestion: Some(near), allowed } => {
                Some(format!("did you mean `{near}`? Keys here: {allowed}"))
            }
            Self::UnknownKey { suggestion: None, allowed } => Some(format!("keys here: {allowed}")),
            Self::OutOfRange { allowed } => Some(format!("allowed: {allowed}")),
            Self::Incompatible { allowed, .. } => Some(format!("allowed: {allowed}")),
            Self::NotSymmetric { .. } => Some("allowed: a symmetric matrix".to_owned()),
            Self::NotPositiveDefinite { .. } => Some(
                "allowed: a symmetric positive definite matrix (diagonal: every number > 0); rows and columns of zeros are \
                 coordinates without mass"
                    .to_owned(),
            ),
            Self::NotPositiveSemidefinite { .. } => Some(
                "allowed: a symmetric positive semidefinite matrix (diagonal: every number ≥ 0)".to_owned(),
            ),
            Self::Expression(error) => error.advice(),
            Self::Unstable { advice, .. } => Some(advice.clone()),
            _ => None,
        }
    }
}
