//! Words that the help of all verbs shares.

/// Heading of what a verb reads.
pub const INPUT: &str = "Input";
/// Heading of what it writes.
pub const OUTPUT: &str = "Output";
/// Heading of what it computes.
pub const METHOD: &str = "Method";
/// Heading of how equations are solved.
pub const SOLVER: &str = "Solver";
/// Heading of memory and threads.
pub const RESOURCES: &str = "Resources";

/// The formats of meshes.
pub const MESHES: &str = "Meshes: GIfTI (.surf.gii, .gii), FreeSurfer surfaces (lh.*, rh.*), .obj, .ply, .off, .stl, .vtk \
                          (legacy), SPHARM-PDM's .meta; written also .glb; .gz may follow.";
/// The formats of values on vertices.
pub const SIGNALS: &str = "Values on vertices: GIfTI (.func.gii, .shape.gii), FreeSurfer curv files and maps (.mgh, \
                           .mgz), .csv and .tsv (a row a vertex, a column a channel).";

/// The formats of label volumes.
pub const VOLUMES: &str = "Label volumes: NIfTI-1 and -2 (.nii, .nii.gz), FreeSurfer (.mgh, .mgz), NRRD (.nrrd, .nhdr), TIFF and \
                           OME-TIFF stacks (.tif, .tiff), arrays (.npy, first axis x, with --voxel-size).";

/// The end of a verb's long help: examples, then notes such as the formats.
pub fn examples(examples: &[&str], notes: &[&str]) -> String {
    let examples: String = examples.iter().map(|line| format!("\n  {line}")).collect();
    let notes: String = notes.iter().map(|note| format!("\n\n{note}")).collect();
    format!("Examples:{examples}{notes}")
}
