//! Makes the file names of a surface's derivatives, following BIDS.

use std::path::{Path, PathBuf};

use super::discover::Found;

impl Found {
    /// Returns the text with which all file names of a subject begin: `sub-01`, or `sub-01_ses-a` with a session.
    fn stem(&self) -> String {
        match &self.session {
            Some(session) => format!("sub-{}_ses-{session}", self.subject),
            None => format!("sub-{}", self.subject),
        }
    }

    /// Returns the surface's id in status files.
    pub(super) fn id(&self) -> String {
        format!("{}_hemi-{}_{}", self.stem(), self.hemi.label(), self.surface.name())
    }

    /// Returns the path of a file of the surface, relative to the derivative dataset:
    /// `sub-01/anat/sub-01_hemi-L_MIDDLE_ENDING`.
    fn file(&self, middle: &str, ending: &str) -> PathBuf {
        let mut folder = PathBuf::from(format!("sub-{}", self.subject));
        folder.extend(self.session.as_ref().map(|session| format!("ses-{session}")));
        folder.join("anat").join(format!("{}_hemi-{}_{middle}_{ending}", self.stem(), self.hemi.label()))
    }

    pub(super) fn model(&self) -> PathBuf {
        self.file("desc-spharm", &format!("{}.npz", self.surface.name()))
    }

    pub(super) fn sidecar(&self) -> PathBuf {
        self.file("desc-spharm", &format!("{}.json", self.surface.name()))
    }

    /// Returns the path of the table with the model's power in each degree. The surface's name is part of the BIDS
    /// entity `desc`, because otherwise the tables of all surfaces of a hemisphere would have the same name.
    pub(super) fn spectrum(&self) -> PathBuf {
        self.file(&format!("desc-spharm{}", self.surface.name()), "spectrum.tsv")
    }

    /// Returns the path of the file with the model evaluated on an icosphere that has these numbers of subdivisions and
    /// vertices.
    pub(super) fn evaluated(&self, subdivisions: u32, vertices: usize) -> PathBuf {
        let density = density(vertices);
        let middle = format!("space-icosphere{subdivisions}_den-{density}_desc-spharm");
        self.file(&middle, &format!("{}.surf.gii", self.surface.name()))
    }

    /// Returns the paths of the existing files with the model evaluated on an icosphere.
    pub(super) fn evaluations(&self, output: &Path) -> Vec<PathBuf> {
        let start = format!("{}_hemi-{}_space-icosphere", self.stem(), self.hemi.label());
        let ending = format!("_desc-spharm_{}.surf.gii", self.surface.name());
        let folder = output.join(self.model()).parent().map(Path::to_owned).unwrap_or_default();
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let is_one = |path: &PathBuf| {
            path.file_name()
                .map(|name| name.to_string_lossy().into_owned())
                .is_some_and(|name| name.starts_with(&start) && name.ends_with(&ending))
        };
        let mut found: Vec<PathBuf> = entries.filter(is_one).collect();
        found.sort_unstable();
        found
    }

    pub(super) fn error(&self) -> PathBuf {
        self.file("desc-spharmerror", &format!("{}.shape.gii", self.surface.name()))
    }
}

/// Formats a number of vertices as TemplateFlow does: `41k` for 40,962.
fn density(vertices: usize) -> String {
    if vertices < 1000 { vertices.to_string() } else { format!("{}k", (vertices + 500) / 1000) }
}

#[cfg(test)]
mod tests {
    use super::super::args::{Hemi, Surface};
    use super::*;

    #[test]
    fn files_are_named_as_bids_has_it() {
        let mut found = Found {
            subject: "01".to_owned(),
            session: None,
            hemi: Hemi::L,
            surface: Surface::Pial,
            mesh: PathBuf::new(),
            sphere: PathBuf::new(),
        };
        let text = |path: PathBuf| path.to_str().unwrap().to_owned();
        assert_eq!(text(found.model()), "sub-01/anat/sub-01_hemi-L_desc-spharm_pial.npz");
        let evaluated = "sub-01/anat/sub-01_hemi-L_space-icosphere6_den-41k_desc-spharm_pial.surf.gii";
        assert_eq!(text(found.evaluated(6, 40_962)), evaluated);
        assert_eq!(text(found.spectrum()), "sub-01/anat/sub-01_hemi-L_desc-spharmpial_spectrum.tsv");
        found.session = Some("a".to_owned());
        assert_eq!(text(found.error()), "sub-01/ses-a/anat/sub-01_ses-a_hemi-L_desc-spharmerror_pial.shape.gii");
        assert_eq!(found.id(), "sub-01_ses-a_hemi-L_pial");
    }
}
