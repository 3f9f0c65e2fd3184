//! Chooses the members from which a group's alignment starts.
//!
//! A generalised Procrustes analysis has local optima, and its result depends on the template, the member to which all
//! members are first aligned. In groups of up to [`ALL`] members each member is tried as a template. In larger groups
//! the members are ranked by the sum of their distances from the other members after one alignment. The templates are
//! the medoid, whose sum is smallest, and four more members at evenly spaced ranks. In groups of more than 500 members,
//! distances are measured only to every second member, in groups of more than 1,000 members only to every third member,
//! and so on. Before distances are measured, all members are aligned to the first member, so the choice of templates
//! depends on the order of the members.

use rayon::prelude::*;

/// Maximum size of a group whose members are all used as templates.
pub(crate) const ALL: usize = 20;
/// Number of templates in a larger group.
const FEW: usize = 5;
/// Maximum number of members to which distances are measured. Distances to more members don't change the choice of
/// templates.
const ENOUGH: usize = 500;

/// Returns the members to use as templates: all members of a small group, otherwise the medoid and a few other members.
/// `aligned` returns the members' coefficients (members, K, 3) after one alignment, and is called for large groups
/// only.
pub(crate) fn templates<E>(
    members: usize,
    most: Option<usize>,
    aligned: impl FnOnce() -> Result<Vec<Vec<[f64; 3]>>, E>,
) -> Result<Vec<usize>, E> {
    let wanted = most.unwrap_or(if members <= ALL { members } else { FEW }).clamp(1, members);
    if wanted == members {
        return Ok((0..members).collect());
    }
    let aligned = aligned()?;
    let some = aligned.len().div_ceil(ENOUGH);
    let sum = |a: &Vec<[f64; 3]>| -> f64 { aligned.iter().step_by(some).map(|b| separation(a, b)).sum() };
    let sums: Vec<f64> = aligned.par_iter().map(sum).collect();
    let mut order: Vec<usize> = (0..members).collect();
    order.sort_by(|&a, &b| sums[a].total_cmp(&sums[b]).then(a.cmp(&b)));
    // The templates are evenly spaced over the ranks, starting with the medoid. The members with the last ranks are
    // outliers and aren't used.
    Ok((0..wanted).map(|n| order[n * members / wanted]).collect())
}

fn separation(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let square: f64 = a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b) * (a - b)).sum();
    square.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_medoid_is_first_in_a_large_group() {
        // The members are points on a line at 0, 1, 4, 9, and so on. The median point has the smallest sum of
        // distances.
        let aligned = || Ok::<_, ()>((0..25).map(|i| vec![[(i * i) as f64, 0.0, 0.0]]).collect());
        let found = templates(25, None, aligned).unwrap();
        assert_eq!((found[0], found.len()), (12, FEW));
        assert_eq!(templates(7, None, || Err("unused")), Ok((0..7).collect()));
        assert_eq!(templates(7, Some(1), || Ok::<_, ()>(vec![vec![[0.0; 3]]; 7])).unwrap().len(), 1);
    }
}
