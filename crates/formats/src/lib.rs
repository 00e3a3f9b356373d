//! Binary motion-capture formats, read and written without the engine: hostile bytes end in a [`FormatError`], never in
//! a panic or an allocation larger than the input justifies.

mod bytes;
pub mod c3d;
pub mod x2d;

use thiserror::Error;

/// Why bytes are not a file of the expected format.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FormatError {
    /// The data ends before what was announced.
    #[error("the file ends at byte {length}, but {what} needs byte {needed}")]
    Truncated {
        /// What was being read.
        what: &'static str,
        /// One past the last byte needed.
        needed: usize,
        /// Length of the file.
        length: usize,
    },
    /// The file does not start like one of this format.
    #[error("not a {format} file: {why}")]
    NotThis {
        /// Name of the format.
        format: &'static str,
        /// What is wrong.
        why: String,
    },
    /// A value contradicts the format or another value.
    #[error("{what} at byte {at}: {why}")]
    Invalid {
        /// The field.
        what: &'static str,
        /// Where it stands.
        at: usize,
        /// What is wrong.
        why: String,
    },
}
