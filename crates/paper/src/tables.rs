//! Formats the measurements as CSV with full precision, and tables as Markdown.

use crate::bench::Measured;
use crate::experiments::{Basis, Between, Nlsf, Pass, Results, Sirf};
use crate::families::Family;
use crate::published::Quality;

/// Formats an optional value; `None` becomes an empty cell.
fn cell<T: ToString>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

fn csv(header: &str, rows: impl Iterator<Item = Vec<String>>) -> String {
    // Cells needn't be quoted, because they are numbers and names without commas or quotes.
    std::iter::once(header.to_owned()).chain(rows.map(|row| row.join(","))).map(|line| line + "\n").collect()
}

/// Formats a small number in exponent notation with full precision.
fn digits(value: f64) -> String {
    format!("{value:e}")
}

fn fitted(measured: Measured) -> [String; 3] {
    [digits(measured.quality.msd), digits(measured.quality.xsd), measured.seconds.to_string()]
}

fn against(found: Quality, reference: Option<Quality>) -> [String; 3] {
    let digits = |value: Option<f64>| cell(value.map(digits));
    [digits(reference.map(|r| r.msd)), digits(reference.map(|r| r.xsd)), digits(reference.map(|r| found.off(r)))]
}

const REFERENCE: &str = "reference_msd,reference_xsd,relative_difference";

/// Returns the name and text of a CSV file for each experiment.
pub(crate) fn all_csv(results: &Results) -> Vec<(&'static str, String)> {
    let sirf = |row: &Sirf| {
        let mut cells = vec![row.surface.clone(), row.vertices.to_string(), row.max_degree.to_string()];
        cells.extend(fitted(row.measured));
        cells.extend(against(row.measured.quality, row.reference));
        cells
    };
    let pass = |row: &Pass| {
        let counts = [row.vertices, row.max_degree, row.granularity, row.pass].map(|count| count.to_string());
        let mut cells: Vec<String> = std::iter::once(row.surface.clone()).chain(counts).collect();
        cells.extend(fitted(row.measured));
        cells.extend(against(row.measured.quality, row.reference));
        cells
    };
    let nlsf = |row: &Nlsf| {
        let mut cells = vec![row.vertices.to_string(), row.memory.to_string(), cell(row.max_degree)];
        cells.extend([row.capped.to_string(), cell(row.planned), cell(row.fitted.map(|(degree, _)| degree))]);
        cells.extend(row.fitted.map_or_else(Default::default, |(_, measured)| fitted(measured)));
        cells
    };
    let basis = |row: &Basis| {
        let counts = [row.vertices, row.max_degree].map(|count| count.to_string());
        let mut cells: Vec<String> = std::iter::once(row.along.to_owned()).chain(counts).collect();
        cells.extend([row.seconds.to_string(), row.bytes.to_string()]);
        cells
    };
    let between = |row: &Between| {
        let counts = [row.vertices, row.max_degree, row.granularity, row.pass].map(|count| count.to_string());
        let mut cells: Vec<String> = std::iter::once(row.surface.clone()).chain(counts).collect();
        let d = &row.distance;
        cells.extend([d.mean, d.rms, d.percentile95, d.hausdorff, d.bound].map(|x| digits(x / d.scale)));
        cells.extend([d.mean, d.hausdorff].map(digits));
        cells
    };
    let family = |row: &Family| {
        let counts = [row.vertices, row.max_degree].map(|count| count.to_string());
        let mut cells: Vec<String> = std::iter::once(row.surface.clone()).chain(counts).collect();
        cells.extend(fitted(row.least_squares));
        cells.push(row.converged.to_string());
        cells.extend(fitted(row.quadrature));
        cells
    };
    let fits = "msd,xsd,seconds";
    vec![
        ("figure3.csv", csv("along,vertices,max_degree,seconds,bytes", results.basis.iter().map(basis))),
        ("figure5.csv", csv(&format!("surface,vertices,max_degree,{fits},{REFERENCE}"), results.sirf.iter().map(sirf))),
        (
            "figures6-7.csv",
            csv(
                &format!("surface,vertices,max_degree,granularity,pass,{fits},{REFERENCE}"),
                results.grid.iter().map(pass),
            ),
        ),
        (
            "least-squares-quadrature.csv",
            csv(
                "surface,vertices,max_degree,lsq_msd,lsq_xsd,lsq_seconds,lsq_converged,quadrature_msd,quadrature_xsd,\
                 quadrature_seconds",
                results.families.iter().map(family),
            ),
        ),
        (
            "surface-distance.csv",
            csv(
                "surface,vertices,max_degree,granularity,pass,mean,rms,percentile95,hausdorff,bound,mean_raw,\
                 hausdorff_raw",
                results.between.iter().map(between),
            ),
        ),
        (
            "table1.csv",
            csv(
                &format!("vertices,memory,max_degree,basis_ends_there,planned,fitted_degree,{fits}"),
                results.nlsf.iter().map(nlsf),
            ),
        ),
    ]
}

/// Formats a Markdown table with padded columns, so that it is also readable in a terminal. The first row is the
/// header. The first column is left-aligned, and the others are right-aligned.
pub(crate) fn markdown(rows: &[Vec<String>]) -> String {
    let columns = rows.first().map_or(0, Vec::len);
    let length = |row: &Vec<String>, column: usize| row.get(column).map_or(0, |cell| cell.chars().count());
    let widths: Vec<usize> =
        (0..columns).map(|c| rows.iter().map(|row| length(row, c)).max().unwrap_or(0).max(3)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate();
        let padded = cells.map(|(c, (cell, &width))| match c {
            0 => format!(" {cell:<width$} |"),
            _ => format!(" {cell:>width$} |"),
        });
        format!("|{}\n", padded.collect::<String>())
    };
    let rule = widths.iter().enumerate().map(|(c, &width)| match c {
        0 => format!(" {} |", "-".repeat(width)),
        _ => format!(" {}: |", "-".repeat(width - 1)),
    });
    let rule = format!("|{}\n", rule.collect::<String>());
    let mut lines = rows.iter().map(line);
    let header = lines.next().unwrap_or_default();
    header + &rule + &lines.collect::<String>()
}
