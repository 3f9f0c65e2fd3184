//! Measures the failure rate and the time of pose searches, and the resulting distances between landmarks.
//!
//! Usage: `cargo run --release -p spharm-surface --example poses [PAIRS [ROTATIONS]]`, with PAIRS pairs of each kind
//! (10 by default) and ROTATIONS rotations of each pair (20 by default). The pairs consist of vertebrae from the shared
//! data, and of generated rods, boxes, cubes and near-spheres. The two bodies of a generated pair differ slightly and
//! are meshed differently. Each pair is tried from ROTATIONS random rotations. A search misses the optimum if the
//! distance in its pose exceeds 1.05 times the smallest distance found for the pair. This smallest distance is taken
//! over the searches from all rotations, 24 random starts that are independent of the search, and the true pose.

use std::time::Instant;

use rayon::prelude::*;
use spharm_monitor::Silent;
use spharm_surface::generate::{SplitMix64, icosphere};
use spharm_surface::geometry::{Vec3, dot, sub};
use spharm_surface::io::read_mesh;
use spharm_surface::kabsch::kabsch;
use spharm_surface::matrix3::{Matrix3, of_quaternion, times};
use spharm_surface::pose::{PoseParams, PoseSurface, distance, group_poses, improved, pose};
use spharm_surface::{Mesh, Similarity};

type Failure = Box<dyn std::error::Error>;

/// Number of random starts, independent of the search, that are used to find the best optimum.
const STARTS: usize = 24;
const KINDS: [&str; 4] = ["rods", "boxes", "cubes", "near-spheres"];

fn main() -> Result<(), Failure> {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<usize>());
    let count = numbers.next().transpose()?.unwrap_or(10);
    let rotations = numbers.next().transpose()?.unwrap_or(20);
    let mut random = SplitMix64::new(1);
    println!("kind, missed poses, all poses, worst ratio, seconds per pose, seconds per surface");
    let vertebrae = vertebrae()?;
    for kind in ["vertebrae"].into_iter().chain(KINDS) {
        let pairs: Vec<(Mesh, Mesh)> = match kind {
            "vertebrae" => (0..count.min(vertebrae.len()))
                .map(|i| (vertebrae[i].mesh.clone(), vertebrae[(i + 3) % vertebrae.len()].mesh.clone()))
                .collect(),
            _ => (0..count).map(|_| bodies(kind, &mut random)).collect(),
        };
        let row = missed(&pairs, rotations, &mut random)?;
        println!("{kind}, {}, {}, {:.3}, {:.4}, {:.4}", row.missed, row.poses, row.worst, row.seconds, row.building);
    }
    landmarks(&vertebrae)
}

/// Aligns the vertebrae as a group, and prints the distance of each vertebra's landmarks from the mean of the other
/// vertebrae's landmarks. For comparison, also prints this distance after the best rigid alignment of the landmarks
/// themselves, and the ratio of the two distances.
fn landmarks(vertebrae: &[Vertebra]) -> Result<(), Failure> {
    let surfaces: Vec<PoseSurface> = vertebrae.iter().filter_map(|v| PoseSurface::new(&v.mesh)).collect();
    let start = Instant::now();
    let found = group_poses(&surfaces, &PoseParams::default(), &Silent)?;
    let seconds = start.elapsed().as_secs_f64();
    found.warnings.iter().for_each(|warning| println!("{warning}"));
    let moved = |similarities: &[Similarity]| -> Vec<Vec<Vec3>> {
        let of = |(v, s): (&Vertebra, &Similarity)| v.landmarks.iter().map(|p| s.apply(*p)).collect();
        vertebrae.iter().zip(similarities).map(of).collect()
    };
    let by_surfaces = from_others(&moved(&found.similarities));
    let mut best = found.similarities.clone();
    for _ in 0..200 {
        let now = moved(&best);
        for (member, similarity) in best.iter_mut().enumerate() {
            *similarity = similarity.then(&onto(&now[member], &mean_of_others(&now, member)));
        }
    }
    let by_landmarks = from_others(&moved(&best));
    println!("vertebra, landmark distance after alignment of surfaces, after alignment of landmarks, ratio");
    for ((v, a), b) in vertebrae.iter().zip(&by_surfaces).zip(&by_landmarks) {
        println!("{}, {a:.2}, {b:.2}, {:.3}", v.name, a / b);
    }
    println!(
        "group: {seconds:.2} seconds, typical vertebra: {}",
        vertebrae.get(found.template).map_or("", |v| &v.name)
    );
    Ok(())
}

fn mean_of_others(landmarks: &[Vec<Vec3>], member: usize) -> Vec<Vec3> {
    let others = landmarks.iter().enumerate().filter(|(other, _)| *other != member).map(|(_, points)| points);
    let mut mean = vec![[0.0; 3]; landmarks[member].len()];
    for points in others {
        for (sum, p) in mean.iter_mut().zip(points) {
            (0..3).for_each(|k| sum[k] += p[k] / (landmarks.len() - 1) as f64);
        }
    }
    mean
}

/// Returns the root mean square distance of each member's landmarks from the mean of the other members' landmarks.
fn from_others(landmarks: &[Vec<Vec3>]) -> Vec<f64> {
    let one = |member: usize| {
        let mean = mean_of_others(landmarks, member);
        let squares = landmarks[member].iter().zip(&mean).map(|(p, q)| dot(sub(*p, *q), sub(*p, *q)));
        (squares.sum::<f64>() / mean.len() as f64).sqrt()
    };
    (0..landmarks.len()).map(one).collect()
}

/// Returns the rigid motion that brings `points` closest to `others`.
fn onto(points: &[Vec3], others: &[Vec3]) -> Similarity {
    let centre = |points: &[Vec3]| -> Vec3 {
        std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
    };
    let (p, q) = (centre(points), centre(others));
    let mut cross = Matrix3::default();
    for (a, b) in points.iter().zip(others) {
        let (a, b) = (sub(*a, p), sub(*b, q));
        (0..3).for_each(|i| (0..3).for_each(|j| cross[i][j] += b[i] * a[j]));
    }
    about(p, q, kabsch(&cross, false))
}

struct Vertebra {
    name: String,
    mesh: Mesh,
    landmarks: Vec<Vec3>,
}

struct Row {
    missed: usize,
    poses: usize,
    worst: f64,
    seconds: f64,
    building: f64,
}

fn missed(pairs: &[(Mesh, Mesh)], rotations: usize, random: &mut SplitMix64) -> Result<Row, Failure> {
    let params = PoseParams::default();
    let mut row = Row { missed: 0, poses: 0, worst: 0.0, seconds: 0.0, building: 0.0 };
    for (moving, fixed) in pairs {
        let target = PoseSurface::new(fixed).ok_or("no area")?;
        let plain = PoseSurface::new(moving).ok_or("no area")?;
        let mut least = improved(&plain, &target, &Similarity::default(), &params).1;
        let starts: Vec<Similarity> = (0..STARTS).map(|_| about(plain.centre, target.centre, turn(random))).collect();
        let ends: Vec<f64> = starts.par_iter().map(|start| improved(&plain, &target, start, &params).1).collect();
        least = ends.into_iter().fold(least, f64::min);
        let mut found = Vec::new();
        for _ in 0..rotations {
            let turned = Similarity { orthogonal: turn(random), scale: 1.0, translation: [50.0, -300.0, 10.0] };
            let start = Instant::now();
            let surface = PoseSurface::new(&turned.apply_mesh(moving)).ok_or("no area")?;
            row.building += start.elapsed().as_secs_f64();
            let start = Instant::now();
            let pose = pose(&surface, &target, &params, &Silent)?;
            row.seconds += start.elapsed().as_secs_f64();
            // The same points are used in every pose, so distances are comparable.
            found.push(distance(&plain, &target, &turned.then(&pose.similarity), params.trimmed));
        }
        least = found.iter().copied().fold(least, f64::min);
        for distance in found {
            let ratio = distance / least.max(1e-3 * target.size());
            row.worst = row.worst.max(ratio);
            row.missed += usize::from(ratio > 1.05);
            row.poses += 1;
        }
    }
    row.seconds /= row.poses as f64;
    row.building /= row.poses as f64;
    Ok(row)
}

fn turn(random: &mut SplitMix64) -> Matrix3 {
    loop {
        let q: [f64; 4] = std::array::from_fn(|_| random.between(-1.0, 1.0));
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        if (0.1..1.0).contains(&length) {
            return of_quaternion(q.map(|v| v / length));
        }
    }
}

/// Returns the motion that rotates about `from`, then translates `from` to `to`.
fn about(from: Vec3, to: Vec3, orthogonal: Matrix3) -> Similarity {
    Similarity { orthogonal, scale: 1.0, translation: sub(to, times(&orthogonal, from)) }
}

fn vertebrae() -> Result<Vec<Vertebra>, Failure> {
    let Some(folder) = spharm_testdata::shared("vertebrae") else { return Ok(Vec::new()) };
    let mut paths: Vec<_> =
        std::fs::read_dir(folder)?.map(|entry| entry.map(|e| e.path())).collect::<Result<_, _>>()?;
    paths.retain(|path| path.extension().is_some_and(|ending| ending == "ply"));
    paths.sort();
    let read = |path: &std::path::PathBuf| -> Result<Vertebra, Failure> {
        let marks: serde_json::Value = serde_json::from_slice(&std::fs::read(path.with_extension("json"))?)?;
        let coordinate = |mark: &serde_json::Value, k: usize| mark["coordinates"][k].as_f64().unwrap_or(f64::NAN);
        let landmarks = marks.as_array().ok_or("no landmarks")?.iter();
        Ok(Vertebra {
            name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            mesh: read_mesh(path)?,
            landmarks: landmarks.map(|mark| std::array::from_fn(|k| coordinate(mark, k))).collect(),
        })
    };
    paths.iter().map(read).collect()
}

/// Returns two slightly different bodies of the given kind, in the same pose.
fn bodies(kind: &str, random: &mut SplitMix64) -> (Mesh, Mesh) {
    let sides: [f64; 3] = match kind {
        "rods" => [10.0, 1.0, 1.0],
        "boxes" => [3.0, 2.0, 1.0],
        _ => [1.0; 3],
    };
    let sides = sides.map(|side| side * random.between(0.9, 1.1));
    let bumps: Vec<(Vec3, f64)> = (0..6)
        .map(|_| {
            let u: Vec3 = std::array::from_fn(|_| random.between(-1.0, 1.0));
            (u.map(|x| x / dot(u, u).sqrt()), random.between(-0.12, 0.12))
        })
        .collect();
    let body = |level: u32, noise: f64, random: &mut SplitMix64| {
        let turn = turn(random);
        let of_mesh: Vec<f64> = bumps.iter().map(|_| random.between(-noise, noise)).collect();
        let ball = icosphere(level);
        let place = |v: &Vec3| {
            let u = times(&turn, *v);
            let side = |k: usize| u[k].abs() / sides[k];
            // Radius of a box with slightly rounded edges, or of a ball.
            let r = match kind {
                "near-spheres" => 1.0,
                _ => (0..3).map(|k| side(k).powi(12)).sum::<f64>().powf(-1.0 / 12.0),
            };
            let bump =
                bumps.iter().zip(&of_mesh).map(|((at, high), more)| (high + more) * (8.0 * (dot(*at, u) - 1.0)).exp());
            let r = r * (1.0 + bump.sum::<f64>());
            [r * u[0], r * u[1], r * u[2]]
        };
        ball.with_vertices(ball.vertices.iter().map(place).collect())
    };
    (body(4, 0.02, random), body(5, 0.02, random))
}
