//! Replaces any mesh, even a defective one, by a single closed surface around it. The mesh may have overlapping or
//! nested parts, double walls, holes and self-intersections.
//!
//! 1. A grid of voxels is laid around the mesh. A voxel is inside if the generalized winding number at its centre is
//!    above 0.5 (`winding`).
//! 2. The largest piece of these voxels is kept, its cavities are filled and its handles removed, as in a label that is
//!    repaired ([`volume`](crate::volume)).
//! 3. The surface of the voxels is smoothed: it is replaced by the surface of least bending within half a voxel of the
//!    voxels' faces. Then the vertices that are at most a voxel away from the mesh are moved onto the mesh (`snap`).
//!
//! Walls and gaps thinner than a voxel are lost. Time and memory grow with the cube of the number of voxels along the
//! longest side; 128 voxels take about 100 MB.

pub(crate) mod limits;
mod outlier;
mod snap;
mod trial;
mod winding;

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor, Stage};
use spharm_surface::Mesh;
use spharm_surface::geometry::bounds;
use spharm_surface::io::check_room;
use spharm_surface::metrics::{FarSample, SurfaceDistanceParams, directed_distance};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::repair::{MeshRepair, Wrap, orient_outward};

pub use self::limits::{USUAL_VOXELS, VOXELS};
use self::outlier::check_rest;
use self::snap::snap;
pub use self::trial::would_wrap;
use self::winding::WindingNumbers;
use crate::enclosure::check_one_piece;
use crate::error::ParametrizeError;
use crate::flaws::Flaws;
use crate::geometry::{Vec3, add, scale, sub};
use crate::volume::{Affine, HandleRepair, LabelSurface, LabelVolume, VolumeParams, VoxelValues};

/// Number of layers of background voxels around the mesh.
const MARGIN: usize = 2;
/// Distance from the wrap, in voxels, beyond which a part of the mesh outside of the wrap is reported as lost.
/// Smoothing moves the wrap by less than this distance.
const LOST: f64 = 2.0;
/// Number of bytes per voxel: 1 for the flag that states whether the voxel is inside, 8 for its distance from the mesh,
/// 17 for its entry in the volume, and 37 while the volume is repaired.
const BYTES_PER_VOXEL: u64 = 63;

/// Returns a closed surface of genus zero around a mesh, and a report on the changes. `voxels` is the number of voxels
/// along the longest side of the mesh's bounding box, one of [`VOXELS`].
///
/// # Errors
///
/// [`Argument`](ParametrizeError::Argument) if the number of voxels is outside of [`VOXELS`];
/// [`NoRoomToWrap`](ParametrizeError::NoRoomToWrap) if memory doesn't suffice;
/// [`NothingToWrap`](ParametrizeError::NothingToWrap) if the mesh encloses no voxel;
/// [`FarVertex`](ParametrizeError::FarVertex) if a vertex lies so far away that the rest of the mesh spans too few
/// voxels; [`OpenSheet`](ParametrizeError::OpenSheet) or [`OneSided`](ParametrizeError::OneSided) if the mesh is one
/// open piece that encloses no body; [`InvalidMesh`](ParametrizeError::InvalidMesh) if coordinates aren't finite or
/// indices are out of range; [`Interrupted`](ParametrizeError::Interrupted).
pub fn wrap(surface: &Mesh, voxels: usize, monitor: &dyn Monitor) -> Result<(Mesh, MeshRepair), ParametrizeError> {
    if !VOXELS.contains(&voxels) {
        return Err(ParametrizeError::Argument {
            what: "wrap",
            expected: "16 to 512 voxels",
            found: voxels.to_string(),
        });
    }
    // Returns an error if indices or coordinates are invalid; other defects are ignored.
    Flaws::of(surface)?;
    let frame = Frame::around(surface, voxels);
    let count = frame.size.iter().map(|&n| n as u64).product::<u64>();
    check_room(count.saturating_mul(BYTES_PER_VOXEL))
        .map_err(|room| ParametrizeError::NoRoomToWrap { voxels, room })?;
    let placed = frame.in_voxels(surface);
    let (given, mut found) = orient_outward(&placed);
    check_rest(&given, surface, voxels, 0.0)?;
    check_one_piece(&placed)?;
    drop(placed);
    let tree = TriangleTree::new(&given);
    let values = signed_distances(&given, &tree, frame.size, monitor)?;
    let body = LabelVolume::of_values(frame.size, &values, VoxelValues::Level(0.0), Affine::IDENTITY);
    let body = body.map_err(|error| match error {
        ParametrizeError::NotAVolume { .. } => {
            check_rest(&given, surface, voxels, 1.0).err().unwrap_or(ParametrizeError::NothingToWrap { voxels })
        }
        error => error,
    })?;
    drop(values);
    let params = VolumeParams { label: Some(1), surface: LabelSurface::default(), fix: true, handles: false };
    let outer = body.surface(&params, monitor)?;
    let mut mesh = outer.quads.triangles(|_| false);
    snap(&mut mesh, &given, &tree, 1.0);
    let params = SurfaceDistanceParams::default();
    let around = TriangleTree::new(&mesh);
    let (_, hidden) = directed_distance(&given, &around, 1.0, &params, monitor)?;
    let (distance, bridged) = directed_distance(&mesh, &tree, 1.0, &params, monitor)?;
    let report = Wrap {
        voxels,
        voxel: frame.voxel,
        hidden_area: area(&hidden),
        lost_area: lost_area(&hidden, &mesh, monitor)?,
        bridged_area: area(&bridged),
        rms_distance: distance.rms * frame.voxel,
        pieces: outer.repair.map_or(0, |repair| repair.pieces_dropped),
        left_out: outer.repair.map_or(0.0, |repair| repair.share_dropped()),
        cavities: outer.repair.map_or(0, |repair| repair.cavities_filled),
        handles: outer.repair.map_or(0, |repair| repair.handles_removed),
        handles_cut: outer.repair.is_some_and(|repair| repair.handles == HandleRepair::Cut),
    };
    check_rest(&given, surface, voxels, report.loss())?;
    found.wrap = Some(report);
    mesh.vertices.iter_mut().for_each(|vertex| *vertex = frame.out_of_voxels(*vertex));
    mesh.meta = surface.meta.clone();
    Ok((mesh, found))
}

fn area(samples: &[FarSample]) -> f64 {
    samples.iter().map(|sample| sample.share).sum()
}

/// Returns the share of a mesh's area that lies outside of its wrap and farther than [`LOST`] from it. `far` contains
/// the mesh's sample points that are more than a voxel away from the wrap.
fn lost_area(far: &[FarSample], wrap: &Mesh, monitor: &dyn Monitor) -> Result<f64, Interrupted> {
    /// Number of sample points between checks of the monitor.
    const CHUNK: usize = 256;
    let numbers = WindingNumbers::new(wrap);
    let lost = |sample: &FarSample| sample.distance > LOST && numbers.at(sample.point) < 0.5;
    let share = |chunk: &[FarSample]| {
        monitor.check()?;
        Ok::<f64, Interrupted>(chunk.iter().filter(|sample| lost(sample)).map(|sample| sample.share).sum())
    };
    // The order of the chunks is fixed, so that the sum doesn't depend on the number of threads.
    let shares: Vec<f64> = far.par_chunks(CHUNK).map(share).collect::<Result<_, Interrupted>>()?;
    Ok(shares.iter().sum())
}

/// The grid of voxels around a mesh: its position and size.
struct Frame {
    /// Position of the centre of voxel (0, 0, 0).
    origin: Vec3,
    /// Length of a voxel's edges.
    voxel: f64,
    size: [usize; 3],
}

impl Frame {
    fn around(surface: &Mesh, voxels: usize) -> Self {
        // Coordinates are halved, since the difference of two large numbers may overflow. Vertices that no triangle
        // uses are ignored.
        let corners = surface.faces.as_flattened().iter();
        let (low, high) = bounds(corners.map(|&v| scale(surface.vertices[v as usize], 0.5)));
        let longest = sub(high, low).into_iter().fold(0.0, f64::max);
        let voxel = if longest > 0.0 { longest / voxels as f64 * 2.0 } else { 1.0 };
        let size = sub(high, low).map(|x| (2.0 * (x / voxel)).ceil() as usize + 2 * MARGIN);
        // Centres the mesh in the grid.
        let middle = size.map(|n| 0.5 * (n as f64 - 1.0));
        Self { origin: sub(add(low, high), scale(middle, voxel)), voxel, size }
    }

    fn in_voxels(&self, surface: &Mesh) -> Mesh {
        let placed = surface.vertices.iter().map(|&v| sub(v, self.origin).map(|x| x / self.voxel)).collect();
        Mesh::new(placed, surface.faces.clone())
    }

    fn out_of_voxels(&self, position: Vec3) -> Vec3 {
        add(self.origin, scale(position, self.voxel))
    }
}

/// Returns each voxel's signed distance from the mesh in voxels, negative outside. The distance is computed, and
/// limited to the range from 0.001 to 1, only at voxels with a neighbour on the other side; at all other voxels it is
/// set to 1.
fn signed_distances(
    mesh: &Mesh,
    tree: &TriangleTree,
    size: [usize; 3],
    monitor: &dyn Monitor,
) -> Result<Vec<f64>, ParametrizeError> {
    let numbers = WindingNumbers::new(mesh);
    let plane = size[0] * size[1];
    let at = |index: usize| [index % size[0], index % plane / size[0], index / plane];
    let place = |index: usize| at(index).map(|x| x as f64);
    let mut inside = vec![false; plane * size[2]];
    monitor.begin(Stage::counted("wrap", "slices"), size[2] as u64);
    for (z, slice) in inside.chunks_mut(plane).enumerate() {
        monitor.check()?;
        slice.par_iter_mut().enumerate().for_each(|(i, inside)| *inside = numbers.at(place(z * plane + i)) > 0.5);
        monitor.step(1);
    }
    monitor.end();
    let side = |index: usize| if inside[index] { 1.0 } else { -1.0 };
    let distance = |index: usize| {
        let changes = (0..3).any(|k| {
            let step = [1, size[0], plane][k];
            let x = at(index)[k];
            (x > 0 && inside[index - step] != inside[index])
                || (x + 1 < size[k] && inside[index + step] != inside[index])
        });
        let near = changes.then(|| tree.distance(place(index), None)).flatten();
        side(index) * near.map_or(1.0, |(_, distance)| distance.clamp(1e-3, 1.0))
    };
    Ok((0..inside.len()).into_par_iter().map(distance).collect())
}
