//! Finds guiding landmarks that the other guiding landmarks contradict. The corresponding points follow guiding
//! landmarks, so a wrong landmark isn't visible in the finished group. A registration without this landmark reveals it.

use super::{LandmarkCause, MisplacedLandmarks, UNUSUAL, median};

/// A guiding landmark is reported only if it ends up farther from its place than this fraction of the mean surface's
/// extent in a registration without it.
const FAR: f64 = 0.1;

/// Returns a warning for each member with landmarks that end up far from their places in a registration that leaves
/// them out. `distances` has one list per member: the distance of each landmark from its place in that registration.
pub(super) fn contradicted(distances: &[Vec<f64>], extent: f64) -> Vec<MisplacedLandmarks> {
    let Some(usual) = median(distances.iter().flatten().copied()) else { return Vec::new() };
    let least = (FAR * extent).max(UNUSUAL * usual);
    let of_member = |(member, own): (usize, &Vec<f64>)| {
        let far: Vec<usize> = (0..own.len()).filter(|k| own[*k] > least).collect();
        let distance = far.iter().map(|k| own[*k]).reduce(f64::max)?;
        let cause = LandmarkCause::Guiding;
        Some(MisplacedLandmarks { member, swapped: Vec::new(), far, distance, usual, cause })
    };
    distances.iter().enumerate().filter_map(of_member).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guiding_landmarks_that_the_others_contradict_are_named() {
        let mut given = vec![vec![0.3, 0.5, 0.4, 0.2]; 2];
        assert!(contradicted(&given, 35.0).is_empty());
        given[1][2] = 5.0;
        let found = contradicted(&given, 35.0);
        assert!(found.len() == 1 && found[0].member == 1 && found[0].far == [2], "{found:?}");
        let text = found[0].of_member(|landmark| format!("L{landmark}"));
        assert!(text.starts_with("landmarks far from the positions predicted by the other landmarks: L2; "), "{text}");
        // Large errors of all landmarks don't indicate a wrong name.
        assert!(contradicted(&[vec![5.0; 4], vec![5.0; 4]], 35.0).is_empty() && contradicted(&[], 1.0).is_empty());
    }
}
