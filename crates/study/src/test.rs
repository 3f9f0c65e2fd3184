//! Defines a test of a study and its keys in `[[test]]`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use serde::Deserialize;
use spharm::shape::stats::{MAX_RELABELLINGS, Resampling};

use spharm_analysis::design::{Asked, parts};

/// Keys of `[[test]]`, the required one first.
pub(super) const KEYS: [&str; 20] = [
    "name",
    "effect",
    "mean",
    "side",
    "levels",
    "contrast",
    "covariates",
    "categorical",
    "signal",
    "mask",
    "annotation",
    "sphere",
    "welch",
    "blocks",
    "whole_blocks",
    "variance_groups",
    "errors",
    "tfce",
    "cluster",
    "permutations",
];

/// Value of the key `side` that requests a test of the differences between the sides.
pub(super) const ASYMMETRY: &str = "asymmetry";

/// Name of the tested quantity for values of a signal.
const VALUE: &str = "value";

#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub(super) struct Test {
    pub(super) name: String,
    pub(super) effect: String,
    /// Whether the mean is tested instead of an effect.
    pub(super) mean: bool,
    /// Name of the side whose rows are tested, or [`ASYMMETRY`] for the differences between the sides.
    pub(super) side: Option<String>,
    pub(super) levels: Vec<String>,
    /// Linear combinations of the design's columns to test instead of the effect's own contrast.
    #[serde(deserialize_with = "one_or_more")]
    pub(super) contrast: Vec<String>,
    pub(super) covariates: Vec<String>,
    /// Names of columns whose numbers are codes of levels.
    pub(super) categorical: Vec<String>,
    /// Name of the quantity tested at each vertex.
    pub(super) signal: Option<String>,
    /// File of the mask of the tested vertices.
    pub(super) mask: Option<PathBuf>,
    /// File of the sphere at whose vertices the test is made; `None` for the default icosphere of `shape test`.
    pub(super) sphere: Option<PathBuf>,
    /// File of named regions of the vertices. The regions of the clusters' peaks are reported.
    pub(super) annotation: Option<PathBuf>,
    pub(super) welch: bool,
    /// Name of the column of exchangeability blocks.
    pub(super) blocks: Option<String>,
    pub(super) whole_blocks: bool,
    /// Name of the column of variance groups.
    pub(super) variance_groups: Option<String>,
    pub(super) errors: Option<String>,
    pub(super) tfce: bool,
    /// Uncorrected p value below which vertices form clusters.
    pub(super) cluster: Option<f64>,
    pub(super) permutations: Option<usize>,
}

impl Test {
    /// Checks the values of the keys.
    pub(super) fn check(&self) -> Result<()> {
        match (self.effect.is_empty(), self.mean) {
            (true, false) => bail!("expected `effect` (the column to test) or mean = true; found neither"),
            (false, true) => bail!("expected `effect` or mean = true, found both"),
            _ => {}
        }
        if self.mean && !(self.levels.is_empty() && self.contrast.is_empty()) {
            bail!("levels and contrast need `effect`, found mean = true");
        }
        if let Some(name) = self.asked().unused() {
            bail!("categorical: {name:?} is neither in the effect nor in the covariates");
        }
        if let Some(count) = self.permutations.filter(|count| *count > MAX_RELABELLINGS) {
            bail!("permutations: expected at most {MAX_RELABELLINGS}, found {count}");
        }
        if let Some(signal) = self.signal.as_deref().filter(|signal| !["normal", "position", VALUE].contains(signal)) {
            bail!("signal: expected \"normal\", \"position\" or \"value\", found {signal:?}");
        }
        if let Some(Err(error)) = self.errors.as_ref().map(|errors| errors.parse::<Resampling>()) {
            bail!("errors: {error}, found {:?}", self.errors.as_deref().unwrap_or_default());
        }
        if let Some(p) = self.cluster.filter(|p| !(*p > 0.0 && *p < 1.0)) {
            bail!("cluster: expected a number above 0 and below 1, found {p}");
        }
        if self.whole_blocks && self.blocks.is_none() {
            bail!("whole_blocks: needs `blocks`, the name of a column of the table; found none");
        }
        if self.welch && self.variance_groups.is_some() {
            bail!("expected welch or variance_groups, found both");
        }
        let relabelled = self.tfce || self.cluster.is_some() || self.blocks.is_some() || self.errors.is_some();
        if self.permutations == Some(0) && relabelled {
            bail!("blocks, errors, tfce and cluster need relabellings; expected permutations = 1 or more, found 0");
        }
        if self.variance_groups.is_some() && self.signal.as_deref() == Some("position") {
            bail!("variance_groups: expected signal = \"normal\", found \"position\"");
        }
        let flips =
            self.errors.as_deref().map_or(self.welch || self.variance_groups.is_some(), |of| of != "exchangeable");
        if flips && self.blocks.is_some() && !self.whole_blocks {
            bail!(
                "blocks: this test flips signs, which needs whole_blocks = true; for a test without sign flips, give \
                 errors = \"exchangeable\""
            );
        }
        if self.welch && self.errors.as_deref().is_some_and(|errors| errors != "symmetric") {
            bail!("errors: expected \"symmetric\" with welch");
        }
        Ok(())
    }

    /// Returns the hypothesis to test on the table.
    pub(super) fn asked(&self) -> Asked<'_> {
        Asked {
            effect: (!self.mean).then_some(self.effect.as_str()),
            levels: &self.levels,
            contrast: &self.contrast,
            covariates: &self.covariates,
            categorical: &self.categorical,
            blocks: self.blocks.as_deref(),
            relative: !self.is_of_values() && !self.is_of_differences(),
        }
    }

    /// Returns whether the values of the subjects' signals are tested.
    pub(super) fn is_of_values(&self) -> bool {
        self.signal.as_deref() == Some(VALUE)
    }

    /// Returns whether the differences between the sides are tested.
    pub(super) fn is_of_differences(&self) -> bool {
        self.side.as_deref() == Some(ASYMMETRY)
    }

    /// Returns the arguments of `shape test` that choose the tested quantity, design, statistics and relabellings.
    pub(super) fn question(&self) -> Vec<String> {
        let flags = [
            ("--mean", self.mean),
            ("--welch", self.welch),
            ("--whole-blocks", self.whole_blocks),
            ("--tfce", self.tfce),
        ];
        let flags = flags.into_iter().filter(|(_, given)| *given).map(|(flag, _)| flag.to_owned());
        let list = |names: &[String]| (!names.is_empty()).then(|| names.join(","));
        let values = [
            ("--effect", (!self.mean).then(|| self.effect.clone())),
            ("--levels", list(&self.levels)),
            ("--covariates", list(&self.covariates)),
            ("--categorical", list(&self.categorical)),
            ("--signal", self.signal.clone()),
            ("--blocks", self.blocks.clone()),
            ("--variance-groups", self.variance_groups.clone()),
            ("--errors", self.errors.clone()),
            ("--cluster", self.cluster.map(|p| p.to_string())),
            ("--permutations", self.permutations.map(|count| count.to_string())),
        ];
        let contrasts = self.contrast.iter().map(|row| ("--contrast", Some(row.clone())));
        let values = values.into_iter().chain(contrasts);
        let values = values.filter_map(|(flag, value)| Some([flag.to_owned(), value?]));
        values.flatten().chain(flags).collect()
    }

    /// Returns the name of the map of p values to draw.
    pub(super) fn map(&self) -> &'static str {
        match (self.permutations, self.tfce) {
            (Some(0), _) => "q",
            (_, true) => "p-tfce",
            (_, false) => "p-fwe",
        }
    }

    /// Returns the names of all columns of the table that the test uses; `is_column` returns whether the table has a
    /// column of this name.
    pub(super) fn columns(&self, is_column: impl Fn(&str) -> bool) -> Vec<&str> {
        let terms = std::iter::once(&self.effect).filter(|_| !self.mean).chain(&self.covariates);
        let columns = terms.flat_map(|term| {
            let parts = parts(term);
            // If no column has the term's name, the term is an interaction, such as `group:age`, and uses the columns
            // `group` and `age`.
            if is_column(term) || parts.len() == 1 { vec![parts[0]] } else { parts[1..].to_vec() }
        });
        columns.chain(self.blocks.iter().chain(&self.variance_groups).map(String::as_str)).collect()
    }
}

/// Reads a string, or a list of strings.
fn one_or_more<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a contrast, such as \"patient - control\", or a list of contrasts")]
    enum Given {
        One(String),
        More(Vec<String>),
    }
    Ok(match Given::deserialize(from)? {
        Given::One(one) => vec![one],
        Given::More(more) => more,
    })
}
