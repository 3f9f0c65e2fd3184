//! Reads and writes a file with the modes of a group, `NAME.shape-model.npz`.
//!
//! | array | type | contents |
//! |---|---|---|
//! | `coefficients` | f64 (K, 3) | canonical coefficients of the mean, as in a model file |
//! | `modes` | f64 (m, 3 (K - 1)) | modes without row 0, row-major (K - 1, 3), of norm sqrt(4 pi) |
//! | `variances` | f64 (m, 1) | variance along each mode |
//! | `scores` | f64 (n, m) | coordinates of the group's members |
//! | `total_variance` | f64 (1, 1) | variance along all modes |
//! | `convention` | text () | convention of the coefficients, as in a model file |
//! | `members` | text () | names of the group's members, one per line |
//! | `provenance` | text () | provenance of the file, as JSON |

use std::path::Path;

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Coefficients;
use spharm_model::arrays::{Arrays, Entry, write_arrays};
use spharm_model::{CONVENTION, ModelError};

use super::Modes;

/// The contents of a shape model file.
#[derive(Debug, Clone)]
pub struct ShapeModel {
    /// Mean and modes.
    pub modes: Modes,
    /// Names of the n members of the group.
    pub members: Vec<String>,
    /// Provenance of the model, as JSON.
    pub provenance: String,
}

impl ShapeModel {
    /// Writes the file atomically; replaces an existing file if `overwrite` is set.
    ///
    /// # Errors
    ///
    /// The errors of [`write_arrays`].
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<(), ModelError> {
        let Modes { mean, modes, variances, scores, total_variance } = &self.modes;
        let variances =
            ArrayView2::from_shape((variances.len(), 1), variances).map_err(|error| invalid(path, error))?;
        let total = Array2::from_elem((1, 1), *total_variance);
        // Line breaks in names are replaced, because the file stores one name per line.
        let members: Vec<String> = self.members.iter().map(|name| name.replace(['\n', '\r'], " ")).collect();
        let members = members.join("\n");
        write_arrays(
            path,
            overwrite,
            &[
                ("coefficients", Entry::Matrix(mean.view())),
                ("modes", Entry::Matrix(modes.view())),
                ("variances", Entry::Matrix(variances)),
                ("scores", Entry::Matrix(scores.view())),
                ("total_variance", Entry::Matrix(total.view())),
                ("convention", Entry::Text(CONVENTION)),
                ("members", Entry::Text(&members)),
                ("provenance", Entry::Text(&self.provenance)),
            ],
        )
    }

    /// Reads a shape model file.
    ///
    /// # Errors
    ///
    /// [`ModelError::Open`] if the file can't be opened; [`ModelError::Invalid`] if an array is missing, its shape
    /// doesn't match the others, the convention is unknown, a value isn't finite, or a variance is negative.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let mut arrays = Arrays::open(path)?;
        let convention = arrays.text("convention")?;
        if convention != CONVENTION {
            return Err(invalid(path, format!("convention is {convention:?}, expected {CONVENTION:?}")));
        }
        let mean = arrays.matrix("coefficients")?;
        let (rows, columns) = mean.dim();
        Coefficients::new(mean.clone()).map_err(|error| invalid(path, error))?;
        let (modes, scores) = (arrays.matrix("modes")?, arrays.matrix("scores")?);
        let (variances, total) = (arrays.matrix("variances")?, arrays.matrix("total_variance")?);
        let members: Vec<String> = arrays.text("members")?.lines().map(str::to_owned).collect();
        let m = modes.nrows();
        let entries = (rows - 1).checked_mul(columns);
        for (name, expected, found) in [
            ("modes", entries.map(|entries| (m, entries)), modes.dim()),
            ("variances", Some((m, 1)), variances.dim()),
            ("scores", Some((members.len(), m)), scores.dim()),
            ("total_variance", Some((1, 1)), total.dim()),
        ] {
            if expected != Some(found) {
                return Err(invalid(path, format!("{name}: shape {found:?} doesn't fit the other arrays")));
            }
        }
        let all = [("coefficients", &mean), ("modes", &modes), ("variances", &variances), ("scores", &scores)];
        for (name, values) in all.into_iter().chain([("total_variance", &total)]) {
            if !values.iter().all(|value| value.is_finite()) {
                return Err(invalid(path, format!("{name} contains NaN or infinity")));
            }
        }
        if variances.iter().chain(&total).any(|variance| *variance < 0.0) {
            return Err(invalid(path, "a variance is negative"));
        }
        let total_variance = total[[0, 0]];
        let variances = variances.iter().copied().collect();
        let modes = Modes { mean, modes, variances, scores, total_variance };
        Ok(Self { modes, members, provenance: arrays.text("provenance")? })
    }
}

fn invalid(path: &Path, problem: impl ToString) -> ModelError {
    ModelError::Invalid { path: path.to_owned(), problem: problem.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pca::tests::group;
    use spharm_model::Model;

    #[test]
    fn a_shape_model_returns_and_is_a_model_of_its_mean() {
        let group = group(5);
        let views: Vec<_> = group.iter().map(|member| member.view()).collect();
        let modes = Modes::new(&views, 3).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("group.shape-model.npz");
        let members: Vec<String> = (0..5).map(|i| format!("subject {i}")).collect();
        let file = ShapeModel { modes, members, provenance: "{}".to_owned() };
        file.write(&path, false).unwrap();
        let back = ShapeModel::read(&path).unwrap();
        assert_eq!((&back.modes.modes, &back.modes.scores), (&file.modes.modes, &file.modes.scores));
        assert_eq!((&back.modes.variances, &back.members), (&file.modes.variances, &file.members));
        assert_eq!(Model::read(&path).unwrap().coefficients.values(), &file.modes.mean);
        assert!(file.write(&path, false).is_err());
        // The file has one member name fewer than rows of scores.
        let other = ShapeModel { members: file.members[1..].to_vec(), ..file };
        other.write(&path, true).unwrap();
        assert!(
            matches!(ShapeModel::read(&path), Err(ModelError::Invalid { problem, .. }) if problem.contains("scores"))
        );
    }
}
