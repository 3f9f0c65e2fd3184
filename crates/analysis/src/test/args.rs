//! Arguments of `shape test`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use spharm::shape::stats::{MAX_RELABELLINGS, Resampling};
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};

use super::super::args::{ReportArgs, Resources};

/// Default number of subdivisions of the icosphere at whose vertices the test is made.
pub const SUBDIVISIONS: u32 = 5;

/// Test groups, covariates and means at every vertex
///
/// Compares two groups of models, --a and --b, or tests an --effect or the --mean of a table of subjects, with
/// --covariates. The surfaces must correspond (after `spharm shape align --group`, or because their spheres are
/// registered), and the rows must be independent subjects. If each subject has two models, use --paired or --minus to
/// test the differences. If the two models are left and right, first mirror the models of one side (`spharm shape
/// rotate --mirror`). If rows depend on each other in other ways, give --blocks.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape test --a @patients.txt --b @controls.txt -o test",
        "spharm shape test --table study.csv --effect group --covariates age,sex -o test",
        "spharm shape test --table subjects.csv --models aligned --effect group -o test",
        "spharm shape test --table study.csv --effect group:age --covariates sex -o test",
        "spharm shape test --table study.csv --effect stage --contrast 'mild - control' --contrast 'severe - control' -o test",
        "spharm shape test --table study.csv --effect age --signal position --permutations 50000 -o test",
        "spharm shape test --a thick/a* --b thick/b* --signal value --surface mean.spharm.npz --welch -o test",
        "spharm shape test --table study.csv --effect group --measures measures.csv:area,volume scores.csv -o test",
        "spharm shape test --a year2/* --b year1/* --paired -o change",
        "spharm shape test --table study.csv --models year2 --minus year1 --mean --covariates age -o change",
        "spharm shape test --table visits.csv --effect dose --covariates subject --blocks subject --tfce -o test",
        "spharm shape test --table study.csv --effect group --covariates age --variance-groups group -o test",
    ],
    &[
        "The output folder gets mean.surf.gii and the maps NAME.shape.gii: statistic, p, q (false-discovery rate), \
         p-fwe (family-wise), p-permutation (by relabelling, uncorrected), effect, margin (of the effect's confidence \
         interval) and size. --tfce adds the maps tfce and p-tfce; --cluster adds the maps cluster (numbers) and \
         p-cluster, and clusters.csv; --measures adds summary.csv. test.csv has all maps, and test.json describes the \
         test.",
        "The table has a column `model` with paths relative to the table, or a column `id` if --models is given. Each \
         variable has a column, of numbers or of levels; --categorical treats numbers as levels.",
    ],
))]
pub(crate) struct Cli {
    /// Models of the first group
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "b", conflicts_with = "table", help_heading = INPUT)]
    pub(super) a: Vec<PathBuf>,
    /// Models of the second group
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "a", help_heading = INPUT)]
    pub(super) b: Vec<PathBuf>,
    /// Treat the models of --a and --b as pairs, in order: test the mean of the differences, a minus b
    ///
    /// A warning is given if the two names of a pair, without the side, belong to different subjects. test.json lists
    /// the pairs.
    #[arg(long, requires = "a", help_heading = INPUT)]
    pub(super) paired: bool,
    /// Table of subjects, CSV or TSV
    #[arg(long, value_name = "FILE", help_heading = INPUT)]
    pub(super) table: Option<PathBuf>,
    /// Column of the table with the models' paths
    #[arg(long, value_name = "COLUMN", default_value = "model", help_heading = INPUT)]
    pub(super) model_column: String,
    /// Folder of the models, whose files are named by the table's column `id`: ID.spharm.npz
    #[arg(long, value_name = "DIR", requires = "table", conflicts_with = "model_column", help_heading = INPUT)]
    pub(super) models: Option<PathBuf>,
    /// Test differences, each model minus the subject's other model: give the column of the table with the other models
    /// or, with --models, the folder of the other models
    #[arg(long, value_name = "COLUMN|DIR", requires = "table", help_heading = INPUT)]
    pub(super) minus: Option<PathBuf>,
    /// Column of the table to test, or the interaction of two columns, such as group:age
    ///
    /// For a column of numbers, the slope is tested. For a column of levels, the difference between the levels is
    /// tested. An interaction of levels and numbers is the difference of the slopes within the levels; an interaction
    /// of two columns of levels is the difference of the differences.
    #[arg(long, value_name = "COLUMN", requires = "table", help_heading = METHOD)]
    pub(super) effect: Option<String>,
    /// Test whether the mean of differences (--minus), or of a signal's values, is zero
    #[arg(long, requires = "table", conflicts_with = "effect", help_heading = METHOD)]
    pub(super) mean: bool,
    /// Order of the effect's levels, which may be numbers: the difference is the first level minus the second [default:
    /// sorted]
    ///
    /// Each level occurs once. For an interaction, give the order of its first column that has levels.
    #[arg(long, value_name = "LEVELS", value_delimiter = ',', requires = "effect", help_heading = METHOD)]
    pub(super) levels: Vec<String>,
    /// Contrast to test instead of the effect's own contrast: a combination of the design's columns, such as "mild -
    /// control"
    ///
    /// If the option is given several times, the test is whether any of the contrasts differs from zero (F test). The
    /// design has these columns: LEVEL for each level of the effect, or LEVEL:NUMBERS or LEVEL:LEVEL for an
    /// interaction; NAME for a column of numbers; NAME LEVEL for each level of a covariate except the first; and a:b
    /// for the product of two columns a and b. test.json lists the columns. Weights are numbers or fractions: "severe -
    /// 1/2 mild - 1/2 control"; spaces separate signs from names. A name that is also a combination of other columns,
    /// such as a level a - b, needs double quotes.
    #[arg(long, value_name = "CONTRAST", requires = "effect", allow_hyphen_values = true, help_heading = METHOD)]
    pub(super) contrast: Vec<String>,
    /// Columns of the table to account for, and their interactions, such as age,sex,age:sex
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', requires = "table", help_heading = METHOD)]
    pub(super) covariates: Vec<String>,
    /// Columns of --effect and --covariates whose numbers are levels, such as codes of sites
    #[arg(long, value_name = "COLUMNS", value_delimiter = ',', requires = "table", help_heading = METHOD)]
    pub(super) categorical: Vec<String>,
    /// File that selects the vertices to test: vertices with nonzero values, or the vertices of a FreeSurfer label
    ///
    /// If the option is given several times, the vertices within all masks are tested. Vertices outside the masks don't
    /// enter the family-wise maximum or the false-discovery rate. In the maps, these vertices have the statistic 0 and
    /// p values of 1. With --sphere fsaverage/surf/lh.sphere.reg, fsaverage/label/lh.cortex.label excludes the medial
    /// wall; FreeSurfer's labels and annotations need their own --sphere. The folder of a group made by `spharm shape
    /// correspond`, or its group.json, excludes the parts that exist only on the template, such as the lids of its
    /// holes.
    #[arg(long, value_name = "FILE", help_heading = INPUT)]
    pub(super) mask: Vec<PathBuf>,
    /// File of named regions, to name the region of each cluster's peak: FreeSurfer's .annot, or GIfTI labels of the
    /// sphere's vertices
    #[arg(long, value_name = "FILE", requires = "sphere", help_heading = INPUT)]
    pub(super) annotation: Option<PathBuf>,
    /// Tables of further measures to test in the same way: all columns of numbers, or the named columns
    ///
    /// Such tables are written by `spharm shape measure -o` and `spharm shape pca --scores`. Their first column has the
    /// models' names. For each measure, the output file summary.csv has the numbers of subjects, means, standard
    /// deviations, effects with confidence intervals, p values, and q and family-wise p values over all measures. With
    /// --paired and --minus, the differences are tested.
    #[arg(long, value_name = "FILE[:COLUMNS]", num_args = 1.., value_parser = source, help_heading = INPUT)]
    pub(super) measures: Vec<Source>,
    /// Quantity at a vertex: displacement along the mean's normal, position, or the value of a signal
    #[arg(long, value_enum, default_value_t = What::Normal, help_heading = METHOD)]
    pub(super) signal: What,
    /// With --signal value, the model of a surface on which the results are shown, such as the group's mean
    ///
    /// --tfce and --cluster use the areas of this surface or, if no surface is given, of the sphere. The surface must
    /// correspond to the signals.
    #[arg(long, value_name = "MODEL", help_heading = INPUT)]
    pub(super) surface: Option<PathBuf>,
    /// Welch's test, for two groups of unequal variance
    #[arg(long, help_heading = METHOD)]
    pub(super) welch: bool,
    /// Column of the table in which equal values mark rows that depend on each other, such as visits of a subject or
    /// members of a family
    ///
    /// These rows form a block, and relabellings stay within blocks. With an effect that varies within blocks and the
    /// blocks as a categorical covariate, the test is a paired or repeated-measures test. The test assumes that the
    /// effect is equal in all blocks. If the effect may differ between blocks, as a rate of growth may, compute one
    /// slope or difference for each block and test these values.
    #[arg(long, value_name = "COLUMN", requires = "table", conflicts_with = "minus", help_heading = METHOD)]
    pub(super) blocks: Option<String>,
    /// Exchange whole blocks of the same size rather than observations within blocks
    ///
    /// Observations of two blocks are matched by the columns of the design that vary within blocks, such as the visit.
    /// If a single column varies and its values differ between blocks, as ages do, observations are matched by rank. If
    /// several columns vary and their values differ between blocks, observations are matched by their order in the
    /// table, and a warning is given.
    #[arg(long, requires = "blocks", help_heading = METHOD)]
    pub(super) whole_blocks: bool,
    /// Column of the table whose levels may differ in variance: the statistic is Aspin and Welch's v, or their G if
    /// several contrasts are tested together
    #[arg(long, value_name = "COLUMN", requires = "table", conflicts_with = "welch", help_heading = METHOD)]
    pub(super) variance_groups: Option<String>,
    /// Assumption about the errors, on which the relabellings rest: exchangeable (subjects are exchanged), symmetric
    /// (signs are flipped) or both [default: exchangeable; symmetric for means, --welch and --variance-groups]
    #[arg(long, value_name = "ERRORS", help_heading = METHOD)]
    pub(super) errors: Option<Resampling>,
    /// Threshold-free cluster enhancement, with family-wise p values
    ///
    /// Extent has the exponent 1 and height the exponent 2, as for surfaces in FSL.
    #[arg(long, help_heading = METHOD)]
    pub(super) tfce: bool,
    /// Find clusters of vertices with uncorrected p below P, and family-wise p values for their areas; 0.001 is usual
    #[arg(long, value_name = "P", value_parser = probability, help_heading = METHOD)]
    pub(super) cluster: Option<f64>,
    /// Number of random relabellings; 0 for none
    ///
    /// If at most 20,000 relabellings are possible, all of them are used instead.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = relabellings, help_heading = METHOD)]
    pub(super) permutations: usize,
    /// Seed of the relabellings
    #[arg(long, value_name = "SEED", default_value_t = 0, help_heading = METHOD)]
    pub(super) seed: u64,
    /// Significance level, for the summary and warnings
    #[arg(long, value_name = "ALPHA", default_value_t = 0.05, help_heading = METHOD)]
    pub(super) level: f64,
    /// Highest degree to use [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    /// Test at the vertices of a sphere mesh
    #[arg(long, value_name = "SPHERE", conflicts_with = "icosphere", help_heading = METHOD)]
    pub(super) sphere: Option<PathBuf>,
    /// Test at the vertices of an icosphere of N subdivisions
    #[arg(long, value_name = "N", default_value_t = SUBDIVISIONS, value_parser = clap::value_parser!(u32).range(0..=9), help_heading = METHOD)]
    pub(super) icosphere: u32,
    /// Output folder
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Format of the maps: GIfTI, or FreeSurfer's .mgh
    #[arg(long, value_enum, value_name = "gii|mgh", hide_possible_values = true, default_value_t = Maps::Gii, help_heading = OUTPUT)]
    pub(super) maps: Maps,
    #[command(flatten)]
    pub(super) report: ReportArgs,
    #[command(flatten)]
    pub(super) resources: Resources,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum What {
    Normal,
    Position,
    Value,
}

/// Format of the maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Maps {
    Gii,
    Mgh,
}

impl Maps {
    const ALL: [Self; 2] = [Self::Gii, Self::Mgh];

    const fn ending(self) -> &'static str {
        match self {
            Self::Gii => "shape.gii",
            Self::Mgh => "mgh",
        }
    }
}

impl Cli {
    /// Returns the path of a map in the output folder, and the paths that the map would have in other formats.
    pub(super) fn map_files(&self, name: &str) -> (PathBuf, impl Iterator<Item = PathBuf>) {
        let path = move |format: Maps| self.file(&format!("{name}.{}", format.ending()));
        (path(self.maps), Maps::ALL.into_iter().filter(move |other| *other != self.maps).map(path))
    }

    /// Returns the path of a file in the output folder.
    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.output.join(name)
    }
}

/// Parses a number of relabellings, at most [`MAX_RELABELLINGS`].
fn relabellings(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count <= MAX_RELABELLINGS => Ok(count),
        _ => Err(format!("expected a whole number from 0 to {MAX_RELABELLINGS}")),
    }
}

/// Parses a probability, above 0 and below 1.
fn probability(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(p) if p > 0.0 && p < 1.0 => Ok(p),
        _ => Err("expected a number above 0 and below 1".to_owned()),
    }
}

/// Path of a table of measures, and the columns to test; if empty, all columns of numbers.
pub(super) type Source = (PathBuf, Vec<String>);

/// Parses `FILE` or `FILE:COLUMN,...`.
fn source(text: &str) -> Result<Source, std::convert::Infallible> {
    let (file, columns) = match text.rsplit_once(':') {
        Some((file, columns)) if !file.is_empty() && !Path::new(text).exists() => (file, columns),
        _ => (text, ""),
    };
    let columns: Vec<String> =
        columns.split(',').map(str::trim).filter(|name| !name.is_empty()).map(str::to_owned).collect();
    Ok((file.into(), columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_name_files_and_columns() {
        assert_eq!(source("a/b.csv"), Ok(("a/b.csv".into(), Vec::new())));
        let columns = vec!["area".to_owned(), "volume".to_owned()];
        assert_eq!(source("a/b.csv:area, volume"), Ok(("a/b.csv".into(), columns)));
    }
}
