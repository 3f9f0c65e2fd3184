//! Rejects repaired meshes that enclose no body: one-sided surfaces, and open sheets that became closed only because
//! their rim was filled.

use spharm_surface::Mesh;
use spharm_surface::repair::{MeshRepair, WELDING_DISTANCE, repair, rims};
use spharm_surface::topology::{Topology, area, signed_volume};

use crate::error::ParametrizeError;
use crate::geometry::{add, norm, scale, sub};

/// A mesh may be a sheet if filled holes make up at least this share of its area. The filling of a flat sheet's rim is
/// as large as the sheet, so it makes up half of the total area.
const FILLED: f64 = 0.4;

/// A mesh with filled holes is a sheet only if its compactness is below this value. The compactness, `36 pi V^2 / A^3`
/// for volume V and area A, is 1 for a ball, 0.6 for half of a ball, 0.005 for a cap of a ball that spans 15 degrees,
/// and 0 for a sheet.
const COMPACT: f64 = 0.005;

/// If more than this share of a mesh's area is outside of its largest piece, the mesh is treated as several pieces.
/// [`check_one_piece`] accepts such a mesh without further checks.
const SPECKS: f64 = 0.05;

/// A mesh whose largest piece is a sheet is rejected. If more than this share of the mesh's area is outside of that
/// piece, the error states that the mesh consists of separate pieces, and not that it is a sheet.
const REST: f64 = 0.5;

/// Checks that a mesh can be wrapped: it must not be a single open piece that is a sheet or has only one side. Several
/// sheets are accepted, because together they may be the sides of a body. A closed surface with one side passes through
/// itself. Such a surface is accepted, because a wrap around it encloses a body.
///
/// # Errors
///
/// [`OneSided`](ParametrizeError::OneSided) or [`OpenSheet`](ParametrizeError::OpenSheet).
///
/// # Panics
///
/// When a triangle's index is out of range.
pub(crate) fn check_one_piece(mesh: &Mesh) -> Result<(), ParametrizeError> {
    let (largest, found) = repair(mesh);
    if found.dropped_area > SPECKS {
        return Ok(());
    }
    match check_enclosure(mesh, &largest, &rims(&largest.faces), &found) {
        Ok(_) | Err(ParametrizeError::OneSided { closed: true }) => Ok(()),
        Err(ParametrizeError::OneSided { closed: false }) if has_short_rim(&largest) => Ok(()),
        Err(error) => Err(error),
    }
}

/// Checks that a mesh can enclose a body after its repair. `open` contains the rims that the repair left open, and
/// `found` the changes made by the repair. Returns whether the repaired mesh has two sides. A repair can make a
/// two-sided mesh one-sided by joining parts that merely touch.
///
/// # Errors
///
/// [`OneSided`](ParametrizeError::OneSided) or [`OpenSheet`](ParametrizeError::OpenSheet) if the mesh can't enclose a
/// body; [`BadSurface`](ParametrizeError::BadSurface) if the largest piece is a sheet and the other pieces have more
/// than half of the area.
///
/// # Panics
///
/// When a triangle's index is out of range.
pub(crate) fn check_enclosure(
    given: &Mesh,
    mended: &Mesh,
    open: &[Vec<u32>],
    found: &MeshRepair,
) -> Result<bool, ParametrizeError> {
    if !is_consistent(&mended.faces) && Topology::of(mended).one_sided {
        let given = Topology::of(given);
        let error = ParametrizeError::OneSided { closed: given.boundary_edges == 0 };
        return if given.one_sided { Err(error) } else { Ok(false) };
    }
    let Some(filled) = filling_of_sheet(mended, open, found) else { return Ok(true) };
    Err(if found.dropped_area > REST { apart(found.pieces + 1) } else { ParametrizeError::OpenSheet { filled } })
}

/// Returns the error for a mesh that consists of several pieces, which aren't connected to each other.
fn apart(pieces: usize) -> ParametrizeError {
    ParametrizeError::BadSurface {
        problems: format!(
            "the surface consists of {pieces} separate pieces; the gaps between them are wider than the welding \
             distance of {WELDING_DISTANCE:e} of the surface's size"
        ),
        handles: 0,
        remedy: "join the pieces",
        mending: None,
    }
}

/// Returns whether triangles are wound consistently: no two triangles run along a shared edge in the same direction.
/// This check takes much less time than computing a [`Topology`].
fn is_consistent(faces: &[[u32; 3]]) -> bool {
    let mut edges: Vec<[u32; 2]> = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    edges.sort_unstable();
    edges.windows(2).all(|pair| pair[0] != pair[1])
}

/// Returns whether a one-sided mesh is a surface that passes through itself and has small holes, rather than a strip.
/// The length of the rim distinguishes the two: the rim of a strip is so long that a disk with the same circumference
/// would be larger than the strip.
fn has_short_rim(mesh: &Mesh) -> bool {
    let disk = rim_length(mesh).powi(2) / (4.0 * std::f64::consts::PI);
    disk < FILLED * (area(mesh) + disk)
}

/// Returns the total length of the edges that belong to only one triangle.
fn rim_length(mesh: &Mesh) -> f64 {
    let mut edges: Vec<[u32; 2]> = mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    edges.iter_mut().for_each(|edge| edge.sort_unstable());
    edges.sort_unstable();
    let alone = edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| same[0]);
    let length = |[a, b]: [u32; 2]| norm(sub(mesh.vertices[a as usize], mesh.vertices[b as usize]));
    alone.map(length).sum()
}

/// Returns the share of a sheet's area that consists of filled holes, including the `open` rims, which are filled here.
/// Returns `None` if the mesh isn't a sheet.
fn filling_of_sheet(mended: &Mesh, open: &[Vec<u32>], found: &MeshRepair) -> Option<f64> {
    if open.is_empty() && found.filled_area < FILLED {
        return None;
    }
    let fans = fans(mended, open);
    let [own, added] = [mended, &fans].map(area);
    let all = own + added;
    let filled = (found.filled_area * own + added) / all;
    if filled < FILLED {
        return None;
    }
    let volume = signed_volume(mended) + signed_volume(&fans);
    // V^2 and A^3 would overflow for coordinates near 1e60, so V / A^1.5 is computed first and then squared.
    let compactness = 36.0 * std::f64::consts::PI * (volume / all.powf(1.5)).powi(2);
    (compactness < COMPACT).then_some(filled)
}

/// Returns a mesh whose triangles fill the rims: one fan per rim, around the mean of the rim's vertices. The vertices
/// of `mesh` come first.
fn fans(mesh: &Mesh, rims: &[Vec<u32>]) -> Mesh {
    let mut fans = Mesh::new(mesh.vertices.clone(), Vec::new());
    for rim in rims {
        let sum = rim.iter().fold([0.0; 3], |sum, &v| add(sum, mesh.vertices[v as usize]));
        let middle = fans.vertices.len() as u32;
        fans.vertices.push(scale(sum, 1.0 / rim.len() as f64));
        fans.faces.extend(rim.iter().zip(rim.iter().cycle().skip(1)).map(|(&a, &b)| [a, b, middle]));
    }
    fans
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;
    use spharm_surface::range::times;

    use super::*;
    use crate::{CaldParams, Input, defects, parametrize};

    /// Returns a grid of n x n squares of two triangles each, with the given height at each point.
    fn sheet(n: u32, height: impl Fn(f64, f64) -> f64) -> Mesh {
        let at = |k: u32| (f64::from(k / (n + 1)), f64::from(k % (n + 1)));
        let vertices = (0..(n + 1) * (n + 1)).map(at).map(|(x, y)| [x, y, height(x, y)]).collect();
        let squares = (0..n * n).map(|k| k / n * (n + 1) + k % n);
        let faces = squares.flat_map(|a| [[a, a + n + 1, a + n + 2], [a, a + n + 2, a + 1]]).collect();
        Mesh::new(vertices, faces)
    }

    /// Returns the part of a unit sphere above the given height, an open cap.
    fn cap(height: f64) -> Mesh {
        let mut cap = icosphere(4);
        let high = |face: &[u32; 3]| face.iter().all(|&v| cap.vertices[v as usize][2] > height);
        let faces: Vec<[u32; 3]> = cap.faces.iter().filter(|face| high(face)).copied().collect();
        cap.faces = faces;
        cap
    }

    /// Returns a Möbius strip whose ends aren't welded: the vertices of the last edge duplicate those of the first.
    fn twisted_strip() -> Mesh {
        let n = 40_u32;
        let place = |k: u32| {
            let along = f64::from(k / 2) * TAU / f64::from(n);
            let across = if k.is_multiple_of(2) { -0.4 } else { 0.4 };
            let out = 1.0 + across * (0.5 * along).cos();
            [out * along.cos(), out * along.sin(), across * (0.5 * along).sin()]
        };
        let pair = |i: u32| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 1, 2 * i + 2, 2 * i + 3]];
        Mesh::new((0..2 * n + 2).map(place).collect(), (0..n).flat_map(pair).collect())
    }

    fn scaled(mesh: &Mesh, exponent: i32) -> Mesh {
        mesh.with_vertices(mesh.vertices.iter().map(|v| v.map(|x| times(x, exponent))).collect())
    }

    /// The rim of the grid of 150 x 150 squares has more edges than the largest hole that the repair fills.
    #[test]
    fn sheets_are_refused_and_not_offered_a_filling() {
        let wave = |x: f64, y: f64| 0.02 * (x + y).sin();
        for mesh in [sheet(12, |_, _| 0.0), sheet(12, wave), sheet(150, wave)] {
            let error = Input::Mesh(mesh.clone()).mended(&Silent).unwrap_err();
            assert!(matches!(error, ParametrizeError::OpenSheet { filled } if filled > 0.4), "{error}");
            let error = parametrize(&mesh, &CaldParams::default()).unwrap_err().to_string();
            assert!(error.contains("open sheet") && !error.contains("a repair is possible"), "{error}");
        }
    }

    /// The largest piece is a single triangle, but the surface isn't a sheet.
    #[test]
    fn triangles_with_gaps_are_separate_pieces() {
        let ball = icosphere(3);
        let apart = |shrink: f64| {
            let corners = |face: &[u32; 3]| {
                let at = face.map(|v| ball.vertices[v as usize]);
                let middle = scale(add(add(at[0], at[1]), at[2]), shrink / 3.0);
                at.map(|corner| add(scale(corner, 1.0 - shrink), middle))
            };
            let vertices: Vec<_> = ball.faces.iter().flat_map(corners).collect();
            Mesh::new(vertices, (0..ball.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())
        };
        let soup = apart(1e-3);
        let tried = parametrize(&soup, &CaldParams::default()).unwrap_err();
        for error in [tried, Input::Mesh(soup).mended(&Silent).unwrap_err()] {
            let text = error.to_string();
            assert!(text.contains("1280 separate pieces; the gaps between them are wider than"), "{text}");
            assert!(text.contains("the welding distance of 1e-5") && !text.contains("sheet"), "{text}");
            assert!(matches!(error, ParametrizeError::BadSurface { mending: None, .. }), "{error}");
        }
        let welded = Input::Mesh(apart(1e-6)).mended(&Silent).unwrap();
        assert!(welded.mesh().is_some_and(|mesh| defects(mesh).0.is_empty()), "{:?}", welded.mesh_repair());
    }

    /// Like a sheet, half of a ball is an open surface. Unlike a sheet, it encloses a body once its rim is filled, so
    /// it is accepted.
    #[test]
    fn a_half_of_a_ball_is_no_sheet() {
        let mended = Input::Mesh(cap(-0.01)).mended(&Silent).unwrap();
        assert!(mended.mesh().is_some_and(|mesh| defects(mesh).0.is_empty()), "{:?}", mended.mesh_repair());
    }

    /// If `cap(0.5)`, the part of a ball above z = 0.5, is filled flat, the filling has more than 40 % of the area.
    /// Therefore the cap's compactness decides whether the cap is a sheet.
    #[test]
    fn the_unit_of_length_has_no_effect() {
        for exponent in [-190, 190, 400] {
            let sheet = Input::Mesh(scaled(&sheet(130, |_, _| 0.0), exponent));
            let tried = sheet.clone().without_handles(&Silent);
            for error in [tried, sheet.mended(&Silent)].map(Result::unwrap_err) {
                assert!(matches!(error, ParametrizeError::OpenSheet { .. }), "2^{exponent}: {error}");
            }
            for body in [cap(-0.01), cap(0.5)] {
                let mended = Input::Mesh(scaled(&body, exponent)).mended(&Silent);
                assert!(mended.is_ok(), "2^{exponent}: {mended:?}");
            }
        }
    }

    #[test]
    fn surfaces_with_one_side_are_named() {
        // A Klein bottle: a grid on a torus whose first and last rows are joined with one direction reversed.
        let n = 8_u32;
        let vertex = |i: u32, j: u32| if i < n { i * n + j % n } else { (n - j % n) % n };
        let quads = (0..n * n).flat_map(|k| {
            let [a, b] = [vertex(k / n, k % n), vertex(k / n + 1, k % n)];
            let [c, d] = [vertex(k / n + 1, k % n + 1), vertex(k / n, k % n + 1)];
            [[a, b, c], [a, c, d]]
        });
        let place = |k: u32| {
            let [u, v] = [k / n, k % n].map(|x| f64::from(x) * TAU / f64::from(n));
            [(2.0 + v.cos()) * u.cos(), (2.0 + v.cos()) * u.sin(), v.sin()]
        };
        let bottle = Mesh::new((0..n * n).map(place).collect(), quads.collect());
        assert!(Topology::of(&bottle).one_sided);
        let error = parametrize(&bottle, &CaldParams::default()).unwrap_err();
        assert!(matches!(error, ParametrizeError::OneSided { closed: true }), "{error}");
        assert!(error.to_string().contains("not orientable"), "{error}");
        assert!(matches!(Input::Mesh(bottle).mended(&Silent), Err(ParametrizeError::OneSided { closed: true })));
    }

    #[test]
    fn a_strip_that_only_its_repair_joins_has_two_sides() {
        let strip = twisted_strip();
        assert!(!Topology::of(&strip).one_sided);
        let error = parametrize(&strip, &CaldParams::default()).unwrap_err();
        assert!(matches!(error, ParametrizeError::BadSurface { mending: None, .. }), "{error}");
        let error = Input::Mesh(strip).mended(&Silent).unwrap_err();
        assert!(matches!(error, ParametrizeError::BadSurface { mending: None, .. }), "{error}");
        assert!(error.to_string().contains("after the repair (2 vertices welded to others"), "{error}");
    }
}
