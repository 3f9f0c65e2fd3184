//! Defines the usage errors that clap can't detect: arguments that conflict, are missing or have invalid values.

use clap::error::ErrorKind;

use crate::printable::one_line;

/// A usage error of a verb, shown in clap's format: with the usage, and exit code 2.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{message}")]
pub struct Usage {
    kind: ErrorKind,
    message: String,
}

impl Usage {
    /// Creates the error for arguments that exclude each other.
    pub fn conflict(message: impl Into<String>) -> Self {
        Self { kind: ErrorKind::ArgumentConflict, message: message.into() }
    }

    /// Creates the error for a missing argument that another argument requires.
    pub fn missing(message: impl Into<String>) -> Self {
        Self { kind: ErrorKind::MissingRequiredArgument, message: message.into() }
    }

    /// Creates the error for an argument with an invalid value.
    pub fn invalid(message: impl Into<String>) -> Self {
        Self { kind: ErrorKind::ValueValidation, message: message.into() }
    }

    /// Returns the error as clap would show it for `command`.
    pub(crate) fn of(&self, mut command: clap::Command) -> clap::Error {
        command.error(self.kind, one_line(&self.message))
    }
}
