//! Removes a main effect of an interaction from a design if a covariate already contains this main effect. For example,
//! if the subjects are a covariate, they contain the effect of the group, because each subject is in one group.
//!
//! The remaining columns span the same space, and the interaction has the same meaning.

use std::collections::HashMap;

use super::terms::{Coded, Column, Term, distinct};

/// Returns the name of the first covariate with levels such that `column` is constant within each level, or `None` if
/// no covariate has this property.
pub(crate) fn container<'a>(name: &str, column: &Column, covariates: &'a [Term]) -> Option<&'a str> {
    covariates.iter().find_map(|term| match term {
        Term::Column(other, Column::Levels(of)) if other != name && is_constant(column, of) => Some(other.as_str()),
        _ => None,
    })
}

fn is_constant(column: &Column, of: &[String]) -> bool {
    fn once_each<T: PartialEq>(values: &[T], of: &[String]) -> bool {
        let mut first = HashMap::new();
        values.iter().zip(of).all(|(value, level)| *first.entry(level).or_insert(value) == value)
    }
    match column {
        Column::Numbers(numbers) => once_each(numbers, of),
        Column::Levels(levels) => once_each(levels, of),
    }
}

/// If a covariate contains a main effect of an interaction of two columns, removes the columns and weights of this main
/// effect from the interaction's design. The design consists of `base`, which has the columns of levels or the
/// constant, and `slopes`.
pub(crate) fn leave_out(
    (base, slopes, weights): (&mut Coded, &mut Coded, &mut [Vec<f64>]),
    columns: &[(String, Column); 2],
    covariates: &[Term],
) {
    let [(first, a), (second, b)] = columns;
    let contained = [container(first, a, covariates).is_some(), container(second, b, covariates).is_some()];
    let n = a.len();
    let levels = base.len();
    // If covariates contain both main effects, nothing is removed. Creating the design then fails because of linear
    // dependence.
    let kept: Vec<bool> = match (a, b, contained) {
        (Column::Levels(_), Column::Levels(of), [true, false]) => {
            let count = distinct(of).len();
            (0..levels).map(|cell| cell % count > 0).collect()
        }
        (Column::Levels(_), Column::Levels(of), [false, true]) => {
            let count = distinct(of).len();
            (0..levels).map(|cell| cell >= count).collect()
        }
        (Column::Levels(_), Column::Numbers(_), [true, false])
        | (Column::Numbers(_), Column::Levels(_), [false, true]) => {
            (0..levels + slopes.len()).map(|at| at >= levels).collect()
        }
        (Column::Levels(_), Column::Numbers(_), [false, true])
        | (Column::Numbers(_), Column::Levels(_), [true, false]) => {
            (0..levels + slopes.len()).map(|at| at != levels).collect()
        }
        (Column::Numbers(_), Column::Numbers(_), [true, false]) => vec![true, false, true, true],
        (Column::Numbers(_), Column::Numbers(_), [false, true]) => vec![true, true, false, true],
        _ => return,
    };
    retain(base, &kept[..levels.min(kept.len())]);
    retain(slopes, kept.get(levels..).unwrap_or_default());
    let with_constant = base.len() < levels;
    if with_constant {
        base.insert(0, ("mean".to_owned(), vec![1.0; n]));
    }
    for row in weights {
        retain(row, &kept);
        if with_constant {
            row.insert(0, 0.0);
        }
    }
}

/// Removes the items for which `kept` is false. Items beyond the end of `kept` aren't removed.
fn retain<T>(items: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter().copied().chain(std::iter::repeat(true));
    items.retain(|_| kept.next().unwrap_or(true));
}
