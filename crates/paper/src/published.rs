//! Provides results for comparison with the measurements: the paper's results, and expected results from a reference
//! file in the data folder.
//!
//! L. Shen and M. K. Chung, "Large-scale modeling of parametric surfaces using spherical harmonics", 3DPVT 2006.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// The paper's surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Cortex,
    Head,
    Hippocampus,
}

/// A fit to degree 100 whose result the paper reports.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Published {
    pub(crate) kind: Kind,
    pub(crate) name: &'static str,
    pub(crate) vertices: usize,
    pub(crate) passes: usize,
    pub(crate) granularity: usize,
    pub(crate) seconds: f64,
    pub(crate) msd: f64,
    pub(crate) xsd: f64,
}

const fn fit(kind: Kind, name: &'static str, vertices: usize, p: usize, g: usize, measured: [f64; 3]) -> Published {
    let [seconds, msd, xsd] = measured;
    Published { kind, name, vertices, passes: p, granularity: g, seconds, msd, xsd }
}

/// The fits whose times the paper reports.
pub(crate) const PUBLISHED: [Published; 3] = [
    fit(Kind::Cortex, "cortex", 40_962, 1, 100, [555.0, 4.57e-5, 6.54e-4]),
    fit(Kind::Head, "head", 27_618, 1, 400, [568.0, 1.16e-5, 2.46e-4]),
    fit(Kind::Hippocampus, "hippocampus", 10_082, 2, 1, [210.0, 2.33e-5, 1.63e-3]),
];

/// Approximate degree that a full least-squares fit (NLSF) of 40,962 vertices reached in 2006.
pub(crate) const NLSF_DEGREE: usize = 24;

/// Accuracy of a fit: mean (msd) and maximum (xsd) of the squared distances, relative to a bounding box of volume 1.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub(crate) struct Quality {
    pub(crate) msd: f64,
    pub(crate) xsd: f64,
}

#[derive(Debug, Deserialize)]
struct OfSurface {
    results: BTreeMap<String, Quality>,
}

/// Expected results of fits, read from `reference.json`: for each surface and method, msd and xsd.
#[derive(Debug, Default, Deserialize)]
pub(crate) struct Reference(BTreeMap<String, OfSurface>);

/// Maximum size of a reference file in bytes.
const LARGEST: u64 = 1 << 24;

impl Reference {
    /// Reads `reference.json` in a data folder. If the file doesn't exist, the reference is empty.
    pub(crate) fn beside(data: &Path) -> Result<Self> {
        let path = data.join("reference.json");
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = spharm_files::read_text(&path, LARGEST)
            .with_context(|| format!("{}: cannot read the file", path.display()))?;
        serde_json::from_str(&text).with_context(|| {
            format!("{}: not a reference file in the format that the README describes", path.display())
        })
    }

    /// Returns the expected result of IRF after `pass` passes; `None` if unknown.
    pub(crate) fn irf(&self, surface: &str, pass: usize, granularity: usize, max_degree: usize) -> Option<Quality> {
        self.get(surface, &format!("irf p={pass} g={granularity} L={max_degree}"))
    }

    /// Returns the expected result of SIRF; `None` if unknown.
    pub(crate) fn sirf(&self, surface: &str, max_degree: usize) -> Option<Quality> {
        self.get(surface, &format!("sirf L={max_degree}"))
    }

    fn get(&self, surface: &str, fit: &str) -> Option<Quality> {
        self.0.get(surface)?.results.get(fit).copied()
    }
}

impl Quality {
    /// Returns the larger of the relative deviations of msd and xsd from the expected values.
    pub(crate) fn off(self, reference: Self) -> f64 {
        let off = |found: f64, expected: f64| ((found - expected) / expected).abs();
        off(self.msd, reference.msd).max(off(self.xsd, reference.xsd))
    }
}
