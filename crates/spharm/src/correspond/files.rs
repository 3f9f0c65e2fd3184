//! Defines the files in the folder of a group of corresponding surfaces.
//!
//! | file | contents |
//! |---|---|
//! | `group.json` | version, names of the members, masked directions, spread, template, refinement, warnings, seconds |
//! | `mean.spharm.npz` | the mean over the group's sphere |
//! | `NAME.spharm.npz` | a member's model, in the group's frame and over its sphere |
//! | `places/NAME.npz` | `places` (n, 3): corresponding points in the group's frame; `reached` (n, 1): 1 if the member has a counterpart there, else 0 |
//! | `members/NAME.json` | the member's source file and order of axes, its similarity to the group's frame, report on its registration |
//!
//! `group.json` is written after all other files of the group, and `members/NAME.json` after the member's other files.
//! If one of these files exists, the files written before it are complete. Members can also be added to a finished
//! group one by one, possibly on several machines. The `group.json` of a folder for added members lists no members: the
//! folder's members are those with a file in `members`.

mod read;
#[cfg(test)]
mod tests;
mod write;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use spharm_model::FileRecord;
use spharm_surface::Similarity;

use super::report::MemberReport;
use crate::Error;

/// Version of the folder's format.
const VERSION: u32 = 1;

/// Contents of `group.json`: data shared by all members.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Shared {
    version: u32,
    tool: String,
    versions: serde_json::Value,
    members: Option<Vec<String>>,
    max_degree: usize,
    directions: usize,
    /// Indices of the sphere's directions that have no counterpart on the members.
    masked: Vec<usize>,
    spread: f64,
    #[serde(default)]
    template: Option<String>,
    #[serde(default)]
    changes: Vec<String>,
    #[serde(default)]
    refinement: Vec<serde_json::Value>,
    #[serde(default)]
    seconds: Vec<(String, f64)>,
}

/// Contents of `members/NAME.json`: data of one member.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Member {
    version: u32,
    name: String,
    input: Option<FileRecord>,
    /// Whether the similarity `to_group` includes a reflection.
    #[serde(default)]
    mirrored: bool,
    /// Whether the surface was mirrored before it was aligned; `to_group` includes this reflection. Files of earlier
    /// versions lack this field and store its value in `mirrored`.
    #[serde(default)]
    mirrored_first: Option<bool>,
    /// Order of the axes in which the member's volume was read.
    #[serde(default)]
    axes: Option<String>,
    to_group: Similarity,
    #[serde(with = "Registered")]
    registration: MemberReport,
    #[serde(default)]
    warnings: Vec<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "MemberReport")]
struct Registered {
    pose_distance: f64,
    cover_rms: f64,
    cover_most: f64,
    cover_farthest: f64,
    unreached: f64,
    without_counterpart: usize,
    turned: usize,
    model_rms: f64,
    #[serde(default)]
    area: f64,
    #[serde(default)]
    volume: f64,
}

/// The origin of a member, as recorded in its files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MemberOrigin {
    /// Name of the member, used in the names of its files.
    pub name: String,
    /// File of the member's surface.
    pub input: Option<FileRecord>,
    /// Whether the surface was mirrored (x to -x) before it was aligned.
    pub mirrored: bool,
    /// Order of the axes in which a volume was read; `None` for other files, and for records without this field.
    pub axes: Option<String>,
    /// Reasons to check the member.
    pub warnings: Vec<String>,
}

/// A group's folder, opened for reading.
#[derive(Debug, Clone)]
pub struct GroupFiles {
    folder: PathBuf,
    shared: Shared,
    names: Vec<String>,
}

fn model_path(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.spharm.npz"))
}

fn places_path(folder: &Path, name: &str) -> PathBuf {
    folder.join("places").join(format!("{name}.npz"))
}

fn member_path(folder: &Path, name: &str) -> PathBuf {
    folder.join("members").join(format!("{name}.json"))
}

/// Checks that each member has a name, and that names are valid as file names, unique, and distinct from the names of
/// the group's other files.
fn check_names(names: &[&str], count: usize) -> Result<(), Error> {
    let refused = |expected, found: String| Err(Error::Setting { what: "a group's folder", expected, found });
    if names.len() != count {
        return refused("a name for each member", format!("{} names for {count} members", names.len()));
    }
    let bad =
        |name: &&&str| name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', '\0']) || **name == "mean";
    if let Some(name) = names.iter().find(bad) {
        return refused("member names that are valid file names, other than `mean`", format!("{name:?}"));
    }
    let mut sorted = names.to_vec();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => refused("a different name for each member", format!("{:?} twice", pair[0])),
        None => Ok(()),
    }
}

fn refused(path: &Path, expected: String, found: impl ToString) -> Error {
    Error::GroupFile { path: path.to_owned(), expected, found: found.to_string() }
}

fn io(path: &Path, action: &'static str, cause: std::io::Error) -> Error {
    spharm_surface::SurfaceError::Io { path: path.to_owned(), action, cause }.into()
}
