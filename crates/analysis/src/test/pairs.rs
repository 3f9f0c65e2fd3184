//! Lists the pairs of a paired test, and finds pairs whose names show that they join different subjects.

use std::collections::HashSet;
use std::fmt;
use std::path::{Path, PathBuf};

use spharm_cli::output::{counted, first_of};
use spharm_cli::paths::{model_name, shown};
use spharm_surface::Hemisphere;

/// Largest number of pairs that the warning names.
const NAMED: usize = 3;
/// Maximum number of path components, counted from the end, that are compared: the file's name and two folders.
const PARTS: usize = 3;

/// Pairs that join different subjects, judging by the names of their models.
#[derive(Debug)]
pub(super) struct SubjectsDiffer {
    pairs: Vec<[PathBuf; 2]>,
    of: usize,
}

impl SubjectsDiffer {
    /// Compares the two names of each pair, without the parts that state the side. A pair joins different subjects if
    /// its two names differ, and one of these names also occurs on the other side of another pair. File names that
    /// aren't unique are compared together with the names of their folders. If the names aren't unique even with their
    /// folders, the file names alone are compared, including the parts that state the side.
    pub(super) fn of(first: &[PathBuf], second: &[PathBuf]) -> Option<Self> {
        let unique = |names: &[String]| names.iter().collect::<HashSet<_>>().len() == names.len();
        let named = |parts: usize| [first, second].map(|paths| subjects(paths, parts));
        let with_sides = || [first, second].map(names);
        let mut found = (1..=PARTS).map(named).chain(std::iter::once_with(with_sides));
        let [a, b] = found.find(|[a, b]| unique(a) && unique(b))?;
        let (of_a, of_b): (HashSet<&String>, HashSet<&String>) = (a.iter().collect(), b.iter().collect());
        let differ = |at: &usize| a[*at] != b[*at] && (of_b.contains(&a[*at]) || of_a.contains(&b[*at]));
        let of = first.len().min(second.len());
        let pairs: Vec<_> = (0..of).filter(differ).map(|at| [first[at].clone(), second[at].clone()]).collect();
        (!pairs.is_empty()).then_some(Self { pairs, of })
    }
}

impl fmt::Display for SubjectsDiffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named: Vec<String> =
            self.pairs.iter().map(|[a, b]| format!("{} with {}", a.display(), b.display())).collect();
        write!(
            f,
            "{} of {} seem to join different subjects, judging by the names of the models: {}; unless these pairs are \
             intended, as for matched subjects, list the same subjects in the same order for both models of a pair, \
             and leave out subjects with only one model",
            self.pairs.len(),
            counted(self.of, "pair"),
            first_of(named.iter().map(String::as_str), NAMED)
        )
    }
}

/// Returns the last `parts` components of each path, without the parts of their names that state the side.
fn subjects(paths: &[PathBuf], parts: usize) -> Vec<String> {
    let subject = |path: &PathBuf| {
        let folders = path.parent().into_iter().flat_map(Path::iter).rev().map(|name| name.to_string_lossy());
        let names = std::iter::once(model_name(path)).chain(folders.map(|name| name.into_owned()));
        names.take(parts).map(|name| Hemisphere::and_rest_of(&name).1).collect::<Vec<_>>().join("/")
    };
    paths.iter().map(subject).collect()
}

fn names(paths: &[PathBuf]) -> Vec<String> {
    paths.iter().map(|path| model_name(path)).collect()
}

/// Returns the pairs of models by their names or, if names occur twice in a list, by their paths.
pub(super) fn listed(first: &[PathBuf], second: &[PathBuf]) -> Vec<[String; 2]> {
    let named = |paths: &[PathBuf]| -> Vec<String> {
        let names = names(paths);
        let unique = names.iter().collect::<HashSet<_>>().len() == names.len();
        if unique { names } else { paths.iter().map(shown).collect() }
    };
    named(first).into_iter().zip(named(second)).map(<[String; 2]>::from).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths(names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(|name| PathBuf::from(format!("{name}.spharm.npz"))).collect()
    }

    #[test]
    fn names_of_different_subjects_are_found() {
        let of = |a: &[&str], b: &[&str]| SubjectsDiffer::of(&paths(a), &paths(b)).map(|found| found.pairs.len());
        // The first list lacks the subject s2, and the second list lacks the subject s4.
        for (left, right) in [("lh.", "rh."), ("L_", "R_"), ("left-", "right-"), ("", "")] {
            let named = |side: &str, subjects: [u8; 4]| subjects.map(|n| format!("x/{side}s{n}"));
            let (a, b) = (named(left, [1, 3, 4, 5]), named(right, [1, 2, 3, 5]));
            let [a, b] = [&a, &b].map(|names| names.each_ref().map(String::as_str));
            assert_eq!(of(&a, &b), Some(2), "{left}");
            assert_eq!(of(&a, &a), None);
        }
        assert_eq!(of(&["s1/lh", "s2/lh"], &["s2/rh", "s1/rh"]), Some(2));
        assert_eq!(of(&["s1/lh", "s2/lh"], &["s1/rh", "s2/rh"]), None);
        // Names without a common subject, such as those of twins, don't contradict the pairs.
        assert_eq!(of(&["a1", "a2"], &["b2", "b1"]), None);
        assert_eq!(of(&["x_L", "x_L"], &["x_R", "x_R"]), None);
        // Each list has both sides of each subject.
        assert_eq!(of(&["1_L", "1_R", "2_L"], &["1_L", "2_L", "1_R"]), Some(2));
    }

    #[test]
    fn pairs_are_listed_by_name() {
        let listed = |a: &[&str], b: &[&str]| listed(&paths(a), &paths(b));
        assert_eq!(listed(&["x/s1_L"], &["y/s1_R"]), [["s1_L", "s1_R"]]);
        assert_eq!(listed(&["a/lh", "b/lh"], &["c", "d"])[1], ["b/lh.spharm.npz", "d"]);
    }
}
