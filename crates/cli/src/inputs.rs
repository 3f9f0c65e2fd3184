//! Spheres, surfaces and signals from files, checked before any work starts.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_harmonics::Directions;
use spharm_surface::io::{read_input, read_mesh, read_signal};
use spharm_surface::topology::{Topology, different_triangles};
use spharm_surface::{Input, Mesh};

use crate::console::Console;

/// A sphere: the directions of a sampling scheme, and its triangles where it was a mesh.
#[derive(Debug, Clone)]
pub struct Sphere {
    /// Where it came from.
    pub path: PathBuf,
    /// Unit vectors.
    pub directions: Directions,
    /// Triangles; none when it was a list of angles.
    pub faces: Vec<[u32; 3]>,
}

impl Sphere {
    /// Each vertex's share of the sphere's area: a third of each of its triangles'. Sums to 4 pi.
    pub fn areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.directions.len()];
        for face in &self.faces {
            let share = solid_angle(self.directions.as_slice(), face).abs() / 3.0;
            face.iter().for_each(|&v| areas[v as usize] += share);
        }
        areas
    }
}

/// Above this spread of the radii a warning is given.
const RADIUS_SPREAD: f64 = 0.01;

/// Reads a sphere: a mesh of any supported format and any radius, centred at the origin, or a CSV of theta,phi.
///
/// # Errors
///
/// When the file can't be read, has vertices without a direction, or a mesh doesn't go once around the origin.
pub fn read_sphere(path: &Path, console: &Console) -> Result<Sphere> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let (directions, faces) = if matches!(extension.as_str(), "csv" | "tsv") {
        (directions_of_angles(path)?, Vec::new())
    } else {
        let mesh = read_mesh(path)?;
        let directions = Directions::from_vertices(&mesh.vertices).with_context(|| path.display().to_string())?;
        check_sphere(path, &mesh, &directions, console)?;
        (directions, mesh.faces)
    };
    let duplicates = directions.duplicates();
    if duplicates > 0 {
        console.warn(format!("{}: {duplicates} directions repeat earlier ones", path.display()));
    }
    Ok(Sphere { path: path.to_path_buf(), directions, faces })
}

fn directions_of_angles(path: &Path) -> Result<Directions> {
    let signal = read_signal(path)?;
    if signal.channels != 2 {
        bail!("{}: expected two columns, theta and phi in radians, found {}", path.display(), signal.channels);
    }
    let angles: Vec<[f64; 2]> = signal.values.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
    let allowed = -1e-9..=std::f64::consts::PI + 1e-9;
    if let Some(row) = angles.iter().position(|[theta, _]| !allowed.contains(theta)) {
        let found = angles[row][0];
        bail!("{}: row {row}: theta must be from 0 to pi (radians, from the pole), found {found}", path.display());
    }
    Directions::from_angles(&angles).with_context(|| path.display().to_string())
}

fn check_sphere(path: &Path, mesh: &Mesh, directions: &Directions, console: &Console) -> Result<()> {
    let radii = directions.radii();
    if radii.spread() > RADIUS_SPREAD {
        console.warn(format!(
            "{}: radii from {:.4} to {:.4}, {:.1} % apart; is it a sphere centred at the origin?",
            path.display(),
            radii.min,
            radii.max,
            100.0 * radii.spread()
        ));
    }
    let topology = Topology::of(mesh);
    if !topology.is_sphere() {
        console.warn(format!("{}: not a closed sphere: {}", path.display(), topology.problems().join("; ")));
        return Ok(());
    }
    let turns = winding_number(directions.as_slice(), &mesh.faces);
    if turns.abs() < 0.5 {
        bail!(
            "{}: the origin lies outside of this sphere; centre it at the origin, or is it the surface, not its sphere?",
            path.display()
        );
    }
    if turns.abs() > 1.5 {
        bail!(
            "{}: this mesh goes {:.0} times around the origin, not once; it is no sphere",
            path.display(),
            turns.abs()
        );
    }
    if turns < 0.0 {
        console.warn(format!("{}: the triangles wind inwards", path.display()));
    }
    Ok(())
}

/// How often triangles on the unit sphere cover it.
fn winding_number(directions: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    faces.iter().map(|face| solid_angle(directions, face)).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// Signed area of a triangle on the unit sphere (A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30, 1983,
/// eq. 8).
fn solid_angle(directions: &[[f64; 3]], face: &[u32; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let [a, b, c] = face.map(|v| directions[v as usize]);
    let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
    2.0 * dot(a, cross).atan2(1.0 + dot(a, b) + dot(b, c) + dot(c, a))
}

/// What is to be fitted: a function of c channels on the vertices.
#[derive(Debug, Clone)]
pub struct Target {
    /// Where it came from.
    pub path: PathBuf,
    /// Values, (n, c) row-major: positions, or signals.
    pub values: Vec<f64>,
    /// Number of channels, c.
    pub channels: usize,
    /// Whether it is a surface, with x, y, z for channels.
    pub surface: bool,
    /// GIfTI's `AnatomicalStructurePrimary`, handed on.
    pub anatomical_structure: Option<String>,
}

/// Reads a surface or a signal that belongs to a sphere.
///
/// What keeps a surface from being a closed one of genus zero is a warning, since the least squares is defined all the
/// same, and an error when `strict`.
///
/// # Errors
///
/// When the file can't be read or doesn't fit the sphere.
pub fn read_target(path: &Path, sphere: &Sphere, strict: bool, console: &Console) -> Result<Target> {
    let n = sphere.directions.len();
    let input = read_input(path)?;
    let (values, channels, mesh) = match input {
        Input::Signal(signal) => (signal.values, signal.channels, None),
        Input::Mesh(mesh) => (mesh.vertices.as_flattened().to_vec(), 3, Some(mesh)),
    };
    let found = values.len().checked_div(channels).unwrap_or(0);
    if found != n {
        bail!(
            "{}: {found} vertices, the sphere {} has {n}; they must correspond",
            path.display(),
            sphere.path.display()
        );
    }
    if let Some(at) = values.iter().position(|value| !value.is_finite()) {
        bail!("{}: vertex {} has a NaN or infinite value", path.display(), at / channels);
    }
    let mut structure = None;
    if let Some(mesh) = &mesh {
        structure.clone_from(&mesh.meta.anatomical_structure_primary);
        if !sphere.faces.is_empty() && mesh.faces != sphere.faces {
            let differ = different_triangles(&mesh.faces, &sphere.faces);
            if differ > 0 {
                bail!(
                    "{}: its triangles are not those of the sphere {} ({differ} differ); the vertices must correspond",
                    path.display(),
                    sphere.path.display()
                );
            }
        }
        let topology = Topology::of(mesh);
        if !topology.is_sphere() {
            let problems = topology.problems().join("; ");
            let text = format!("{}: not a closed surface of genus zero: {problems}", path.display());
            if strict {
                bail!("{text}");
            }
            console.warn(text);
        }
    }
    Ok(Target { path: path.to_path_buf(), values, channels, surface: mesh.is_some(), anatomical_structure: structure })
}

/// Paths as given, with each `@list.txt` replaced by the paths that the file names, one a line; blank lines and lines
/// that begin with `#` are skipped, and relative paths are relative to the list's folder.
///
/// # Errors
///
/// When a list can't be read or names nothing.
pub fn expand_lists(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut expanded = Vec::new();
    for path in paths {
        let Some(list) = path.to_str().and_then(|text| text.strip_prefix('@')) else {
            expanded.push(path.clone());
            continue;
        };
        let list = Path::new(list);
        if !list.is_file() {
            bail!("{}: no such list of paths", list.display());
        }
        let text =
            std::fs::read_to_string(list).with_context(|| format!("{}: cannot read the list", list.display()))?;
        let base = list.parent().unwrap_or(Path::new(""));
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        let before = expanded.len();
        expanded.extend(lines.map(|line| base.join(line)));
        if expanded.len() == before {
            bail!("{}: the list names no file", list.display());
        }
    }
    Ok(expanded)
}

/// Name of an input without folder and format: `lh.pial.surf.gii` becomes `lh.pial`.
pub fn stem(path: &Path) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let endings = [
        ".surf.gii.gz",
        ".func.gii.gz",
        ".shape.gii.gz",
        ".surf.gii",
        ".func.gii",
        ".shape.gii",
        ".gii.gz",
        ".gii",
        ".obj",
        ".ply",
        ".off",
        ".stl",
        ".vtk",
        ".csv",
        ".tsv",
    ];
    let lower = name.to_ascii_lowercase();
    let ending = endings.iter().find(|ending| lower.ends_with(*ending) && lower.len() > ending.len());
    ending.map_or(name.clone(), |ending| name[..name.len() - ending.len()].to_owned())
}

/// The stems of inputs; where some are the same, each with the folders before it in which the inputs differ:
/// `sub-01/surf/lh.pial` and `sub-02/surf/lh.pial` become `sub-01.lh.pial` and `sub-02.lh.pial`.
pub fn unique_stems(inputs: &[PathBuf]) -> Vec<String> {
    let stems: Vec<String> = inputs.iter().map(|input| stem(input)).collect();
    let mut sorted = stems.clone();
    sorted.sort_unstable();
    if sorted.windows(2).all(|pair| pair[0] != pair[1]) {
        return stems;
    }
    let folders = |input: &PathBuf| -> Vec<String> {
        let parts = input.parent().map(Path::components).into_iter().flatten();
        parts.map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
    };
    let folders: Vec<Vec<String>> = inputs.iter().map(folders).collect();
    let shortest = folders.iter().map(Vec::len).min().unwrap_or(0);
    let same = |pick: &dyn Fn(&Vec<String>) -> String| folders.iter().all(|f| pick(f) == pick(&folders[0]));
    let front = (0..shortest).take_while(|&at| same(&|f| f[at].clone())).count();
    let back = (0..shortest - front).take_while(|&at| same(&|f| f[f.len() - 1 - at].clone())).count();
    let name = |(folders, stem): (&Vec<String>, &String)| {
        let differing = &folders[front..folders.len() - back];
        differing.iter().chain([stem]).map(String::as_str).collect::<Vec<_>>().join(".")
    };
    folders.iter().zip(&stems).map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_are_told_apart_by_their_folders() {
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let unique = |names: &[&str]| unique_stems(&paths(names));
        assert_eq!(unique(&["a/lh.pial", "b/rh.pial"]), ["lh.pial", "rh.pial"]);
        let study = ["/d/sub-01/surf/lh.pial", "/d/sub-02/surf/lh.pial"];
        assert_eq!(unique(&study), ["sub-01.lh.pial", "sub-02.lh.pial"]);
        assert_eq!(unique(&["a/x.obj", "x.obj"]), ["a.x", "x"]);
        assert_eq!(unique(&["x.obj", "x.ply"]), ["x", "x"], "told apart by nothing: the caller refuses");
    }

    #[test]
    fn stems_lose_the_format_only() {
        for (path, expected) in [
            ("a/lh.pial.surf.gii", "lh.pial"),
            ("fsaverage5.pial_left.gii.gz", "fsaverage5.pial_left"),
            ("lh.pial", "lh.pial"),
            ("HEAD.OBJ", "HEAD"),
            (".gii", ".gii"),
        ] {
            assert_eq!(stem(Path::new(path)), expected);
        }
    }

    #[test]
    fn an_octahedron_goes_once_around_its_centre() {
        let v = [[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.]];
        let f = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        assert!((winding_number(&v, &f) - 1.0).abs() < 1e-14);
        let moved = Directions::from_vertices(&v.map(|[x, y, z]: [f64; 3]| [x + 3.0, y + 0.1, z])).unwrap();
        assert!(winding_number(moved.as_slice(), &f).abs() < 1e-14);
    }
}
