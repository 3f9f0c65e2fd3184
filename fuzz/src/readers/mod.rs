//! Calls every reader with arbitrary bytes. A reader must return a value that keeps the reader's promises, or an error.
//! libFuzzer calls these functions, and `./run test` calls them with the files of `tests/data/hostile`.
//!
//! The last byte of an input chooses the name of the file, or which check sums are corrected before the file is read.
//! The other bytes are the content of the file.

mod journals;
mod mend;
mod store;

use std::path::{Path, PathBuf};

use spharm_cohort::{Manifest, Merged};
use spharm_exchange::{Format, ImportOptions, import};
use spharm_model::Model;
use spharm_model::arrays::Arrays;
use spharm_moments::{Moments, Request, accumulate};
use spharm_monitor::Silent;
use spharm_parametrize::volume::{AxisOrder, ImageChoice, LabelVolume, VolumeReading, VoxelValues};
use spharm_shape::codec::{ExpandParams, expand};
use spharm_shape::pca::file::ShapeModel;
use spharm_surface::io::landmarks::Landmarks;
use spharm_surface::io::{read_input, read_signal_with_gaps};
use spharm_surface::topology::Topology;
use spharm_surface::{Input, Mesh};

/// A function that calls a reader, given a folder for its files and the input.
type Reader = fn(&Path, &[u8]);

/// Every reader by its name, which is also the name of its corpus's folder.
pub(crate) const READERS: [(&str, Reader); 13] = [
    ("surfaces", surfaces),
    ("volumes", volumes),
    ("tables", tables),
    ("models", models),
    ("archives", archives),
    ("basis", store::basis),
    ("factors", store::factors),
    ("moments", moments),
    ("sphz", sphz),
    ("cohorts", cohorts),
    ("exchange", exchange),
    ("journals", journals::journals),
    ("landmarks", landmarks),
];

/// Passes an input to a reader.
///
/// # Panics
///
/// If no reader has this name, or if the reader's result violates one of the reader's guarantees.
pub(crate) fn run(name: &str, folder: &Path, input: &[u8]) {
    let (_, reader) = READERS.iter().find(|(known, _)| *known == name).expect("a reader");
    reader(folder, input);
}

/// Returns a folder for the files of this process, in the folder that `SPHARM_FUZZ_FOLDER` names (preferably in memory)
/// or in the system's temporary folder. The caller who sets the variable has to remove the files.
#[allow(dead_code)]
pub(crate) fn scratch() -> &'static Path {
    static FOLDER: std::sync::OnceLock<PathBuf> = std::sync::OnceLock::new();
    FOLDER.get_or_init(|| {
        let within = std::env::var_os("SPHARM_FUZZ_FOLDER").map_or_else(std::env::temp_dir, PathBuf::from);
        let folder = within.join(format!("fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for the files that are read");
        folder
    })
}

/// Writes a file for a reader.
fn file(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file");
    path
}

/// Returns the last byte modulo `count`, and the bytes before it.
fn choice(input: &[u8], count: usize) -> Option<(usize, &[u8])> {
    input.split_last().map(|(&last, bytes)| (usize::from(last) % count, bytes))
}

fn check_mesh(mesh: &Mesh) {
    assert!(mesh.vertices.as_flattened().iter().all(|x| x.is_finite()), "positions are finite");
    assert!(mesh.faces.as_flattened().iter().all(|&v| (v as usize) < mesh.vertices.len()), "vertices are there");
    if mesh.faces.len() < 10_000 {
        let _ = Topology::of(mesh).is_sphere();
    }
}

fn surfaces(folder: &Path, input: &[u8]) {
    const NAMES: [&str; 20] = [
        "x",
        "x.obj",
        "x.ply",
        "x.off",
        "x.stl",
        "x.vtk",
        "x.meta",
        "x.surf.gii",
        "x.func.gii",
        "x.mgh",
        "x.csv",
        "x.tsv",
        "lh.pial",
        "lh.curv",
        "x.glb",
        "x.gltf",
        "x.vtp",
        "x.vtu",
        "x.3mf",
        "x.wrl",
    ];
    let Some((name, bytes)) = choice(input, NAMES.len()) else { return };
    let path = file(folder, NAMES[name], bytes);
    match read_input(&path) {
        Ok(Input::Mesh(mesh)) => check_mesh(&mesh),
        Ok(Input::Signal(signal)) => {
            assert_eq!(signal.values.len(), signal.vertices * signal.channels);
            assert!(signal.values.iter().all(|x| x.is_finite()), "values are finite");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    if let Ok(signal) = read_signal_with_gaps(&path) {
        assert_eq!(signal.values.len(), signal.vertices * signal.channels);
    }
}

fn volumes(folder: &Path, input: &[u8]) {
    const NAMES: [&str; 6] = ["x.nii", "x.nii.gz", "x.mgz", "x.nrrd", "x.tif", "x.npy"];
    let Some((name, bytes)) = choice(input, NAMES.len()) else { return };
    let path = file(folder, NAMES[name], bytes);
    let values = [VoxelValues::Labels, VoxelValues::Level(0.5), VoxelValues::Probability][bytes.len() % 3];
    let image = ImageChoice {
        channel: (bytes.len() % 5 == 0).then(|| 1 + bytes.len() / 5 % 3),
        time: (bytes.len() % 7 == 0).then(|| 1 + bytes.len() / 7 % 3),
    };
    // Other formats refuse this order.
    let axes = if name == 5 && bytes.len() % 2 == 0 { AxisOrder::Zyx } else { AxisOrder::Xyz };
    let reading = VolumeReading { voxel_size: (name >= 4).then_some([1.0; 3]), values, image, axes };
    if let Ok(volume) = LabelVolume::read_with(&path, reading, &Silent) {
        for label in volume.labels().into_keys().take(2) {
            let _ = (volume.touches_border(label), volume.mask(label));
        }
    }
}

fn tables(folder: &Path, input: &[u8]) {
    const NAMES: [&str; 8] = ["x.csv", "x.tsv", "x.npy", "x.npz", "x.ply", "x.las", "x.parquet", "x.arrow"];
    let Some((name, bytes)) = choice(input, NAMES.len()) else { return };
    let mut request = Request::new(vec![file(folder, NAMES[name], bytes)], 1);
    request.columns.values = vec!["radius".to_owned()];
    if let Ok(found) = accumulate(&request, &Silent) {
        assert!(found.moments.rows > 0, "an empty table is refused");
    }
}

fn models(folder: &Path, input: &[u8]) {
    read_model(folder, input);
}

/// The input lists the members of an archive, each by the number of its name, its length and its content. The archive's
/// own check sums and offsets are therefore always valid.
fn archives(folder: &Path, input: &[u8]) {
    if let Some((kind, bytes)) = choice(input, 2) {
        read_model(folder, &mend::archive(bytes, kind == 1));
    }
}

fn read_model(folder: &Path, bytes: &[u8]) {
    if let Ok(model) = Model::from_bytes(bytes) {
        assert!(model.coefficients.values().iter().all(|x| x.is_finite()), "coefficients are finite");
        let mut again = Vec::new();
        model.write_to(&mut again).expect("what is read can be written");
        let back = Model::from_bytes(&again).expect("what is written can be read");
        assert_eq!(back.coefficients.values(), model.coefficients.values());
    }
    let path = file(folder, "x.npz", bytes);
    let _ = ShapeModel::read(&path);
    if let Ok(mut arrays) = Arrays::open(&path) {
        let _ = (arrays.matrix("coefficients"), arrays.text("provenance"));
    }
}

fn moments(_: &Path, input: &[u8]) {
    let Some((mended, bytes)) = choice(input, 2) else { return };
    let mut bytes = bytes.to_vec();
    if mended == 1 {
        mend::moments(&mut bytes);
    }
    if let Ok(moments) = Moments::from_bytes(&bytes) {
        let written = moments.to_bytes().expect("what is read can be written");
        if bytes[8] == 1 {
            let again = Moments::from_bytes(&written).expect("what is written can be read");
            assert!(
                again.to_bytes().is_ok_and(|bytes| bytes == written),
                "version 1 becomes the version that is written"
            );
        } else {
            assert!(written == bytes, "byte for byte");
        }
    }
}

fn sphz(_: &Path, input: &[u8]) {
    let Some((kind, bytes)) = choice(input, 4) else { return };
    let mut bytes = bytes.to_vec();
    if kind & 1 == 1 {
        mend::sphz(&mut bytes);
    }
    let params = ExpandParams { prefix: kind & 2 == 2, ..ExpandParams::default() };
    if let Ok(expanded) = expand(&bytes, &params) {
        assert!(expanded.model.coefficients.values().iter().all(|x| x.is_finite()), "coefficients are finite");
        assert!(expanded.levels.iter().all(|level| level.degree <= 2000));
    }
}

fn cohorts(folder: &Path, input: &[u8]) {
    let Some((kind, bytes)) = choice(input, 3) else { return };
    if kind < 2 {
        if let Ok(manifest) = Manifest::parse(folder.join(["list.tsv", "list.csv"][kind]), bytes) {
            let mut ids: Vec<&str> = manifest.rows.iter().map(|row| row.id.as_str()).collect();
            ids.sort_unstable();
            ids.dedup();
            assert_eq!(ids.len(), manifest.rows.len(), "an id is there once");
            assert!(ids.iter().all(|id| !id.is_empty() && !id.contains(['/', '\0'])), "an id can name a file");
        }
    } else if let Ok(merged) = Merged::read([file(folder, "status.tsv", bytes)]) {
        assert!(merged.entries().iter().all(|entry| !entry.id.is_empty()));
    }
}

fn exchange(folder: &Path, input: &[u8]) {
    let Some((choice, bytes)) = choice(input, Format::ALL.len() + 1) else { return };
    let format = Format::ALL.get(choice).copied();
    let path = file(folder, &format.map_or("x".to_owned(), |format| format!("x.{}", format.ending())), bytes);
    if let Ok(found) = import(&[path], &ImportOptions { format, ..ImportOptions::default() }) {
        assert!(found.coefficients.values().iter().all(|x| x.is_finite()), "coefficients are finite");
    }
}

fn landmarks(folder: &Path, input: &[u8]) {
    const NAMES: [&str; 5] = ["x.mrk.json", "x.json", "x.fcsv", "x.csv", "x.tsv"];
    let Some((name, bytes)) = choice(input, NAMES.len()) else { return };
    let path = file(folder, NAMES[name], bytes);
    if let Ok(found) = Landmarks::read(&path) {
        assert!(!found.names.is_empty() && found.names.len() == found.points.len(), "each has a name");
        assert!(found.points.as_flattened().iter().all(|x| x.is_finite()), "positions are finite");
        let matched = Landmarks::matched(&[found.clone(), found.clone()]);
        assert_eq!(matched.names, found.names, "a name is there once");
        found.write(&path, true).expect("what is read can be written");
        let back = Landmarks::read(&path).expect("what is written can be read");
        assert_eq!(back.points, found.points);
    }
}
