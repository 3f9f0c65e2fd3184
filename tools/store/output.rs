//! Output of `store`: JSON, or tables.

use serde::Serialize;
use spharm_cli::size::Size;
use spharm_store::catalog::SchemeSummary;
use spharm_store::factor::FactorFile;
use spharm_store::{Codec, DegreeFile, Scalar, SchemeKey, StoreError};

/// A row of `list`: the files of one sampling scheme.
#[derive(Debug, Serialize)]
pub(super) struct SchemeRow {
    key: String,
    directions: Option<usize>,
    dtype: Option<&'static str>,
    codec: Option<&'static str>,
    degrees: usize,
    /// Highest degree L for which the store has all degrees from 0 to L.
    complete_to: Option<usize>,
    /// Number of factors that are stored next to the basis.
    factors: usize,
    damaged: usize,
    /// Number of files in a newer format version.
    newer: usize,
    bytes: u64,
}

/// The basis file of one degree, as listed by `show`.
#[derive(Debug, Serialize)]
pub(super) struct DegreeRow {
    key: String,
    degree: usize,
    directions: Option<usize>,
    columns: usize,
    dtype: Option<&'static str>,
    codec: Option<&'static str>,
    chunk_rows: Option<usize>,
    chunks: Option<usize>,
    bytes: Option<u64>,
    problem: Option<String>,
}

/// The file of a Cholesky factor, as listed by `show`.
#[derive(Debug, Serialize)]
pub(super) struct FactorRow {
    key: String,
    factor: String,
    max_degree: Option<usize>,
    columns: Option<usize>,
    dtype: Option<&'static str>,
    weights: Option<String>,
    smoothness: Option<f64>,
    norm: Option<f64>,
    reciprocal_condition: Option<f64>,
    tile: Option<usize>,
    tiles: Option<usize>,
    bytes: Option<u64>,
    problem: Option<String>,
}

/// A row of `show`: a basis file or a factor file.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Row {
    Degree(DegreeRow),
    Factor(FactorRow),
}

impl From<SchemeSummary> for SchemeRow {
    fn from(summary: SchemeSummary) -> Self {
        Self {
            key: summary.key.to_string(),
            directions: summary.rows,
            dtype: summary.scalar.map(Scalar::name),
            codec: summary.codec.map(Codec::name),
            degrees: summary.degrees,
            complete_to: summary.complete_to,
            factors: summary.factors,
            damaged: summary.damaged - summary.newer,
            newer: summary.newer,
            bytes: summary.bytes,
        }
    }
}

/// Returns the rows of the printed table of schemes.
pub(super) fn scheme_lines(rows: Vec<SchemeRow>) -> Vec<Vec<String>> {
    let mut lines =
        vec![["scheme", "directions", "dtype", "codec", "degrees", "factors", "size"].map(str::to_owned).to_vec()];
    for row in rows {
        let extent = match row.complete_to {
            Some(degree) if degree + 1 == row.degrees => format!("0 to {degree}"),
            Some(degree) => format!("0 to {degree}, {} in total", row.degrees),
            None if row.degrees == 0 => "none".to_owned(),
            None => format!("{} without degree 0", row.degrees),
        };
        let unreadable = |count: usize, what: &str| if count > 0 { format!(", {count} {what}") } else { String::new() };
        let damage = unreadable(row.damaged, "damaged") + &unreadable(row.newer, "of a newer format version");
        lines.push(vec![
            row.key,
            row.directions.map_or("-".to_owned(), |n| n.to_string()),
            row.dtype.unwrap_or("-").to_owned(),
            row.codec.unwrap_or("-").to_owned(),
            format!("{extent}{damage}"),
            row.factors.to_string(),
            Size(row.bytes as usize).to_string(),
        ]);
    }
    lines
}

impl DegreeRow {
    /// Creates the row of a basis file, or of a file that couldn't be read.
    pub(super) fn new(key: SchemeKey, degree: usize, file: &Result<DegreeFile, StoreError>) -> Self {
        let header = file.as_ref().ok().map(DegreeFile::header);
        Self {
            key: key.to_string(),
            degree,
            directions: header.map(|h| h.rows),
            columns: 2 * degree + 1,
            dtype: header.map(|h| h.scalar.name()),
            codec: header.map(|h| h.codec.name()),
            chunk_rows: header.map(|h| h.chunk_rows),
            chunks: header.map(|h| h.chunk_count()),
            bytes: file.as_ref().ok().map(DegreeFile::file_len),
            problem: file.as_ref().err().map(ToString::to_string),
        }
    }
}

impl FactorRow {
    /// Creates the row of a factor file, or of a file that couldn't be read.
    pub(super) fn new(key: SchemeKey, name: String, file: &Result<FactorFile, StoreError>) -> Self {
        let header = file.as_ref().ok().map(FactorFile::header);
        Self {
            key: key.to_string(),
            factor: name,
            max_degree: header.map(|h| h.spec.max_degree),
            columns: header.map(|h| h.grid.size()),
            dtype: header.map(|h| h.scalar.name()),
            weights: header.map(|h| h.spec.weights.to_string()),
            smoothness: header.map(|h| h.spec.smoothness),
            norm: header.map(|h| h.condition.norm),
            reciprocal_condition: header.map(|h| h.condition.reciprocal),
            tile: header.map(|h| h.grid.tile()),
            tiles: header.map(|h| h.grid.count()),
            bytes: file.as_ref().ok().map(FactorFile::file_len),
            problem: file.as_ref().err().map(ToString::to_string),
        }
    }
}

/// Returns a warning if a basis lacks degrees below its highest degree. `degrees` are in ascending order.
pub(super) fn missing_degrees(key: SchemeKey, degrees: &[usize]) -> Option<String> {
    let (mut there, mut missing): (Vec<[usize; 2]>, Vec<[usize; 2]>) = (Vec::new(), Vec::new());
    for &degree in degrees {
        let next = there.last().map_or(0, |[_, last]| last + 1);
        if degree > next {
            missing.push([next, degree - 1]);
        }
        match there.last_mut() {
            Some([_, last]) if degree == next => *last = degree,
            _ => there.push([degree, degree]),
        }
    }
    let (noun, verb) = match missing[..] {
        [] => return None,
        [[first, last]] if first == last => ("degree", "is"),
        _ => ("degrees", "are"),
    };
    let (name, there, missing) = (key.to_string(), ranges(&there), ranges(&missing));
    Some(format!(
        "scheme {}: {noun} {missing} {verb} missing (present: {there}); run spharm basis-build again",
        &name[..12]
    ))
}

/// Returns ranges of numbers as text: `0 to 8, 10 and 12 to 20`.
fn ranges(ranges: &[[usize; 2]]) -> String {
    let text =
        |[first, last]: &[usize; 2]| if first == last { first.to_string() } else { format!("{first} to {last}") };
    let texts: Vec<String> = ranges.iter().map(text).collect();
    match texts.split_last() {
        Some((last, others @ [_, ..])) => format!("{} and {last}", others.join(", ")),
        _ => texts.concat(),
    }
}

fn size_or_problem(bytes: Option<u64>, problem: Option<String>) -> String {
    bytes.map_or(problem.unwrap_or_default(), |bytes| Size(bytes as usize).to_string())
}

fn number(value: Option<usize>) -> String {
    value.map_or("-".to_owned(), |value| value.to_string())
}

/// Returns the rows of the printed table of basis files.
pub(super) fn degree_lines(rows: Vec<DegreeRow>) -> Vec<Vec<String>> {
    let head = ["scheme", "degree", "columns", "dtype", "codec", "chunks", "rows per chunk", "size"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    for row in rows {
        lines.push(vec![
            row.key[..12].to_owned(),
            row.degree.to_string(),
            row.columns.to_string(),
            row.dtype.unwrap_or("-").to_owned(),
            row.codec.unwrap_or("-").to_owned(),
            number(row.chunks),
            number(row.chunk_rows),
            size_or_problem(row.bytes, row.problem),
        ]);
    }
    lines
}

/// Returns the rows of the printed table of factor files.
pub(super) fn factor_lines(rows: Vec<FactorRow>) -> Vec<Vec<String>> {
    let head = ["scheme", "factor", "columns", "weights", "smoothness", "condition", "tiles", "size"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    for row in rows {
        lines.push(vec![
            row.key[..12].to_owned(),
            row.factor,
            number(row.columns),
            row.weights.unwrap_or("-".to_owned()),
            row.smoothness.map_or("-".to_owned(), |smoothness| smoothness.to_string()),
            row.reciprocal_condition.map_or("-".to_owned(), |reciprocal| format!("{:.1e}", 1.0 / reciprocal)),
            number(row.tiles),
            size_or_problem(row.bytes, row.problem),
        ]);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_degrees_are_named() {
        let key = SchemeKey::of(&spharm_surface::Sphere::icosphere(0).directions, Scalar::F64);
        let missing = |degrees: &[usize]| missing_degrees(key, degrees);
        assert_eq!(missing(&[]), None);
        assert_eq!(missing(&[0, 1, 2]), None);
        let found = missing(&[0, 1, 2, 4, 5]).unwrap();
        assert!(found.contains(": degree 3 is missing (present: 0 to 2 and 4 to 5); run "), "{found}");
        let found = missing(&[1, 2, 3, 5, 9]).unwrap();
        assert!(found.contains(": degrees 0, 4 and 6 to 8 are missing (present: 1 to 3, 5 and 9); run "), "{found}");
    }
}
