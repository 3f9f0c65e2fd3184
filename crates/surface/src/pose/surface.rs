//! Represents a surface by points at three densities. Each point represents a piece of the surface.

use super::grid::Grid;
use super::level::Level;
use crate::geometry::{Vec3, cross, dot, sub};
use crate::kabsch::svd;
use crate::matrix3::{Matrix3, determinant, transposed};
use crate::mesh::Mesh;
use crate::spread::SpreadPoints;

/// Number of points at each density. The first density is for ranking starts, and the last density is for the final
/// motion.
const DENSITIES: [usize; 3] = [256, 1024, 4096];

/// A surface prepared for pose searches: points on it, search trees, and principal axes. It takes about 0.5 MB.
pub struct PoseSurface {
    pub(super) levels: [Level; 3],
    /// Table for approximate searches among the points of the second density.
    pub(super) grid: Grid,
    /// Mean of the surface's points, in the surface's unit.
    pub centre: Vec3,
    /// Principal axes of the surface's area, the longest first, as the rows of a rotation.
    pub axes: Matrix3,
    /// Root mean square distance of the surface's area from the centre along each axis.
    pub lengths: Vec3,
    /// Area of the surface, in the square of its unit.
    pub area: f64,
    /// Volume between the surface's triangles and the centre, in the cube of the unit. It is negative if the surface is
    /// inside out.
    pub volume: f64,
}

/// The number of points that represent a surface in a step of the search.
#[derive(Clone, Copy)]
pub(super) enum Density {
    /// 256 points. For each point, the nearest of the other surface's 1,024 pieces is found approximately, with a
    /// table.
    Few,
    /// 1,024 points.
    Some,
    /// All 4,096 points.
    All,
}

/// The points of a surface for one step of the search. Each point of `asking` is paired with the nearest piece of the
/// other surface. Each point of the other surface is paired with the nearest of `pieces`.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) asking: &'a Level,
    pub(super) pieces: &'a Level,
    grid: Option<&'a Grid>,
}

impl View<'_> {
    /// Returns the index of the surface's piece nearest to `p`, or approximately nearest if this step of the search
    /// uses a table.
    pub(super) fn nearest(&self, p: Vec3) -> usize {
        self.grid.map_or_else(|| self.pieces.nearest(p), |grid| grid.nearest(p))
    }
}

impl PoseSurface {
    /// Spreads points over a mesh, which can have any topology and order of triangles. Returns `None` for a mesh
    /// without area, or with coordinates that aren't finite or have infinite squares.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Option<Self> {
        let [few, some, all] = DENSITIES;
        let spread = SpreadPoints::new(mesh, all, 0);
        let SpreadPoints { points, normals, .. } = spread;
        // Rounding may leave out one point, but more points are missing only if the mesh has no area or isn't finite.
        if points.len() + 1 < all {
            return None;
        }
        let corners = || mesh.faces.iter().map(|face| face.map(|v| mesh.vertices[v as usize]));
        let area: f64 = corners().map(crate::geometry::face_normal).map(|n| 0.5 * dot(n, n).sqrt()).sum();
        let count = points.len() as f64;
        let centre: Vec3 = std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / count);
        let solid = |[a, b, c]: [Vec3; 3]| dot(sub(a, centre), cross(sub(b, centre), sub(c, centre))) / 6.0;
        let volume = corners().map(solid).sum();
        let mut scatter = Matrix3::default();
        for p in &points {
            let p = sub(*p, centre);
            (0..3).for_each(|i| (0..3).for_each(|j| scatter[i][j] += p[i] * p[j] / count));
        }
        if !scatter.as_flattened().iter().all(|v| v.is_finite()) || scatter == Matrix3::default() {
            return None;
        }
        let found = svd(&scatter);
        let mut axes = transposed(&found.u);
        if determinant(&axes) < 0.0 {
            axes[2] = axes[2].map(|v| -v);
        }
        let level = |count: usize| {
            let chosen = thinned(&points, count);
            let of = |all: &[Vec3]| chosen.iter().map(|i| all[*i]).collect();
            Level::new(of(&points), of(&normals), area)
        };
        let levels = [level(few)?, level(some)?, Level::new(points.clone(), normals.clone(), area)?];
        let grid = Grid::new(&levels[1], &axes);
        Some(Self { levels, grid, centre, axes, lengths: found.values.map(f64::sqrt), area, volume })
    }

    /// Returns the points that a step of the search with the given density uses.
    pub(super) fn view(&self, density: Density) -> View<'_> {
        match density {
            Density::Few => View { asking: &self.levels[0], pieces: &self.levels[1], grid: Some(&self.grid) },
            Density::Some => View { asking: &self.levels[1], pieces: &self.levels[1], grid: None },
            Density::All => View { asking: &self.levels[2], pieces: &self.levels[2], grid: None },
        }
    }

    /// Returns the square root of the surface's area, a measure of its size.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.area.sqrt()
    }

    /// Returns the points of the densest set, which are spread evenly over the surface's area, and the surface's
    /// normals at these points.
    #[must_use]
    pub fn points(&self) -> (&[Vec3], &[Vec3]) {
        (&self.levels[2].points, &self.levels[2].normals)
    }
}

/// Returns the indices of `count` points that are spread as evenly as the complete set of points. Space is repeatedly
/// halved along the longest side of the points' box into cells of equal numbers of points, and the point nearest to the
/// mean of each cell is taken. Taking every n-th point would be even only if consecutive triangles were neighbours on
/// the surface.
fn thinned(points: &[Vec3], count: usize) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..points.len()).collect();
    let mut chosen = Vec::with_capacity(count);
    halve(points, &mut indices, count.min(points.len()), &mut chosen);
    chosen
}

fn halve(points: &[Vec3], cell: &mut [usize], count: usize, chosen: &mut Vec<usize>) {
    if count == 0 {
        return;
    }
    if count == 1 {
        let middle: Vec3 = std::array::from_fn(|k| cell.iter().map(|i| points[*i][k]).sum::<f64>() / cell.len() as f64);
        let square = |i: &usize| dot(sub(points[*i], middle), sub(points[*i], middle));
        chosen.extend(cell.iter().copied().min_by(|a, b| square(a).total_cmp(&square(b)).then(a.cmp(b))));
        return;
    }
    let (low, high) = crate::geometry::bounds(cell.iter().map(|i| points[*i]));
    let side = sub(high, low);
    let axis = (1..3).fold(0, |most, k| if side[k] > side[most] { k } else { most });
    let first = count / 2;
    let at = cell.len() * first / count;
    cell.select_nth_unstable_by(at, |a, b| points[*a][axis].total_cmp(&points[*b][axis]).then(a.cmp(b)));
    let (left, right) = cell.split_at_mut(at);
    halve(points, left, first, chosen);
    halve(points, right, count - first, chosen);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::geometry::unit;

    #[test]
    fn few_points_are_even_whatever_the_order_of_the_triangles() {
        let mut ball = icosphere(5);
        // Multiplication by a number coprime to the number of triangles shuffles the triangles.
        let faces = ball.faces.len();
        ball.faces = (0..faces).map(|i| ball.faces[i * 7919 % faces]).collect();
        let surface = PoseSurface::new(&ball).unwrap();
        for level in &surface.levels[..2] {
            // The bound on the distance to the nearest point is twice the side of a square with one point's share of
            // the area.
            let asked = icosphere(4).vertices;
            let far = asked.iter().map(|v| {
                let off = sub(level.points[level.nearest(*v)], *v);
                dot(off, off).sqrt()
            });
            assert!(far.fold(0.0, f64::max) < 2.0 * level.radius);
        }
    }

    #[test]
    fn axes_are_those_of_the_shape() {
        let ball = icosphere(4);
        let ellipsoid =
            ball.with_vertices(ball.vertices.iter().map(|v| [2.0 * v[2] + 7.0, 5.0 * v[0], 9.0 * v[1]]).collect());
        let surface = PoseSurface::new(&ellipsoid).unwrap();
        let PoseSurface { axes, centre, lengths, .. } = surface;
        // The longest axis of the new body lies along z, the second along y.
        assert!(axes[0][2].abs() > 0.999 && axes[1][1].abs() > 0.999 && axes[2][0].abs() > 0.999, "{axes:?}");
        assert!((determinant(&axes) - 1.0).abs() < 1e-12);
        assert!(lengths[0] > lengths[1] && lengths[1] > lengths[2]);
        assert!((centre[0] - 7.0).abs() < 0.1 && centre[1].abs() < 0.1 && centre[2].abs() < 0.1, "{centre:?}");
        assert_eq!(surface.levels[2].points.len(), surface.levels[2].normals.len());
    }

    #[test]
    fn what_has_no_area_has_no_pose() {
        let ball = icosphere(1);
        for vertices in [vec![[1.0; 3]; 42], vec![[f64::NAN; 3]; 42], vec![[f64::INFINITY; 3]; 42]] {
            assert!(PoseSurface::new(&ball.with_vertices(vertices)).is_none());
        }
        let far = ball.vertices.iter().map(|v| unit(*v).map(|x| 1e200 * x)).collect();
        assert!(PoseSurface::new(&ball.with_vertices(far)).is_none());
        assert!(PoseSurface::new(&Mesh::default()).is_none());
    }
}
