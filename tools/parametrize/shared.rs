//! What `--resample-to` names.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::io::read_mesh;

/// A sphere that many surfaces share.
#[derive(Clone, Debug)]
pub(crate) enum Shared {
    /// `icosphere:N`.
    Icosphere(u32),
    /// A file.
    File(PathBuf),
}

impl FromStr for Shared {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(number) = text.strip_prefix("icosphere:") else { return Ok(Self::File(text.into())) };
        match number.parse() {
            Ok(subdivisions @ 0..=10) => Ok(Self::Icosphere(subdivisions)),
            _ => Err(format!("expected icosphere:0 to icosphere:10, found {text}")),
        }
    }
}

impl Shared {
    /// The sphere's mesh.
    pub(crate) fn sphere(&self) -> Result<Mesh> {
        match self {
            Self::Icosphere(subdivisions) => Ok(icosphere(*subdivisions)),
            Self::File(path) => Ok(read_mesh(path)?),
        }
    }
}
