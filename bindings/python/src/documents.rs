//! Scenarios and problems given in Python: the path of a file, or a dictionary with its keys.

use crate::errors::Failure;
use fvi_scenario::language::{Document, InputError};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use std::path::PathBuf;

/// Where a scenario or a problem comes from.
pub(crate) enum Source {
    /// A file.
    File(PathBuf),
    /// The keys of a file, with its name in titles, the directory of the files that it names, and the
    /// contents of those of them that are given.
    Keys { name: String, directory: PathBuf, keys: Tree, attached: Vec<(String, Vec<u8>)> },
}

impl Source {
    pub(crate) fn is_file(&self) -> bool {
        matches!(self, Self::File(_))
    }

    pub(crate) fn document(&self) -> Result<Document, InputError> {
        match self {
            Self::File(path) => Document::read(path),
            Self::Keys { name, directory, keys, attached } => {
                let document = Document::new(name, directory, &keys.to_toml());
                let attach = |document: Document, (name, content): &(String, Vec<u8>)| {
                    document.with_attached(name, content.as_slice())
                };
                Ok(attached.iter().fold(document, attach))
            }
        }
    }

    /// The failure for an error in the document.
    pub(crate) fn failure(&self, error: &InputError) -> Failure {
        Failure::of_document(error, self.is_file())
    }
}

/// Name, directory, keys, and the given contents of files by the names that the keys use for them.
type KeysInPython<'py> = (String, PathBuf, Bound<'py, PyDict>, Bound<'py, PyDict>);

impl<'py> FromPyObject<'_, 'py> for Source {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if let Ok((name, directory, keys, files)) = given.extract::<KeysInPython<'py>>() {
            let attach = |(name, content): (Bound<'py, PyAny>, Bound<'py, PyAny>)| -> PyResult<_> {
                Ok((name.extract::<String>()?, content.cast::<PyBytes>()?.as_bytes().to_vec()))
            };
            let attached = files.iter().map(attach).collect::<PyResult<_>>()?;
            return Ok(Self::Keys { name, directory, keys: Tree::of(&keys)?, attached });
        }
        Ok(Self::File(given.extract()?))
    }
}

/// Values that a file can hold.
pub(crate) enum Tree {
    Truth(bool),
    Whole(i64),
    Number(f64),
    Text(String),
    List(Vec<Tree>),
    Table(Vec<(String, Tree)>),
}

impl Tree {
    pub(crate) fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        if value.is_instance_of::<PyBool>() {
            Ok(Self::Truth(value.extract()?))
        } else if value.is_instance_of::<PyInt>() {
            Ok(Self::Whole(value.extract()?))
        } else if value.is_instance_of::<PyFloat>() {
            Ok(Self::Number(value.extract()?))
        } else if let Ok(text) = value.cast::<PyString>() {
            Ok(Self::Text(text.to_str()?.to_owned()))
        } else if let Ok(table) = value.cast::<PyDict>() {
            let entry = |(key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
                Ok((key.extract::<String>()?, Self::of(&value)?))
            };
            Ok(Self::Table(table.iter().map(entry).collect::<PyResult<_>>()?))
        } else if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
            let entries = value.try_iter()?.map(|entry| Self::of(&entry?));
            Ok(Self::List(entries.collect::<PyResult<_>>()?))
        } else {
            let name = value.get_type().name()?;
            Err(PyTypeError::new_err(format!("a scenario cannot hold a value of type {name}")))
        }
    }
}

impl Tree {
    /// The equivalent TOML document with its keys in the same order, which is that of the axes of a sweep.
    /// (The serialiser of the TOML library puts tables behind all other values.)
    pub(crate) fn to_toml(&self) -> String {
        let mut text = String::new();
        if let Self::Table(entries) = self {
            for (key, value) in entries {
                write_text(key, &mut text);
                text += " = ";
                value.write_inline(&mut text);
                text.push('\n');
            }
        }
        text
    }

    fn write_inline(&self, text: &mut String) {
        match self {
            Self::Truth(truth) => *text += if *truth { "true" } else { "false" },
            Self::Whole(whole) => *text += &whole.to_string(),
            Self::Number(number) if number.is_nan() => *text += "nan",
            Self::Number(number) => *text += &format!("{number:?}"),
            Self::Text(words) => write_text(words, text),
            Self::List(entries) => {
                text.push('[');
                for (index, entry) in entries.iter().enumerate() {
                    if index > 0 {
                        *text += ", ";
                    }
                    entry.write_inline(text);
                }
                text.push(']');
            }
            Self::Table(entries) => {
                for (index, (key, value)) in entries.iter().enumerate() {
                    *text += if index == 0 { "{" } else { ", " };
                    write_text(key, text);
                    *text += " = ";
                    value.write_inline(text);
                }
                *text += if entries.is_empty() { "{}" } else { "}" };
            }
        }
    }
}

/// A text in quotes.
fn write_text(words: &str, text: &mut String) {
    text.push('"');
    for letter in words.chars() {
        match letter {
            '"' | '\\' => text.extend(['\\', letter]),
            letter if letter.is_control() => *text += &format!("\\U{:08X}", u32::from(letter)),
            letter => text.push(letter),
        }
    }
    text.push('"');
}
