//! Limits the memory for the contents of a file, which can be much larger than the file itself, because the file is
//! compressed or because parts of it are used many times.

use super::flaw::Flaw;
use crate::room::{Bytes, check_room, most_expanded};

/// The memory budget for a file's contents.
#[derive(Debug)]
pub(super) struct Budget {
    left: u64,
    /// Size of the file.
    file: u64,
}

impl Budget {
    /// Returns the budget for the contents of a file of `file` bytes, which is [`most_expanded`] of this size.
    pub(super) fn of_file(file: usize) -> Self {
        Self { left: most_expanded(file as u64), file: file as u64 }
    }

    /// Returns the number of bytes left.
    pub(super) fn left(&self) -> u64 {
        self.left
    }

    /// Takes `bytes` from the budget, before memory is allocated for them. `what` is the beginning of the phrase
    /// "shapes of more than LIMIT" in the error message, such as "shapes of".
    pub(super) fn spend(&mut self, bytes: u64, what: &str) -> Result<(), Flaw> {
        match self.left.checked_sub(bytes) {
            Some(left) => self.left = left,
            None => {
                let limit = Bytes(most_expanded(self.file));
                return Err(Flaw::unsupported(
                    format!("{what} more than {limit} (file size: {})", Bytes(self.file)),
                    "if you trust the file, save its surface as .ply",
                ));
            }
        }
        check_room(bytes)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_spent_cannot_be_spent_again() {
        let mut budget = Budget::of_file(0);
        budget.spend(60 << 20, "shapes of").unwrap();
        assert_eq!(budget.left(), 4 << 20);
        let error = budget.spend(5 << 20, "shapes of").unwrap_err();
        assert!(format!("{error:?}").contains("shapes of more than 64.0 MiB (file size: 0 bytes)"), "{error:?}");
        budget.spend(4 << 20, "shapes of").unwrap();
    }
}
