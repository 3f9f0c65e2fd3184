//! Texts that the help of several verbs (subcommands) has in common.

/// Help heading for inputs.
pub const INPUT: &str = "Input";
/// Help heading for outputs.
pub const OUTPUT: &str = "Output";
/// Help heading for settings of the computation.
pub const METHOD: &str = "Method";
/// Help heading for settings of the equation solver.
pub const SOLVER: &str = "Solver";
/// Help heading for settings of memory and threads.
pub const RESOURCES: &str = "Resources";

/// List of the supported mesh formats, for `--help`.
pub const MESHES: &str = "Meshes: GIfTI (.surf.gii, .gii), FreeSurfer surfaces (lh.*, rh.*), .obj, .ply, .off, .stl, .vtk \
                          (legacy), .vtp, .glb, .3mf; read only: .vtu, .gltf, .wrl, SPHARM-PDM's .meta; each may be \
                          gzipped (.gz).";
/// List of the supported formats of values on vertices, for `--help`.
pub const SIGNALS: &str = "Values on vertices: GIfTI (.func.gii, .shape.gii), FreeSurfer curv files and maps (.mgh, \
                           .mgz), .csv and .tsv (one row per vertex, one column per channel).";

/// List of the supported formats of label volumes, for `--help`.
pub const VOLUMES: &str = "Label volumes: NIfTI-1 and -2 (.nii, .nii.gz), FreeSurfer (.mgh, .mgz), NRRD (.nrrd, .nhdr), TIFF and \
                           OME-TIFF stacks (.tif, .tiff), arrays (.npy, axes xyz or --axes zyx, with --voxel-size).";

/// Returns the end of a verb's long help: examples, then notes such as the formats.
pub fn examples(examples: &[&str], notes: &[&str]) -> String {
    let examples: String = examples.iter().map(|line| format!("\n  {line}")).collect();
    let notes: String = notes.iter().map(|note| format!("\n\n{note}")).collect();
    format!("Examples:{examples}{notes}")
}
