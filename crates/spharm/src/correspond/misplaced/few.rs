//! Finds swapped landmarks in a group that is too small to have usual places of landmarks. Two landmarks are treated as
//! swapped if exchanging their names makes the members' landmarks nearly congruent. Surfaces aren't used, because the
//! registration may have been guided by the landmarks.

use spharm_surface::geometry::{Vec3, dot, sub};

use super::super::guide::about_their_mean;
use super::super::together::{mean, motion};
use super::{LandmarkCause, MENDED, MisplacedLandmarks, length, median};

/// Minimum number of landmarks. With fewer landmarks, an exchange of two landmarks may improve the fit by chance.
const LEAST: usize = 4;
/// Maximum number of landmarks among which exchanges are tried: those whose positions differ most between members.
const TRIED: usize = 20;
/// Maximum number of exchanges made in a group.
const EXCHANGES: usize = 3;
/// Two landmarks of a member are exchanged only if the exchange reduces the sum of the squared differences between the
/// members' landmarks to this fraction or less.
const LOWERED: f64 = 0.8;
/// Two landmarks are reported as swapped only if the distance of one of them exceeds this multiple of the usual
/// distance. The distance of a landmark is the largest distance between its positions on two members. The usual
/// distance is the median over all landmarks after the exchange.
const UNUSUAL: f64 = 3.0;
/// Number of rounds of Procrustes analysis.
const ROUNDS: usize = 5;

/// Differences of the members' landmarks, which have been scaled to equal size and aligned by Procrustes analysis.
struct Differences {
    /// Sum of squares about the mean.
    squares: f64,
    /// For each landmark, the largest distance between two members' positions.
    apart: Vec<f64>,
}

impl Differences {
    /// Computes the differences between the landmarks of `members`. All members' landmarks must be scaled to the same
    /// size, and each member's landmarks must be relative to their mean.
    fn of(members: &[Vec<Vec3>]) -> Self {
        let onto = |own: &Vec<Vec3>, to: &[Vec3]| -> Vec<Vec3> {
            let moved = motion(own, to, None, false, false);
            own.iter().map(|point| moved.apply(*point)).collect()
        };
        let mut placed: Vec<Vec<Vec3>> = members.iter().map(|own| onto(own, &members[0])).collect();
        for _ in 0..ROUNDS {
            let middle = mean(&placed);
            placed = placed.iter().map(|own| onto(own, &middle)).collect();
        }
        let middle = mean(&placed);
        let off = |(own, middle): (&Vec3, &Vec3)| dot(sub(*own, *middle), sub(*own, *middle));
        let squares = placed.iter().flat_map(|own| own.iter().zip(&middle)).map(off).sum();
        let between = |k: usize| {
            let pairs = placed.iter().enumerate().flat_map(|(i, a)| placed[..i].iter().map(move |b| (a[k], b[k])));
            pairs.map(|(a, b)| length(sub(a, b))).fold(0.0, f64::max)
        };
        Self { squares, apart: (0..middle.len()).map(between).collect() }
    }

    /// Returns the largest distance between two members' positions of landmark k or of landmark l, whichever is larger.
    fn at(&self, [k, l]: [usize; 2]) -> f64 {
        self.apart[k].max(self.apart[l])
    }
}

/// Returns a warning if exchanging landmarks of one member makes the positions of these landmarks on all members much
/// more similar. An exchange is reported only if the positions differed by more than `far` before.
pub(super) fn swapped(positions: &[Vec<Vec3>], far: f64) -> Option<MisplacedLandmarks> {
    let count = positions.first()?.len();
    if positions.len() < 2 || count < LEAST {
        return None;
    }
    let mut members = of_equal_size(positions)?;
    let before = Differences::of(&members);
    let mut tried: Vec<usize> = (0..count).collect();
    tried.sort_by(|k, l| before.apart[*l].total_cmp(&before.apart[*k]));
    tried.truncate(TRIED);
    let (mut now, mut pairs) = (before.squares, Vec::new());
    let mut of_member: Option<usize> = None;
    // In a group of two, an exchange on either member has the same effect.
    let first = usize::from(members.len() == 2);
    for _ in 0..EXCHANGES {
        let mut best: Option<(f64, usize, [usize; 2])> = None;
        for member in (first..members.len()).filter(|member| of_member.is_none_or(|of| of == *member)) {
            for (i, k) in tried.iter().enumerate() {
                for l in &tried[..i] {
                    members[member].swap(*k, *l);
                    let squares = Differences::of(&members).squares;
                    members[member].swap(*k, *l);
                    if best.is_none_or(|(least, ..)| squares < least) {
                        best = Some((squares, member, [*k.min(l), *k.max(l)]));
                    }
                }
            }
        }
        let Some((squares, member, [k, l])) = best.filter(|(squares, ..)| *squares <= LOWERED * now) else { break };
        members[member].swap(k, l);
        (now, of_member) = (squares, Some(member));
        pairs.push([k, l]);
    }
    let member = of_member?;
    let after = Differences::of(&members);
    let least = far.max(UNUSUAL * median(after.apart.iter().copied())?);
    pairs.retain(|pair| before.at(*pair) > least && after.at(*pair) <= MENDED * before.at(*pair));
    let largest = |differences: &Differences| pairs.iter().map(|pair| differences.at(*pair)).reduce(f64::max);
    let (distance, usual) = (largest(&before)?, largest(&after)?);
    pairs.sort_unstable();
    Some(MisplacedLandmarks {
        member,
        swapped: pairs,
        far: Vec::new(),
        distance,
        usual,
        cause: LandmarkCause::SomeMember,
    })
}

/// Returns the landmarks of each member, scaled about their mean to the members' mean size. An exchange of landmarks
/// doesn't change the size. Returns `None` if the landmarks of a member coincide.
fn of_equal_size(positions: &[Vec<Vec3>]) -> Option<Vec<Vec<Vec3>>> {
    let centred: Vec<Vec<Vec3>> = positions.iter().map(|own| about_their_mean(own)).collect();
    let size = |own: &Vec<Vec3>| own.iter().map(|point| dot(*point, *point)).sum::<f64>().sqrt();
    let sizes: Vec<f64> = centred.iter().map(size).collect();
    let usual = sizes.iter().sum::<f64>() / sizes.len() as f64;
    let scaled = |(own, size): (Vec<Vec3>, &f64)| -> Option<Vec<Vec3>> {
        let factor = usual / size;
        (*size > 0.0).then(|| own.iter().map(|point| point.map(|x| factor * x)).collect())
    };
    centred.into_iter().zip(&sizes).map(scaled).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns landmarks of members of different sizes, whose shapes differ a little.
    fn members(count: usize) -> Vec<Vec<Vec3>> {
        let places = [[20.0, 1.0, 0.0], [-19.0, 2.0, 1.0], [3.0, 9.0, 0.0], [1.0, -8.0, 2.0], [0.0, 1.0, 6.0]];
        let of = |member: usize| -> Vec<Vec3> {
            let size = 1.0 + 0.1 * member as f64;
            let place = |k: usize| {
                let [x, y, z] = places[k];
                [size * x + 0.2 * ((3 * member + k) % 4) as f64, size * y, size * z + 0.1 * (k * member % 3) as f64]
            };
            (0..places.len()).map(place).collect()
        };
        (0..count).map(of).collect()
    }

    #[test]
    fn swapped_landmarks_of_two_or_three_members_are_named() {
        for count in [2, 3] {
            assert_eq!(swapped(&members(count), 0.5), None);
            for pairs in [&[[0, 3]][..], &[[0, 2], [3, 4]]] {
                for member in 0..count {
                    let mut given = members(count);
                    pairs.iter().for_each(|[k, l]| given[member].swap(*k, *l));
                    let found = swapped(&given, 0.5).expect("swapped landmarks");
                    assert_eq!(found.swapped, pairs, "{found:?}");
                    assert!(count == 2 || found.member == member, "{found:?}");
                    assert!(found.usual < 0.3 * found.distance, "{found:?}");
                }
            }
        }
        let mut given = members(3);
        given[1].swap(0, 3);
        let text = swapped(&given, 0.5).expect("a swap").of_member(|landmark| format!("L{landmark}"));
        assert!(
            text.starts_with("the landmarks L0 and L3 seem to be swapped, on this surface or on another"),
            "{text}"
        );
        // Landmarks that are near each other, or fewer than the minimum number, aren't compared.
        assert_eq!(swapped(&given, 100.0), None);
        given.iter_mut().for_each(|own| own.truncate(3));
        assert_eq!(swapped(&given, 0.5), None);
        assert_eq!(swapped(&[vec![[1.0; 3]; 5], vec![[1.0; 3]; 5]], 0.5), None);
    }
}
