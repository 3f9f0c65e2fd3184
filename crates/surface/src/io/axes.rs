//! Reads and writes the statement `SPACE=LPS` or `SPACE=RAS`. 3D Slicer writes this statement in the title or in a
//! comment of a mesh's file to specify the axes of the positions. Positions aren't converted here. Slicer assumes LPS
//! for files without the statement.

use super::landmarks::Frame;
use crate::mesh::{Mesh, Meta};

/// Name of the statement, in files and in [`Meta::file_metadata`].
const NAME: &str = "SPACE";
/// GIfTI's names of spaces whose axes are RAS by NIfTI's definition.
const RAS_SPACES: [&str; 4] =
    ["NIFTI_XFORM_SCANNER_ANAT", "NIFTI_XFORM_ALIGNED_ANAT", "NIFTI_XFORM_TALAIRACH", "NIFTI_XFORM_MNI_152"];

/// Returns the axes that a title or a comment states.
pub(super) fn stated(text: &[u8]) -> Option<Frame> {
    let has = |frame: &Frame| {
        let statement = statement(*frame);
        text.windows(statement.len()).any(|window| window == statement.as_bytes())
    };
    [Frame::Ras, Frame::Lps].into_iter().find(has)
}

/// Adds the axes that a mesh's file states, if any, to the metadata of the mesh, and returns the mesh.
pub(super) fn noted(mut mesh: Mesh, frame: Option<Frame>) -> Mesh {
    mesh.meta.file_metadata.extend(frame.map(|frame| (NAME.to_owned(), frame.name().to_owned())));
    mesh
}

impl Meta {
    /// Returns the axes of a mesh, if its file states them, or if they follow from the coordinate space named in its
    /// GIfTI metadata.
    #[must_use]
    pub fn axes(&self) -> Option<Frame> {
        let noted = self.file_metadata.iter().find(|(name, _)| name == NAME).and_then(|(_, axes)| Frame::named(axes));
        let by_space = || {
            let system = self.coordinate_system.as_ref()?;
            RAS_SPACES.contains(&system.data_space.as_str()).then_some(Frame::Ras)
        };
        noted.or_else(by_space)
    }

    /// Removes the statement about the axes, for example because it no longer holds after a rotation.
    pub(crate) fn forget_axes(&mut self) {
        self.file_metadata.retain(|(name, _)| name != NAME);
    }
}

/// Returns the statement about a mesh's axes, if the axes are known.
pub(super) fn known(meta: &Meta) -> Option<String> {
    meta.axes().map(statement)
}

/// Returns a title, followed by the statement about a mesh's axes if they are known.
pub(super) fn titled(title: &str, meta: &Meta) -> String {
    known(meta).map_or_else(|| title.to_owned(), |statement| format!("{title}. {statement}"))
}

fn statement(frame: Frame) -> String {
    format!("{NAME}={}", frame.name())
}
