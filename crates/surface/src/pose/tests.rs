use spharm_monitor::Silent;

use super::*;
use crate::Mesh;
use crate::generate::{SplitMix64, icosphere};
use crate::geometry::{Vec3, dot};
use crate::matrix3::{IDENTITY, of_quaternion, times};

/// Returns an ellipsoid with bumps, a body that no rotation or reflection maps to itself.
pub(super) fn lump(level: u32) -> Mesh {
    let ball = icosphere(level);
    let bump = |v: &Vec3| {
        let at = |d: Vec3| (6.0 * (dot(d, *v) - 1.0)).exp();
        1.0 + 0.4 * at([0.6, 0.64, 0.48]) + 0.3 * at([-0.36, 0.48, -0.8])
    };
    let place = |v: &Vec3| [9.0 * v[0] * bump(v), 6.0 * v[1] * bump(v), 4.0 * v[2] * bump(v)];
    ball.with_vertices(ball.vertices.iter().map(place).collect())
}

fn turn(random: &mut SplitMix64) -> Matrix3 {
    let q: [f64; 4] = std::array::from_fn(|_| random.between(-1.0, 1.0));
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    of_quaternion(q.map(|v| v / length))
}

/// Returns the largest distance between the vertices' original positions and their positions after the motion `moved`
/// followed by the motion `found`.
fn error(mesh: &Mesh, moved: &Similarity, found: &Similarity) -> f64 {
    let both = moved.then(found);
    let off = |v: &Vec3| dot(sub(both.apply(*v), *v), sub(both.apply(*v), *v)).sqrt();
    mesh.vertices.iter().map(off).fold(0.0, f64::max)
}

#[test]
fn a_surface_meshed_anew_returns_from_any_pose() {
    let (fixed, other) = (lump(5), lump(4));
    let target = PoseSurface::new(&fixed).unwrap();
    let mut random = SplitMix64::new(1);
    for n in 0..6 {
        let mirror = n % 2 == 1;
        let sign = if mirror { -1.0 } else { 1.0 };
        let orthogonal = turn(&mut random).map(|row| row.map(|v| sign * v));
        let size = if n < 3 { 1.0 } else { 0.2 };
        let moved = Similarity { orthogonal, scale: size, translation: [100.0, -30.0, 7.0] };
        let params = PoseParams { scale: n >= 3, mirror, ..PoseParams::default() };
        let found = pose(&PoseSurface::new(&moved.apply_mesh(&other)).unwrap(), &target, &params, &Silent).unwrap();
        assert!(error(&other, &moved, &found.similarity) < 0.1, "{n}: {}", error(&other, &moved, &found.similarity));
        assert!(found.distance < 0.02 && found.second > 5.0 * found.distance, "{n}: {found:?}");
        assert_eq!(found.similarity.mirrors(), mirror);
        // Rotations must remain orthogonal.
        let q = found.similarity.orthogonal;
        assert!((crate::matrix3::determinant(&q) - sign).abs() < 1e-13);
    }
}

#[test]
fn what_has_no_counterpart_doesnt_pull() {
    let (fixed, mut part) = (lump(5), lump(4));
    // One tip, about a tenth of the area, is cut off.
    part.faces.retain(|face| face.iter().all(|v| part.vertices[*v as usize][0] < 7.5));
    let mut random = SplitMix64::new(2);
    let moved = Similarity { orthogonal: turn(&mut random), ..Similarity::default() };
    let target = PoseSurface::new(&fixed).unwrap();
    let found = |trimmed: f64| {
        let params = PoseParams { trimmed, ..PoseParams::default() };
        pose(&PoseSurface::new(&moved.apply_mesh(&part)).unwrap(), &target, &params, &Silent).unwrap().similarity
    };
    assert!(error(&part, &moved, &found(0.1)) < 0.15, "{}", error(&part, &moved, &found(0.1)));
}

#[test]
fn a_part_smaller_than_what_is_trimmed_still_decides() {
    // An ellipsoid alone has four equally good poses. With a bump on 4 % of its area, only one pose is best. The other
    // surface is 7 % larger.
    let bumped = |level: u32, size: f64| {
        let ball = icosphere(level);
        let place = |v: &Vec3| {
            let bump = 1.0 + 0.25 * (10.0 * (dot([0.7, 0.5, 0.51], *v) - 1.0)).exp();
            [12.0 * v[0] * bump, 7.0 * v[1] * bump, 5.0 * v[2] * bump].map(|x| size * x)
        };
        ball.with_vertices(ball.vertices.iter().map(place).collect())
    };
    let (fixed, other) = (bumped(5, 1.0), bumped(4, 1.07));
    let target = PoseSurface::new(&fixed).unwrap();
    let mut random = SplitMix64::new(5);
    for n in 0..6 {
        let moved = Similarity { orthogonal: turn(&mut random), ..Similarity::default() };
        let moving = PoseSurface::new(&moved.apply_mesh(&other)).unwrap();
        let found = pose(&moving, &target, &PoseParams::default(), &Silent).unwrap();
        let off = error(&other, &moved, &found.similarity);
        assert!(off < 2.0, "{n}: {off}");
    }
}

#[test]
fn what_is_symmetric_says_so() {
    let ball = icosphere(4);
    let ellipsoid = ball.with_vertices(ball.vertices.iter().map(|v| [9.0 * v[0], 5.0 * v[1], 2.0 * v[2]]).collect());
    let surface = PoseSurface::new(&ellipsoid).unwrap();
    let found = pose(&surface, &surface, &PoseParams::default(), &Silent).unwrap();
    assert!(found.second < 0.05 && found.distance < 0.05, "{found:?}");
    assert!(differ(&found.similarity, &found.other.unwrap()));
}

/// An ellipsoid has four equally good poses. The search near the given pose finds only one of them.
#[test]
fn a_search_near_the_given_pose_turns_nothing_over() {
    let ellipsoid = |level: u32| {
        let ball = icosphere(level);
        ball.with_vertices(ball.vertices.iter().map(|v| [9.0 * v[0], 6.0 * v[1], 4.0 * v[2]]).collect())
    };
    let (fixed, other) = (PoseSurface::new(&ellipsoid(5)).unwrap(), ellipsoid(4));
    let params = PoseParams { search: PoseSearch::Near, ..PoseParams::default() };
    let mut random = SplitMix64::new(3);
    for far in [0.0, 1.0, 40.0] {
        let q = [1.0, random.between(-0.1, 0.1), random.between(-0.1, 0.1), random.between(-0.1, 0.1)];
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let orthogonal = of_quaternion(q.map(|v| v / length));
        let moved = Similarity { orthogonal, translation: [far, -far, 0.5 * far], ..Similarity::default() };
        let found = pose(&PoseSurface::new(&moved.apply_mesh(&other)).unwrap(), &fixed, &params, &Silent).unwrap();
        assert!(error(&other, &moved, &found.similarity) < 0.1, "{far}: {found:?}");
        assert_eq!((found.second, found.other), (f64::INFINITY, None));
    }
    // The mirror image of a body without symmetry is matched and scaled if reflections and scaling are allowed.
    let (fixed, other) = (PoseSurface::new(&lump(5)).unwrap(), lump(4));
    let moved = Similarity { scale: 2.0, translation: [3.0, 0.0, 0.0], ..Similarity::reflection() };
    let params = PoseParams { mirror: true, scale: true, ..params };
    let found = pose(&PoseSurface::new(&moved.apply_mesh(&other)).unwrap(), &fixed, &params, &Silent).unwrap();
    assert!(found.similarity.mirrors() && error(&other, &moved, &found.similarity) < 0.1, "{found:?}");
}

/// A member whose given pose is wrong can't be matched near this pose, and a warning reports the member.
#[test]
fn a_search_near_the_given_poses_names_a_member_that_is_turned() {
    let members: Vec<PoseSurface> = (0..5)
        .map(|n| {
            let moved = Similarity {
                orthogonal: if n == 3 { [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]] } else { IDENTITY },
                translation: [f64::from(n), 0.0, 0.0],
                scale: 1.0 + 0.01 * f64::from(n),
            };
            PoseSurface::new(&moved.apply_mesh(&lump(4))).unwrap()
        })
        .collect();
    let params = PoseParams { search: PoseSearch::Near, ..PoseParams::default() };
    let found = group_poses(&members, &params, &Silent).unwrap();
    let elsewhere = |of: &&GroupPoseWarning| matches!(of, GroupPoseWarning::Elsewhere { .. });
    let named: Vec<usize> = found.warnings.iter().filter(elsewhere).map(GroupPoseWarning::member).collect();
    assert_eq!(named, [3], "{:?}", found.warnings);
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (a, b) = (PoseSurface::new(&lump(4)).unwrap(), PoseSurface::new(&lump(3)).unwrap());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| pose(&a, &b, &PoseParams::default(), &Silent).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn distances_are_those_of_the_surfaces() {
    // The first test uses two concentric spheres whose radii differ by 1. The second test rotates a sphere, so that its
    // points move to other positions on the same sphere.
    let shell = |r: f64, level| {
        let ball = icosphere(level);
        PoseSurface::new(&ball.with_vertices(ball.vertices.iter().map(|v| v.map(|x| r * x)).collect())).unwrap()
    };
    let (inner, outer) = (shell(10.0, 5), shell(11.0, 4));
    let apart = distance(&inner, &outer, &Similarity::default(), 0.0);
    assert!((apart - 1.0).abs() < 0.02, "{apart}");
    let mut random = SplitMix64::new(2);
    let turned = Similarity { orthogonal: turn(&mut random), ..Similarity::default() };
    assert!(distance(&inner, &inner, &turned, 0.0) < 0.02);
}

#[test]
fn a_search_can_be_stopped() {
    struct Stop;
    impl Monitor for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let surface = PoseSurface::new(&lump(2)).unwrap();
    assert!(pose(&surface, &surface, &PoseParams::default(), &Stop).is_err());
}

#[test]
fn a_group_comes_together_and_strangers_are_named() {
    let ball = icosphere(4);
    let mut random = SplitMix64::new(9);
    let mut surfaces = Vec::new();
    let mut moved = Vec::new();
    for n in 0..6 {
        // The last member is a ball, and the others are lumps.
        let mesh = match n {
            5 => ball.with_vertices(ball.vertices.iter().map(|v| v.map(|x| 6.0 * x)).collect()),
            _ => {
                let wide = 1.0 + 0.02 * f64::from(n);
                let lump = lump(4);
                lump.with_vertices(lump.vertices.iter().map(|v| [v[0], wide * v[1], v[2]]).collect())
            }
        };
        let to = Similarity { orthogonal: turn(&mut random), scale: 1.0, translation: [9.0, f64::from(n), -40.0] };
        surfaces.push(PoseSurface::new(&to.apply_mesh(&mesh)).unwrap());
        moved.push(to);
    }
    let found = group_poses(&surfaces, &PoseParams::default(), &Silent).unwrap();
    let far: Vec<usize> = found
        .warnings
        .iter()
        .filter(|w| matches!(w, GroupPoseWarning::Far { .. }))
        .map(GroupPoseWarning::member)
        .collect();
    assert_eq!(far, [5], "{found:?}");
    assert!(found.distances[..5].iter().all(|d| *d < 0.3), "{found:?}");
    assert!(found.template < 5);
    // The known motion, followed by the motion that was found, must be the same for all lumps. An error of 6 % of the
    // lumps' size (6) is allowed, because the widths of the two lumps compared differ by 6 %.
    let [first, second] = [0, 3].map(|n| moved[n].then(&found.similarities[n]));
    let off = sub(first.apply([9.0, 0.0, 0.0]), second.apply([9.0, 0.0, 0.0]));
    assert!(dot(off, off).sqrt() < 0.36, "{off:?}");
    let same = group_poses(&surfaces, &PoseParams::default(), &Silent).unwrap();
    assert_eq!(found, same);
    assert_eq!(group_poses(&surfaces[..1], &PoseParams::default(), &Silent).unwrap().distances, [0.0]);
}

#[test]
fn a_bump_that_half_of_a_group_has_turns_no_one() {
    let ball = icosphere(4);
    // The body's cross-section is nearly round, so little prevents the body from rotating about its length. The body is
    // wider at one end, and bent, so that no half turn maps it to itself.
    let body = |v: &Vec3, height: f64| {
        let bump = 1.0 + height * (12.0 * (dot(*v, [0.48, 0.64, 0.6]) - 1.0)).exp();
        [(1.0 + 0.2 * v[0]) * 12.0 * v[0], bump * 7.0 * v[1], bump * 6.0 * v[2] + 2.0 * v[0] * v[0]]
    };
    let mut random = SplitMix64::new(5);
    let (mut surfaces, mut moved) = (Vec::new(), Vec::new());
    for n in 0..8 {
        let height = if n < 4 { 0.0 } else { 0.3 };
        let mesh = ball.with_vertices(ball.vertices.iter().map(|v| body(v, height)).collect());
        let to = Similarity { orthogonal: turn(&mut random), ..Similarity::default() };
        surfaces.push(PoseSurface::new(&to.apply_mesh(&mesh)).unwrap());
        moved.push(to);
    }
    let found = group_poses(&surfaces, &PoseParams::default(), &Silent).unwrap();
    let whole: Vec<Similarity> = moved.iter().zip(&found.similarities).map(|(to, back)| to.then(back)).collect();
    for member in &whole[4..] {
        let between = times(&member.inverse().orthogonal, times(&whole[0].orthogonal, [0.0, 1.0, 0.0]));
        let degrees = between[1].clamp(-1.0, 1.0).acos().to_degrees();
        assert!(degrees < 2.0, "{degrees}");
    }
}

#[test]
fn a_mirrored_member_is_named_unless_mirror_images_are_matched() {
    let mut random = SplitMix64::new(12);
    let mut group = |count: i32, of_other_side: &[i32]| -> Vec<PoseSurface> {
        let one = |n| {
            let wide = 1.0 + 0.02 * f64::from(n);
            let mesh = lump(4);
            let mesh = mesh.with_vertices(mesh.vertices.iter().map(|v| [v[0], wide * v[1], v[2]]).collect());
            let sign = if of_other_side.contains(&n) { -1.0 } else { 1.0 };
            let orthogonal = turn(&mut random).map(|row| row.map(|v| sign * v));
            PoseSurface::new(&Similarity { orthogonal, ..Similarity::default() }.apply_mesh(&mesh)).unwrap()
        };
        (0..count).map(one).collect()
    };
    let named = |surfaces: &[PoseSurface], mirror: bool| {
        let params = PoseParams { mirror, ..PoseParams::default() };
        let warnings = group_poses(surfaces, &params, &Silent).unwrap().warnings;
        let mirrored = warnings.iter().filter(|warning| matches!(warning, GroupPoseWarning::Mirrored { .. }));
        mirrored.map(GroupPoseWarning::member).collect::<Vec<_>>()
    };
    let one = group(5, &[2]);
    assert_eq!(named(&one, false), [2]);
    assert!(named(&one, true).is_empty());
    assert_eq!(named(&group(10, &[1, 4, 7]), false), [1, 4, 7]);
}

#[test]
fn size_does_not_turn_a_body() {
    let (large, other) = (lump(5), lump(4));
    let fixed = PoseSurface::new(&large).unwrap();
    let mut random = SplitMix64::new(8);
    let mut surfaces = vec![PoseSurface::new(&other).unwrap()];
    let mut moves = vec![Similarity::default()];
    for size in [0.97, 0.9, 0.8, 0.5, 1.3] {
        let moved = Similarity { orthogonal: turn(&mut random), scale: size, translation: [20.0, -7.0, 1.0] };
        let moving = PoseSurface::new(&moved.apply_mesh(&other)).unwrap();
        let found = pose(&moving, &fixed, &PoseParams::default(), &Silent).unwrap();
        let angle = angle_between(&moved.then(&found.similarity).orthogonal, &IDENTITY).to_degrees();
        assert!(angle < 0.5 && found.similarity.scale == 1.0, "{size}: {angle}");
        let scaled = found.at_one_size.unwrap().similarity;
        assert!(error(&other, &moved, &scaled) < 0.1, "{size}");
        surfaces.push(moving);
        moves.push(moved);
    }
    let group = group_poses(&surfaces, &PoseParams::default(), &Silent).unwrap();
    let turns: Vec<Matrix3> =
        moves.iter().zip(&group.similarities).map(|(moved, found)| moved.then(found).orthogonal).collect();
    for (turned, found) in turns.iter().zip(&group.similarities) {
        let angle = angle_between(turned, &turns[0]).to_degrees();
        assert!(angle < 0.5 && found.scale == 1.0, "{angle}");
    }
    let given = group.at_one_size.iter().map(Option::is_some).filter(|given| *given).count();
    assert_eq!(given, surfaces.len() - 1);
}

#[test]
fn a_body_that_is_cut_off_is_not_enlarged() {
    let (fixed, mut part) = (lump(5), lump(4));
    part.faces.retain(|face| face.iter().all(|v| part.vertices[*v as usize][0] < 2.0));
    let found =
        pose(&PoseSurface::new(&part).unwrap(), &PoseSurface::new(&fixed).unwrap(), &PoseParams::default(), &Silent);
    assert_eq!(found.unwrap().at_one_size, None);
}
