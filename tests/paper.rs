//! Runs the paper's experiments, and checks that all results are measured, written and plausible.

use std::path::Path;

use crate::common::{fail, succeed, tool};

/// Returns the rows of a CSV file, each cell with its column's name.
fn rows(path: &Path) -> Vec<Vec<(String, String)>> {
    let text = std::fs::read_to_string(path).expect("the result is there");
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    lines
        .map(|cells| {
            assert_eq!(cells.len(), header.len(), "{}", path.display());
            header.iter().cloned().zip(cells).collect()
        })
        .collect()
}

fn text<'r>(row: &'r [(String, String)], column: &str) -> &'r str {
    &row.iter().find(|(name, _)| name == column).expect("the column is there").1
}

fn number(row: &[(String, String)], column: &str) -> f64 {
    text(row, column).parse().expect("a number")
}

#[test]
fn a_quick_run_measures_every_experiment() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("results");
    let printed = succeed(tool("paper").arg("--quick").arg("--output").arg(&output));
    assert_eq!(printed, std::fs::read_to_string(output.join("paper.md")).expect("the summary is there"));

    // More passes or higher degrees never make a fit worse, apart from rounding.
    let not_above = |later: f64, earlier: f64| later <= earlier * (1.0 + 1e-9);

    let grid = rows(&output.join("figures6-7.csv"));
    let (granularities, passes) = ([1.0, 50.0, 100.0, 200.0], 8);
    assert_eq!(grid.len(), granularities.len() * passes);
    for (fit, granularity) in grid.chunks(passes).zip(granularities) {
        for (row, pass) in fit.iter().zip(1..) {
            assert_eq!((number(row, "granularity"), number(row, "pass")), (granularity, f64::from(pass)));
            assert!(0.0 < number(row, "msd") && number(row, "msd") < number(row, "xsd"));
            assert_eq!(text(row, "reference_msd"), "");
        }
        for pair in fit.windows(2) {
            assert!(not_above(number(&pair[1], "msd"), number(&pair[0], "msd")));
            assert!(number(&pair[1], "seconds") > number(&pair[0], "seconds"));
        }
        assert!(number(&fit[passes - 1], "msd") < number(&fit[0], "msd"));
        // IRF with every granularity converges to the full least squares.
        let (found, expected) = (number(&fit[passes - 1], "msd"), number(&grid[grid.len() - 1], "msd"));
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} and {expected}");
    }

    // Distances between surface and model are also small between the vertices.
    let between = rows(&output.join("surface-distance.csv"));
    assert_eq!(between.len(), 1);
    let [mean, rms, most] = ["mean", "rms", "hausdorff"].map(|name| number(&between[0], name));
    assert!(0.0 < mean && mean < rms && rms < most && most < 0.1, "{mean} {rms} {most}");

    let sirf = rows(&output.join("figure5.csv"));
    assert_eq!(sirf.iter().map(|row| number(row, "max_degree")).collect::<Vec<_>>(), [5.0, 10.0, 20.0]);
    assert!(sirf.windows(2).all(|pair| number(&pair[1], "msd") < number(&pair[0], "msd")));
    // One pass with one degree per block is SIRF.
    assert_eq!(text(&sirf[2], "msd"), text(&grid[0], "msd"));

    let nlsf = rows(&output.join("table1.csv"));
    assert!(nlsf.windows(2).all(|pair| number(&pair[1], "max_degree") >= number(&pair[0], "max_degree")));
    assert!(nlsf.iter().all(|row| number(row, "planned") <= number(row, "memory")));
    // No fit of this degree is closer to the vertices than the full least squares.
    let fitted = nlsf.last().expect("a row");
    assert_eq!(number(fitted, "fitted_degree"), 10.0);
    assert!(not_above(number(fitted, "msd"), number(&sirf[1], "msd")));

    let basis = rows(&output.join("figure3.csv"));
    assert_eq!(basis.len(), 6);
    for row in &basis {
        let columns = (number(row, "max_degree") + 1.0).powi(2);
        let values = 8.0 * number(row, "vertices") * columns;
        assert!(number(row, "bytes") > values && number(row, "seconds") > 0.0);
    }

    let families = rows(&output.join("least-squares-quadrature.csv"));
    assert_eq!(families.len(), 3);
    for row in &families {
        // Quadrature is farther from the vertices than the least squares.
        let (least, quadrature) = (number(row, "lsq_msd"), number(row, "quadrature_msd"));
        assert!(least > 0.0 && least < quadrature && number(row, "quadrature_seconds") > 0.0, "{least} {quadrature}");
    }

    for figure in ["figure3.svg", "figure5.svg", "figures6-7.generated.svg", "table1.svg"] {
        let svg = std::fs::read_to_string(output.join(figure)).expect("the figure is there");
        assert!(svg.contains("<svg") && svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"), "{figure}");
    }
    // The store has been removed, and no half-written file remains.
    assert_eq!(std::fs::read_dir(&output).expect("a folder").count(), 6 + 4 + 1);
}

#[test]
fn a_store_is_kept_and_used_again_and_results_are_not_replaced_unasked() {
    let folder = tempfile::tempdir().expect("a folder");
    let (output, store) = (folder.path().join("results"), folder.path().join("store"));
    let run = || {
        let mut command = tool("paper");
        command.args(["--quick", "--quiet", "--output"]).arg(&output).arg("--store").arg(&store);
        command
    };
    succeed(&mut run());
    let kept = || std::fs::read_dir(&store).expect("a store").count();
    assert_eq!(kept(), 1);
    let error = fail(&mut run());
    assert!(error.contains("the result exists") && error.contains("--force"), "{error}");
    succeed(run().arg("--force"));
    assert_eq!(kept(), 1);
}

#[test]
fn a_folder_of_data_that_is_not_there_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let missing = folder.path().join("nothing");
    let error = fail(tool("paper").arg("--data").arg(&missing).arg("--output").arg(folder.path().join("results")));
    assert!(error.contains("nothing: cannot open the folder of the surfaces"), "{error}");
    let usage = tool("paper").args(["--quick", "--data", "."]).output().expect("the tool starts");
    assert_eq!(usage.status.code(), Some(2));
}
