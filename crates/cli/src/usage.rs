//! Arguments that don't go together in ways that clap can't know.

use clap::error::ErrorKind;

use crate::printable::one_line;

/// An error in how a verb was called, shown as clap shows its own: with the usage, and exit code 2.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{message}")]
pub struct Usage {
    kind: ErrorKind,
    message: String,
}

impl Usage {
    /// Arguments that exclude each other.
    pub fn conflict(message: impl Into<String>) -> Self {
        Self { kind: ErrorKind::ArgumentConflict, message: message.into() }
    }

    /// An argument that another one needs.
    pub fn missing(message: impl Into<String>) -> Self {
        Self { kind: ErrorKind::MissingRequiredArgument, message: message.into() }
    }

    /// An argument with a value that it can't have.
    pub fn invalid(message: impl Into<String>) -> Self {
        Self { kind: ErrorKind::ValueValidation, message: message.into() }
    }

    /// The error as clap would show it for `command`.
    pub(crate) fn of(&self, mut command: clap::Command) -> clap::Error {
        command.error(self.kind, one_line(&self.message))
    }
}
