//! Selects the share of the rows that one of several processes fits.

use std::str::FromStr;

use crate::error::CohortError;

/// The share of a manifest that one process fits: the rows whose index, counted from 0, leaves the remainder `index`
/// when divided by `count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Default for Shard {
    /// Returns the shard that contains all rows.
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = CohortError;

    /// Parses `INDEX/COUNT`, or `slurm` for the shard of the Slurm array task that runs this process.
    fn from_str(text: &str) -> Result<Self, CohortError> {
        if text == "slurm" {
            return Self::of_slurm(|name| std::env::var(name).ok());
        }
        let parts = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
        match parts {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => Err(CohortError::NotAShard { found: text.to_owned() }),
        }
    }
}

impl Shard {
    /// Returns the index of the shard and the number of shards.
    #[must_use]
    pub fn index_and_count(self) -> (usize, usize) {
        (self.index, self.count)
    }

    /// Returns the shard for a task of a Slurm array. The shard's index is the position of the task's number between
    /// `SLURM_ARRAY_TASK_MIN` and `SLURM_ARRAY_TASK_MAX`. `variable` looks up an environment variable.
    ///
    /// # Errors
    ///
    /// [`CohortError::Slurm`] if this process isn't a task of an array, or if the array's task numbers have gaps,
    /// because the tasks then wouldn't cover all rows.
    pub fn of_slurm(variable: impl Fn(&str) -> Option<String>) -> Result<Self, CohortError> {
        let refuse = |problem: String| CohortError::Slurm { problem };
        let number = |name: &str| -> Result<usize, CohortError> {
            let name = format!("SLURM_ARRAY_TASK_{name}");
            let text = variable(&name).ok_or_else(|| {
                refuse(format!("the environment variable {name} isn't set; submit the job with sbatch --array"))
            })?;
            text.parse().map_err(|_| refuse(format!("expected a number in {name}, found {text:?}")))
        };
        let (id, first, last, count) = (number("ID")?, number("MIN")?, number("MAX")?, number("COUNT")?);
        if last.checked_sub(first).and_then(|span| span.checked_add(1)) != Some(count) || !(first..=last).contains(&id)
        {
            return Err(refuse(format!(
                "expected a job array without gaps, found {count} tasks with numbers from {first} to {last} (this is \
                 task {id}); to submit single tasks again, give --shard $SLURM_ARRAY_TASK_ID/N, where N is the number \
                 of tasks of the whole array"
            )));
        }
        Ok(Self { index: id - first, count })
    }

    /// Returns whether a row belongs to this process.
    #[must_use]
    pub fn has(self, row: usize) -> bool {
        row % self.count == self.index
    }

    /// Returns the rows that belong to this process, in order.
    pub fn of<T>(self, rows: &[T]) -> impl Iterator<Item = &T> {
        rows.iter().skip(self.index).step_by(self.count)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn what_is_no_shard_is_refused() {
        for text in ["", "1", "1/1", "0/0", "-1/2", "1/2/3", "a/b", "0/", "Slurm"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_slurm_array_has_all_rows_or_is_refused() {
        let shard = |id: &str, min: &str, max: &str, count: &str| {
            let values = [("ID", id), ("MIN", min), ("MAX", max), ("COUNT", count)];
            let values = values.map(|(name, value)| (format!("SLURM_ARRAY_TASK_{name}"), value.to_owned()));
            Shard::of_slurm(|name| values.iter().find(|(found, _)| found == name).map(|(_, value)| value.clone()))
        };
        assert_eq!(shard("3", "1", "10", "10").unwrap(), Shard { index: 2, count: 10 });
        for (id, min, max, count) in
            [("3", "3", "7", "2"), ("9", "0", "4", "5"), ("x", "0", "4", "5"), ("0", "1", "0", "0")]
        {
            assert!(shard(id, min, max, count).is_err(), "{id} {min} {max} {count}");
        }
        let error = Shard::of_slurm(|_| None).unwrap_err().to_string();
        assert!(error.contains("SLURM_ARRAY_TASK_ID") && error.contains("sbatch --array"), "{error}");
    }

    proptest! {
        #[test]
        fn shards_share_the_rows(rows in 0usize..200, count in 1usize..20) {
            let all: Vec<usize> = (0..rows).collect();
            let mut found = Vec::new();
            for index in 0..count {
                let shard: Shard = format!("{index}/{count}").parse().unwrap();
                let own: Vec<usize> = shard.of(&all).copied().collect();
                prop_assert!(own.iter().all(|&row| shard.has(row)) && own.len() <= rows.div_ceil(count));
                found.extend(own);
            }
            found.sort_unstable();
            prop_assert_eq!(found, all);
        }
    }
}
