//! Scenarios and problems as Python gives them: the path of a file, or a dictionary with the keys of one.

use crate::errors::Failure;
use fvi_host::language::{Document, InputError};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use serde::{Serialize, Serializer};
use std::path::PathBuf;

/// Where a scenario or a problem comes from.
pub(crate) enum Source {
    /// A file.
    File(PathBuf),
    /// The contents of one, with the name it has in titles, the directory in which files it names are sought, and those of
    /// them that are at hand.
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
                let document = Document::of_value(name, directory, keys)?;
                let attach = |document: Document, (name, content): &(String, Vec<u8>)| {
                    document.with_attached(name, content.as_slice())
                };
                Ok(attached.iter().fold(document, attach))
            }
        }
    }

    /// What is wrong with the document.
    pub(crate) fn failure(&self, error: &InputError) -> Failure {
        Failure::of_document(error, self.is_file())
    }
}

/// Name, directory, keys, and files at hand by the names that the keys have for them.
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
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
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

impl Serialize for Tree {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Truth(truth) => serializer.serialize_bool(*truth),
            Self::Whole(whole) => serializer.serialize_i64(*whole),
            Self::Number(number) => serializer.serialize_f64(*number),
            Self::Text(text) => serializer.serialize_str(text),
            Self::List(entries) => serializer.collect_seq(entries),
            Self::Table(entries) => serializer.collect_map(entries.iter().map(|(key, value)| (key, value))),
        }
    }
}
