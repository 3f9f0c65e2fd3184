//! Basis stores, as fits use them.

use std::path::Path;

use spharm_monitor::{Monitor, Stage};
use spharm_store::{DegreeFile, Scalar, Scheme, SchemeKey, StoreError, catalog};
use spharm_surface::Sphere;

use crate::Error;

/// Opens the basis of a sphere's directions to a degree; without `scalar` the one in f64, or where there is none that in
/// f32.
///
/// # Errors
///
/// [`Error::OpenStore`], and [`Error::Store`] where the store has no such basis or not to this degree.
pub fn open_scheme(
    store: &Path,
    sphere: &Sphere,
    max_degree: usize,
    scalar: Option<Scalar>,
) -> Result<(Scheme, Scalar), Error> {
    let n = sphere.directions.len();
    let open = |scalar| Scheme::open(store, SchemeKey::of(&sphere.directions, scalar), n, max_degree);
    if let Err(source) = std::fs::read_dir(store) {
        return Err(Error::OpenStore { store: store.to_owned(), source });
    }
    if let Some(scalar) = scalar {
        return Ok((open(scalar)?, scalar));
    }
    match open(Scalar::F64) {
        Err(missing @ StoreError::NoSuchScheme { .. }) => match open(Scalar::F32) {
            Err(StoreError::NoSuchScheme { .. }) => Err(missing.into()),
            single => Ok((single?, Scalar::F32)),
        },
        double => Ok((double?, Scalar::F64)),
    }
}

/// Checks every byte of a basis against its hash.
///
/// # Errors
///
/// [`Error::Store`] with the first file that is damaged, [`Error::Interrupted`].
pub fn verify(scheme: &Scheme, monitor: &dyn Monitor) -> Result<(), Error> {
    monitor.begin(Stage::bytes("verify"), scheme.files().iter().map(DegreeFile::file_len).sum());
    let mut buffer = Vec::new();
    for file in scheme.files() {
        monitor.check()?;
        catalog::verify(file, &mut buffer)?;
        monitor.step(file.file_len());
    }
    monitor.end();
    Ok(())
}
