//! Computes the closed surface around a label of a label volume.
//!
//! ```
//! use spharm_monitor::Silent;
//! use spharm_parametrize::volume::{Affine, LabelVolume, VolumeParams};
//!
//! // Two cells of 2 x 2 x 2 voxels of 0.5 x 0.5 x 1.5 mm, labelled 1 and 2.
//! let affine = Affine([[0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.5, 0.0]]);
//! let values = (0..16).map(|i| if i < 8 { 1 } else { 2 }).collect();
//! let volume = LabelVolume::new([2, 2, 4], values, affine);
//! for label in volume.labels().into_keys() {
//!     let params = VolumeParams { label: Some(label), ..VolumeParams::default() };
//!     let found = volume.surface(&params, &Silent)?;
//!     assert_eq!(found.quads.components(), 1);
//! }
//! # Ok::<(), spharm_parametrize::ParametrizeError>(())
//! ```
//!
//! | module | |
//! |---|---|
//! | `labels` | a label volume: its labels, and a mask of each label's voxels |
//! | `open`, `source` | opening of a file, detection of its format, reading of its bytes |
//! | `nifti`, `nifti2`, `mgh`, `nrrd`, `tiff`, `npy`, `values` | the formats: values and positions of the voxels |
//! | `image`, `axes` | the choice of a channel and a time point; the order of an array's axes |
//! | `shaped` | tifffile's description of the axes of a TIFF stack |
//! | `doubt` | reasons to doubt the voxel size or the positions, for warnings |
//! | `runs` | storage of labels as runs of equal labels, so that background takes no memory |
//! | `mask` | the voxels of one label, with a rim of background around them |
//! | `pieces` | connected pieces of a label, and cavities inside it |
//! | `boundary` | the closed surface of quadrangles between inside and outside |
//! | `surface` | a label's surface, which is checked and, on request, repaired |
//! | `grey` | a body in grey values or probabilities, whose surface is located within the voxels |
//! | `relax` | a label's smooth surface, without the voxels' steps |
//! | `simple` | tests whether moving a voxel inside or outside preserves the topology |
//! | `repair` | repair of any label: the result is one piece without cavities, handles or bare contacts |
//!
//! # Connectivity
//!
//! Voxels inside are connected if they share a face (6-connectivity); voxels outside, if they share a face, an edge or
//! a corner (26-connectivity). If two voxels inside touch only in an edge or a corner, the surface passes between the
//! voxels, and its vertices at this edge or corner are doubled. The boundary is then a closed surface that touches
//! itself only at such edges and corners. A repaired label has no such contacts, and has the same topology in every
//! connectivity, including (18, 6).
//!
//! # Units
//!
//! Voxels are counted from 0; voxel (i, j, k) is the unit cube centred at (i, j, k). The file's matrix maps voxel
//! coordinates to RAS+ mm. For NIfTI this matrix is the sform; without an sform, the qform; without either, a matrix of
//! the voxel sizes. Lengths of NIfTI and NRRD files in other units are converted to mm. Positions in TIFF stacks are in
//! micrometres.

mod affine;
mod axes;
mod boundary;
mod doubt;
mod grey;
mod image;
mod labels;
mod mask;
mod mgh;
mod nifti;
mod nifti2;
mod npy;
mod nrrd;
mod open;
mod pieces;
mod relax;
mod repair;
mod runs;
mod shaped;
mod simple;
mod source;
mod steps;
mod surface;
mod tiff;
mod values;

pub use affine::Affine;
pub use axes::AxisOrder;
pub use boundary::QuadMesh;
pub use doubt::{VolumeDoubt, VolumeDoubts};
pub use grey::VoxelValues;
pub use image::ImageChoice;
pub use labels::{LabelVolume, VolumeReading};
pub use mask::Mask;
pub use open::is_volume;
pub use pieces::{Pieces, pieces};
pub use repair::{HandleRepair, Repair, repair};
pub use steps::{VoxelSteps, steps_of_labels, suitable_degree};
pub use surface::{LabelSurface, VolumeParams, VolumeSurface};
