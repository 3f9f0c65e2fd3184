//! Defines `--memory`, and checks the memory of every verb before anything is allocated.
//!
//! In the library's crates, each computation has a function that returns the memory that the computation needs
//! (`docs/memory.md` lists these functions). This module compares the needed memory with the budget and formats the
//! error message.

use std::fmt;
use std::path::Path;

use anyhow::Result;
use clap::Args;
use spharm::machine::available_memory;
use spharm_surface::io::bytes_to_read;

use crate::help::RESOURCES;
use crate::size::Size;

/// Memory of the program itself in bytes: its code, its allocator, and the buffers of files.
pub const PROGRAM: u64 = 20 << 20;

/// Size of a thread's stack in bytes. Limits on the memory of a process count the whole stack, whether it is used or
/// not.
const STACK: u64 = 2 << 20;

/// Argument `--memory`.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct Memory {
    /// Memory budget [default: all free memory]
    ///
    /// Work that doesn't fit is refused before it starts. Free memory is the minimum of the machine's free memory, the
    /// limits of control groups and the limits set by ulimit.
    #[arg(long, value_name = "SIZE", help_heading = RESOURCES)]
    pub memory: Option<Size>,
}

impl Memory {
    /// Returns the arguments that pass the budget on to another verb; no arguments if no budget was given.
    pub fn arguments(self) -> impl Iterator<Item = String> {
        self.memory.into_iter().flat_map(|Size(bytes)| ["--memory".to_owned(), bytes.to_string()])
    }

    /// Returns the given budget, or else the free memory minus the stacks of `threads` threads.
    pub fn budget(self, threads: usize) -> Budget {
        match self.memory {
            Some(Size(bytes)) => Budget { bytes: bytes as u64, given: true },
            None => Budget { bytes: beside_stacks(available_memory() as u64, threads), given: false },
        }
    }
}

/// Returns the free memory minus the stacks of the threads.
fn beside_stacks(free: u64, threads: usize) -> u64 {
    free.saturating_sub(STACK.saturating_mul(threads as u64))
}

/// Amount of memory that a verb may use.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    bytes: u64,
    given: bool,
}

/// Error for work that doesn't fit into the memory budget. Its message is one line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct TooLarge {
    what: String,
    needed: u64,
    bytes: u64,
    given: bool,
    /// Nearest setting that fits into the budget, and its memory in bytes.
    nearest: Option<(String, u64)>,
}

impl fmt::Display for TooLarge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = |bytes: u64| Size(usize::try_from(bytes).unwrap_or(usize::MAX));
        write!(f, "{} needs {} of memory, ", self.what, size(self.needed))?;
        match self.given {
            true => write!(f, "but --memory is {}", size(self.bytes))?,
            false => write!(f, "but only {} are free", size(self.bytes))?,
        }
        match (&self.nearest, self.given) {
            (Some((setting, needed)), _) => write!(f, "; {setting} needs only {}", size(*needed)),
            (None, true) => f.write_str("; raise --memory"),
            (None, false) => {
                f.write_str("; use a machine with more free memory, or raise the memory limit of the process")
            }
        }
    }
}

impl Budget {
    /// Returns the number of bytes available to the work: the budget minus the memory of the program itself.
    pub fn work(self) -> u64 {
        self.bytes.saturating_sub(PROGRAM)
    }

    /// Returns whether work that needs this many bytes fits into the budget.
    pub fn fits(self, needed: u64) -> bool {
        needed <= self.work()
    }

    /// Checks that `needed` bytes fit into the budget. `what` names the verb and its inputs.
    ///
    /// # Errors
    ///
    /// [`TooLarge`] if the work doesn't fit.
    pub fn check(self, what: impl fmt::Display, needed: u64) -> Result<()> {
        self.check_or(what, needed, std::iter::empty())
    }

    /// Checks that `needed` bytes fit into the budget. `others` lists alternative settings and the number of bytes that
    /// each needs. The error names the first setting that fits.
    ///
    /// # Errors
    ///
    /// [`TooLarge`] if the work doesn't fit.
    pub fn check_or(
        self,
        what: impl fmt::Display,
        needed: u64,
        others: impl IntoIterator<Item = (String, u64)>,
    ) -> Result<()> {
        if self.fits(needed) {
            return Ok(());
        }
        let nearest = others.into_iter().find(|(_, needed)| self.fits(*needed));
        let nearest = nearest.map(|(setting, needed)| (setting, needed.saturating_add(PROGRAM)));
        let needed = needed.saturating_add(PROGRAM);
        Err(TooLarge { what: what.to_string(), needed, bytes: self.bytes, given: self.given, nearest }.into())
    }

    /// Checks, before any of the files is read, that all of them together fit into the budget.
    ///
    /// # Errors
    ///
    /// [`TooLarge`] if the files don't fit.
    pub fn check_inputs<'a>(self, verb: &str, paths: impl IntoIterator<Item = &'a Path>) -> Result<()> {
        let (mut needed, mut first, mut count) = (0_u64, None, 0_usize);
        for path in paths {
            needed = needed.saturating_add(bytes_to_read(path));
            first.get_or_insert(path);
            count += 1;
        }
        let Some(first) = first else { return Ok(()) };
        let more = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
        self.check(format_args!("{verb}: reading {}{more}", first.display()), needed)
    }
}

/// Returns the round numbers (1, 2, 5, 10, 20, ...) up to `most`, in decreasing order.
pub fn round_numbers_below(most: u64) -> impl Iterator<Item = u64> {
    let powers = std::iter::successors(Some(1_u64), |power| power.checked_mul(10));
    let mut numbers: Vec<u64> = powers.flat_map(|p| [Some(p), p.checked_mul(2), p.checked_mul(5)]).flatten().collect();
    numbers.reverse();
    numbers.into_iter().filter(move |number| *number < most)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(bytes: u64) -> Budget {
        Memory { memory: Some(Size(bytes as usize)) }.budget(2)
    }

    #[test]
    fn a_refusal_names_both_figures_and_the_nearest_setting() {
        let (budget, gib) = (given(1 << 30), 1_u64 << 30);
        budget.check("work", gib - PROGRAM).unwrap();
        let line = budget.check("compare a.ply", gib).unwrap_err().to_string();
        assert_eq!(line, "compare a.ply needs 1.02 GiB of memory, but --memory is 1.00 GiB; raise --memory");
        let others = (0..12).rev().map(|n| (format!("--icosphere {n}"), gib << 2 >> (12 - n)));
        let line = budget.check_or("--icosphere 12", 4 * gib, others).unwrap_err().to_string();
        let nearest =
            "--icosphere 12 needs 4.02 GiB of memory, but --memory is 1.00 GiB; --icosphere 9 needs only 532.0 MiB";
        assert_eq!(line, nearest);
        assert!(budget.check("sums don't wrap", u64::MAX).is_err());
    }

    #[test]
    fn without_a_size_it_is_what_is_free_but_for_the_threads_stacks() {
        assert_eq!(beside_stacks(1 << 30, 2), (1 << 30) - 2 * STACK);
        assert_eq!(beside_stacks(1 << 20, usize::MAX), 0);
        let line = Memory::default().budget(1).check("it", u64::MAX).unwrap_err().to_string();
        assert!(line.contains("are free"), "{line}");
    }

    #[test]
    fn round_numbers_descend() {
        let found: Vec<u64> = round_numbers_below(100).collect();
        assert_eq!(found, [50, 20, 10, 5, 2, 1]);
        assert!(round_numbers_below(u64::MAX).all(|n| n > 0));
    }
}
