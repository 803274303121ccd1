//! Reading typed values out of a TOML file, with errors that point at them.

use super::encoding::decoded;
use super::error::{InputError, Problem};
use crate::language::excerpt::excerpt;
use crate::language::expression::{Expression, Symbols, nearest};
use crate::language::input_file::{read_data, read_document};
use crate::language::matrix_file::{self, Arrays, FileMatrix};
use crate::language::value_at;
use core::ops::{Range, RangeInclusive};
use serde::Serialize;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A TOML file: its name for messages and its text.
#[derive(Clone, Debug)]
pub struct Document {
    name: String,
    directory: PathBuf,
    text: String,
    /// Files supplied in memory that the document may refer to: name and content.
    attached: Vec<(String, Arc<[u8]>)>,
    /// Cache of files that have been read, shared by copies of the document.
    kept: Option<Arc<Mutex<KeptFiles>>>,
}

/// Contents of files by their paths.
type KeptFiles = HashMap<PathBuf, Arc<[u8]>>;

impl Document {
    /// Reads the file.
    ///
    /// # Errors
    /// [`Problem::Unreadable`].
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let name = path.display().to_string();
        let bytes = read_document(path).map_err(|error| {
            InputError::unreadable(&name, Problem::Unreadable { reason: error.to_string() })
        })?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let (valid, reason) =
                (error.utf8_error().valid_up_to(), not_text(error.as_bytes(), &error.utf8_error()));
            let readable = String::from_utf8_lossy(error.as_bytes());
            let problem = Problem::Unreadable { reason };
            InputError::new(
                &name,
                &readable,
                "",
                String::new(),
                Some(valid..valid + '\u{FFFD}'.len_utf8()),
                problem,
            )
        })?;
        let directory = path.parent().map(Path::to_path_buf).unwrap_or_default();
        Ok(Self { name, directory, text, attached: Vec::new(), kept: None })
    }

    /// A document from text; relative paths in it are resolved in `directory`.
    pub fn new(name: &str, directory: &Path, text: &str) -> Self {
        let (name, directory, text) = (name.to_owned(), directory.to_owned(), text.to_owned());
        Self { name, directory, text, attached: Vec::new(), kept: None }
    }

    /// A document from a value that serialises to the keys of a file, such as a map or a struct.
    ///
    /// # Errors
    /// [`Problem::Unreadable`] if the value is no table, or contains something that TOML cannot represent.
    pub fn of_value(name: &str, directory: &Path, value: &impl Serialize) -> Result<Self, InputError> {
        let text = toml::to_string(value).map_err(|error| {
            InputError::unreadable(name, Problem::Unreadable { reason: error.to_string() })
        })?;
        Ok(Self::new(name, directory, &text))
    }

    /// The document with a file supplied in memory: where the document refers to `name`, its content is
    /// `content`.
    pub fn with_attached(mut self, name: &str, content: impl AsRef<[u8]>) -> Self {
        self.attached.push((name.to_owned(), content.as_ref().into()));
        self
    }

    /// The document with a cache of files, so that it and its copies read each file only once.
    pub fn reading_once(self) -> Self {
        Self { kept: Some(Arc::default()), ..self }
    }

    /// The name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// A path written in the file, relative to the file's own directory.
    pub fn resolve(&self, path: &str) -> PathBuf {
        self.directory.join(path)
    }

    /// Its values, without their places.
    ///
    /// # Errors
    /// [`Problem::Syntax`].
    pub fn values(&self) -> Result<toml::Table, InputError> {
        self.with_root(|_| Ok(()))?;
        toml::from_str(&self.text).map_err(|error| {
            let reason = error.message().lines().collect::<Vec<_>>().join("; ");
            self.error("", String::new(), error.span().unwrap_or(0..0), Problem::Syntax { reason })
        })
    }

    /// The keys of the table at a path as they are written, without their places; none if it is no table.
    ///
    /// # Errors
    /// [`Problem::Syntax`].
    pub fn table_at(&self, path: &str) -> Result<toml::Table, InputError> {
        Ok(value_at(&self.values()?, path).and_then(toml::Value::as_table).cloned().unwrap_or_default())
    }

    /// A document with other values, of the same name and with the same files.
    pub fn with_values(&self, values: &toml::Table) -> Self {
        Self { text: values.to_string(), ..self.clone() }
    }

    /// The content of the attached file of this name.
    pub(crate) fn attached(&self, name: &str) -> Option<Arc<[u8]>> {
        self.attached.iter().find(|(known, _)| known == name).map(|(_, content)| Arc::clone(content))
    }

    /// The bytes of a file that the document refers to: attached to it, or in its directory.
    pub(crate) fn read_bytes_named(&self, path: &str) -> std::io::Result<Vec<u8>> {
        if let Some((_, content)) = self.attached.iter().find(|(name, _)| name == path) {
            return Ok(content.to_vec());
        }
        let path = self.resolve(path);
        let Some(kept) = &self.kept else { return read_data(&path) };
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(bytes) = kept.get(&path) {
            return Ok(bytes.to_vec());
        }
        let bytes = read_data(&path)?;
        kept.insert(path, bytes.as_slice().into());
        Ok(bytes)
    }

    /// The content of a file that the document refers to: attached to it, or in its directory.
    ///
    /// # Errors
    /// If it cannot be read, or is not text in UTF-8.
    pub fn read_named(&self, path: &str) -> std::io::Result<String> {
        String::from_utf8(self.read_bytes_named(path)?).map_err(|error| {
            let reason = not_text(error.as_bytes(), &error.utf8_error());
            std::io::Error::new(std::io::ErrorKind::InvalidData, reason)
        })
    }

    /// The same for a table of numbers, in the encodings of spreadsheets and instruments too.
    pub(crate) fn read_encoded(&self, path: &str) -> std::io::Result<String> {
        decoded(self.read_bytes_named(path)?)
            .map_err(|reason| std::io::Error::new(std::io::ErrorKind::InvalidData, reason))
    }

    /// The contents of those of `names` that are attached or name files in its directory.
    pub fn files_among<'a>(
        &self,
        names: impl IntoIterator<Item = &'a str>,
    ) -> std::io::Result<Vec<(String, Vec<u8>)>> {
        let attached = |name: &str| self.attached.iter().any(|(known, _)| known == name);
        let files = names.into_iter().filter(|name| attached(name) || self.resolve(name).is_file());
        files.map(|name| Ok((name.to_owned(), self.read_bytes_named(name)?))).collect()
    }

    /// Parses the file and calls `read` with its root table.
    ///
    /// # Errors
    /// [`Problem::Syntax`], and those of `read`.
    pub fn with_root<R>(
        &self,
        read: impl FnOnce(Table<'_>) -> Result<R, InputError>,
    ) -> Result<R, InputError> {
        let root = DeTable::parse(&self.text).map_err(|error| {
            let reason = error.message().lines().collect::<Vec<_>>().join("; ");
            self.error("", String::new(), error.span().unwrap_or(0..0), Problem::Syntax { reason })
        })?;
        read(Table { document: self, path: String::new(), span: 0..0, entries: root.get_ref(), beside: &[] })
    }

    /// The document that this one, whose allowed keys are `keys`, refers to as its `scenario`.
    ///
    /// # Errors
    /// If there is another key, or no such document.
    pub fn scenario(&self, keys: &[&str]) -> Result<Self, InputError> {
        let path = self.with_root(|root| {
            root.allow(keys)?;
            Ok(self.resolve(root.required("scenario")?.text()?))
        })?;
        Self::read(&path)
    }

    pub(crate) fn error_at(&self, path: &str, problem: Problem) -> InputError {
        let located = DeTable::parse(&self.text).ok().and_then(|root| locate(root.get_ref(), path));
        let value = located.as_ref().map(|span| self.excerpt(span)).unwrap_or_default();
        InputError::new(&self.name, &self.text, path, value, located, problem)
    }

    /// True if the document has a value at `path`.
    pub fn has(&self, path: &str) -> bool {
        DeTable::parse(&self.text).is_ok_and(|root| locate(root.get_ref(), path).is_some())
    }

    fn error(&self, key: &str, value: String, span: Range<usize>, problem: Problem) -> InputError {
        InputError::new(&self.name, &self.text, key, value, Some(span), problem)
    }

    /// The value as written, shortened to one line.
    fn excerpt(&self, span: &Range<usize>) -> String {
        excerpt(self.text.get(span.clone()).unwrap_or_default())
    }
}

/// Message about the first bytes that are not UTF-8.
fn not_text(bytes: &[u8], error: &core::str::Utf8Error) -> String {
    let place = error.valid_up_to();
    let line = bytes.iter().take(place).filter(|&&byte| byte == b'\n').count() + 1;
    format!("not text in UTF-8: line {line}, byte {} of the file", place + 1)
}

/// The span of the value at a path, if the file has one.
fn locate(root: &DeTable<'_>, path: &str) -> Option<Range<usize>> {
    let mut table = Some(root);
    let mut found = None;
    for part in path.split('.') {
        let (key, indices) = part.split_once('[').unwrap_or((part, ""));
        let mut value = table?.get(key)?;
        for index in indices.split(['[', ']']).filter_map(|digits| digits.parse::<usize>().ok()) {
            value = value.get_ref().as_array()?.get(index)?;
        }
        found = Some(value.span());
        table = value.get_ref().as_table();
    }
    found
}

/// A table of the file.
#[derive(Clone)]
pub struct Table<'a> {
    document: &'a Document,
    path: String,
    span: Range<usize>,
    entries: &'a DeTable<'a>,
    /// Keys that are allowed here but read elsewhere.
    beside: &'static [&'static str],
}

impl<'a> Table<'a> {
    /// The same table for a reader of some of its keys only: `keys`, which are read elsewhere, are allowed
    /// too.
    pub fn beside(&self, keys: &'static [&'static str]) -> Self {
        Self { beside: keys, ..self.clone() }
    }

    /// Refuses every key that is not listed, at the first one in the file.
    pub fn allow(&self, keys: &[&str]) -> Result<(), InputError> {
        let keys: Vec<&str> = keys.iter().chain(self.beside).copied().collect();
        let mut unknown: Vec<_> =
            self.entries.keys().filter(|key| !keys.contains(&key.get_ref().as_ref())).collect();
        unknown.sort_by_key(|key| key.span().start);
        let Some(first) = unknown.first() else { return Ok(()) };
        let name = first.get_ref().as_ref();
        let problem = Problem::UnknownKey {
            suggestion: nearest(name, keys.iter().copied()).map(str::to_owned),
            allowed: keys.join(", "),
        };
        Err(self.document.error(&self.child(name), String::new(), first.span(), problem))
    }

    /// The value of an optional key.
    pub fn optional(&self, key: &str) -> Option<Value<'a>> {
        let (name, value) = self.entries.get_key_value(key)?;
        Some(Value { document: self.document, path: self.child(key), key_span: name.span(), value })
    }

    /// The value of a required key.
    pub fn required(&self, key: &str) -> Result<Value<'a>, InputError> {
        self.optional(key).ok_or_else(|| self.missing(key))
    }

    /// The value of exactly one of two keys, and whether it is the first.
    pub fn either(&self, first: &str, second: &str) -> Result<(bool, Value<'a>), InputError> {
        match (self.optional(first), self.optional(second)) {
            (Some(value), None) => Ok((true, value)),
            (None, Some(value)) => Ok((false, value)),
            (Some(_), Some(value)) => Err(value.error(Problem::Conflict { other: self.child(first) })),
            (None, None) => Err(self.missing(&format!("{first}` or `{second}"))),
        }
    }

    fn missing(&self, key: &str) -> InputError {
        let problem = Problem::MissingKey { key: key.to_owned() };
        self.document.error(&self.path, String::new(), self.span.clone(), problem)
    }

    /// The keys in the order of the file.
    pub fn entries(&self) -> Vec<(&'a str, Value<'a>)> {
        let mut entries: Vec<_> = self
            .entries
            .iter()
            .map(|(name, value)| {
                let key: &'a str = name.get_ref().as_ref();
                let path = self.child(key);
                (key, Value { document: self.document, path, key_span: name.span(), value })
            })
            .collect();
        entries.sort_by_key(|(_, value)| value.key_span.start);
        entries
    }

    fn child(&self, key: &str) -> String {
        let key = excerpt(key);
        if self.path.is_empty() { key } else { format!("{}.{key}", self.path) }
    }
}

/// A value of the file with its location.
#[derive(Clone)]
pub struct Value<'a> {
    document: &'a Document,
    path: String,
    key_span: Range<usize>,
    value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Value<'a> {
    /// An error about this value.
    pub fn error(&self, problem: Problem) -> InputError {
        let span = self.value.span();
        self.document.error(&self.path, self.document.excerpt(&span), span, problem)
    }

    /// An error about this value's key.
    pub fn key_error(&self, problem: Problem) -> InputError {
        self.document.error(&self.path, String::new(), self.key_span.clone(), problem)
    }

    /// An error that lists the allowed values.
    pub fn out_of_range(&self, allowed: impl Into<String>) -> InputError {
        self.error(Problem::OutOfRange { allowed: allowed.into() })
    }

    fn wrong_type(&self, expected: &'static str) -> InputError {
        let found = match self.value.get_ref() {
            DeValue::String(_) => "a text",
            DeValue::Integer(_) => "a whole number",
            DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "a truth value",
            DeValue::Datetime(_) => "a date or time",
            DeValue::Array(_) => "a list",
            DeValue::Table(_) => "a table",
        };
        self.error(Problem::WrongType { expected, found })
    }

    /// A table.
    pub fn table(&self) -> Result<Table<'a>, InputError> {
        let entries = self.value.get_ref().as_table().ok_or_else(|| self.wrong_type("a table"))?;
        let (path, span) = (self.path.clone(), self.key_span.clone());
        Ok(Table { document: self.document, path, span, entries, beside: &[] })
    }

    /// A list.
    pub fn list(&self, expected: &'static str) -> Result<Vec<Value<'a>>, InputError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.wrong_type(expected))?;
        let element = |(index, value): (usize, &'a Spanned<DeValue<'a>>)| Value {
            document: self.document,
            path: format!("{}[{index}]", self.path),
            key_span: value.span(),
            value,
        };
        Ok(array.iter().enumerate().map(element).collect())
    }

    /// True if the value is a list.
    pub fn is_list(&self) -> bool {
        self.value.get_ref().is_array()
    }

    /// True if the value is a text.
    pub(crate) fn is_text(&self) -> bool {
        self.value.get_ref().is_str()
    }

    /// True if the value is a table.
    pub fn is_table(&self) -> bool {
        self.value.get_ref().is_table()
    }

    /// The document that contains it.
    pub fn document(&self) -> &'a Document {
        self.document
    }

    /// An error about the file that this value refers to.
    pub fn file_error(&self, reason: impl Into<String>) -> InputError {
        let file = excerpt(self.text().unwrap_or_default());
        self.error(Problem::File { file, reason: reason.into() })
    }

    /// The matrix in the file that this value refers to.
    pub(crate) fn matrix_file(&self) -> Result<FileMatrix, InputError> {
        self.of_file(matrix_file::read)
    }

    /// The arrays in the file that this value refers to.
    pub(crate) fn arrays(&self) -> Result<Arrays, InputError> {
        self.of_file(Arrays::read)
    }

    /// The keys that lead to it.
    pub(crate) fn path(&self) -> &str {
        &self.path
    }

    fn of_file<R>(&self, read: fn(&str, &[u8]) -> Result<R, String>) -> Result<R, InputError> {
        let name = self.text()?;
        let bytes =
            self.document.read_bytes_named(name).map_err(|error| self.file_error(error.to_string()))?;
        read(name, &bytes).map_err(|reason| self.file_error(reason))
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64, InputError> {
        let digits = match self.value.get_ref() {
            DeValue::Float(float) => float.as_str().parse::<f64>().ok(),
            DeValue::Integer(integer) => {
                i128::from_str_radix(integer.as_str(), integer.radix()).ok().map(|whole| whole as f64)
            }
            _ => return Err(self.wrong_type("a number")),
        };
        digits.filter(|number| number.is_finite()).ok_or_else(|| self.out_of_range("a finite number"))
    }

    /// A finite number > 0.
    pub fn positive(&self) -> Result<f64, InputError> {
        let number = self.number()?;
        if number > 0.0 { Ok(number) } else { Err(self.out_of_range("a number > 0")) }
    }

    /// A whole number in a range.
    pub fn whole(&self, range: RangeInclusive<usize>) -> Result<usize, InputError> {
        let allowed = || {
            if *range.end() == usize::MAX {
                format!("a whole number ≥ {}", range.start())
            } else {
                format!("a whole number from {} to {}", range.start(), range.end())
            }
        };
        let DeValue::Integer(integer) = self.value.get_ref() else {
            return Err(match self.value.get_ref() {
                DeValue::Float(_) => self.out_of_range(allowed()),
                _ => self.wrong_type("a whole number"),
            });
        };
        usize::from_str_radix(integer.as_str(), integer.radix())
            .ok()
            .filter(|whole| range.contains(whole))
            .ok_or_else(|| self.out_of_range(allowed()))
    }

    /// A truth value.
    pub fn truth(&self) -> Result<bool, InputError> {
        self.value.get_ref().as_bool().ok_or_else(|| self.wrong_type("true or false"))
    }

    /// A text.
    pub fn text(&self) -> Result<&'a str, InputError> {
        self.value.get_ref().as_str().ok_or_else(|| self.wrong_type("a text in quotes"))
    }

    /// One of several words.
    pub fn choice<C: Copy>(&self, choices: &[(&str, C)]) -> Result<C, InputError> {
        let word = self.text()?;
        choices.iter().find(|(name, _)| *name == word).map(|&(_, choice)| choice).ok_or_else(|| {
            let names: Vec<_> = choices.iter().map(|(name, _)| format!("\"{name}\"")).collect();
            self.out_of_range(names.join(", "))
        })
    }

    /// A list of numbers.
    pub fn numbers(&self) -> Result<Vec<f64>, InputError> {
        self.list("a list of numbers")?.iter().map(Value::number).collect()
    }

    /// A list of `count` numbers, one for each coordinate, or the name of a file that contains one.
    pub fn vector(&self, count: usize) -> Result<Vec<f64>, InputError> {
        if self.is_text() {
            let vector = self.of_file(matrix_file::read_vector)?;
            return if vector.length == count {
                Ok(vector.numbers())
            } else {
                Err(self.per_coordinate(count, vector.length))
            };
        }
        let numbers = self.numbers()?;
        if numbers.len() == count { Ok(numbers) } else { Err(self.per_coordinate(count, numbers.len())) }
    }

    fn per_coordinate(&self, expected: usize, found: usize) -> InputError {
        self.error(Problem::WrongShape {
            expected: format!("{expected}, one for each coordinate (as many as `system.mass` has)"),
            found: format!("{found} entries"),
        })
    }

    /// An expression in the given names.
    pub fn expression(&self, symbols: &Symbols) -> Result<Expression, InputError> {
        let text = self.text()?;
        Expression::parse(text, symbols).map_err(|error| {
            // In a string without escapes the location is known to the character.
            let whole = self.value.span();
            let inside = whole.start + 1..whole.end.saturating_sub(1);
            let span = match self.document.text.get(inside.clone()) {
                Some(written) if written == text => {
                    inside.start + error.span.start..inside.start + error.span.end
                }
                _ => whole.clone(),
            };
            let value = self.document.excerpt(&whole);
            self.document.error(&self.path, value, span, Problem::Expression(error))
        })
    }

    /// A list of expressions, one for each coordinate.
    pub(crate) fn expressions(&self, symbols: &Symbols, count: usize) -> Result<Vec<Expression>, InputError> {
        let list = self.list("a list of expressions in quotes")?;
        let expressions =
            list.iter().map(|value| value.expression(symbols)).collect::<Result<Vec<_>, _>>()?;
        if expressions.len() == count { Ok(expressions) } else { Err(self.per_coordinate(count, list.len())) }
    }
}
