//! The paragraph on methods for a paper, with versions, settings and citations.

use std::fmt::Write;

use anyhow::Result;
use spharm_cli::output::counted;

use super::config::Method;
use super::plan::Plan;
use super::test::Test;
use super::warnings::about;

/// Name of the file in the study's output.
pub(super) const FILE: &str = "methods.md";

/// The cited publications, with the marks by which the text refers to them.
const CITED: [(&str, &str); 8] = [
    (
        "Shen and Chung 2006",
        "L. Shen and M. K. Chung, Large-scale modeling of parametric surfaces using spherical harmonics, 3DPVT 2006.",
    ),
    (
        "Brechbühler et al. 1995",
        "C. Brechbühler, G. Gerig and O. Kübler, Parametrization of closed surfaces for 3-D shape description, Computer \
         Vision and Image Understanding 61, 1995.",
    ),
    (
        "Winkler et al. 2014",
        "A. M. Winkler et al., Permutation inference for the general linear model, NeuroImage 92, 2014.",
    ),
    ("Winkler et al. 2015", "A. M. Winkler et al., Multi-level block permutation, NeuroImage 123, 2015."),
    (
        "Smith and Nichols 2009",
        "S. M. Smith and T. E. Nichols, Threshold-free cluster enhancement, NeuroImage 44, 2009.",
    ),
    (
        "Benjamini and Hochberg 1995",
        "Y. Benjamini and Y. Hochberg, Controlling the false discovery rate, Journal of the Royal Statistical Society B 57, \
         1995.",
    ),
    ("Welch 1951", "B. L. Welch, On the comparison of several mean values, Biometrika 38, 1951."),
    (
        "Freedman and Lane 1983",
        "D. Freedman and D. Lane, A nonstochastic interpretation of reported significance levels, \
         Journal of Business and Economic Statistics 1, 1983.",
    ),
];

/// Returns the text, for a study in which `subjects` subjects could be fitted.
pub(super) fn text(plan: &Plan, subjects: usize) -> Result<String> {
    let (version, study) = (env!("CARGO_PKG_VERSION"), &plan.study);
    let mut text = format!(
        "The surfaces of {} were modelled by spherical harmonics up to degree {} (Shen and Chung 2006) with spharm-rs \
         {version}",
        counted(subjects, "subject"),
        study.fit.max_degree,
    );
    if !study.fit.arguments.is_empty() {
        let _ = write!(text, " (spharm fit {})", study.fit.arguments.join(" "));
    }
    text += if plan.has_one_sphere() || plan.manifest.rows.iter().all(|row| row.sphere.is_some()) {
        ", over given spherical maps"
    } else {
        ", over maps to the sphere that preserve areas (Brechbühler et al. 1995)"
    };
    text += ". ";
    if !plan.excluded.is_empty() {
        let reasons: Vec<String> = plan
            .excluded
            .iter()
            .map(|(row, reason)| if reason.is_empty() { row.id.clone() } else { format!("{}: {reason}", row.id) })
            .collect();
        let _ = write!(text, "{} excluded ({}). ", counted_were(plan.excluded.len()), reasons.join("; "));
    }
    let (scale, mirror) = (study.align.scale, study.align.mirror);
    text += match plan.method {
        Method::Correspond => {
            "Correspondence was established by registering one template to all surfaces, groupwise, without knowledge of \
             groups and covariates"
        }
        Method::Joint => "The models were aligned by rotations of space and of the parameters",
        Method::Fixed => {
            "The spherical maps were taken as corresponding, and the models were aligned by rotations and translations"
        }
        Method::None => {
            "The models were compared in their original positions, with their spherical maps taken as corresponding"
        }
    };
    if plan.method != Method::None {
        text += if scale { ", and scaled to one size" } else { ", without scaling" };
        text += if mirror { "; mirror images were matched. " } else { ". " };
    } else {
        text += ". ";
    }
    if let Some(fits) = plan.signal_fits() {
        let masked = fits.manifest.rows.iter().any(|row| row.region.is_some());
        let _ = write!(
            text,
            "Values on the surfaces were modelled to the same degree{}. ",
            if masked { ", from the vertices within each subject's mask" } else { "" }
        );
    }
    for test in &study.test {
        text += &of_test(test, plan)?;
    }
    if !study.test.is_empty() {
        text += "False discovery rates (q) were computed as in Benjamini and Hochberg 1995. ";
    }
    let cited = CITED.iter().filter(|(mark, _)| text.contains(mark));
    let references: String = cited.map(|(_, reference)| format!("- {reference}\n")).collect();
    Ok(format!("{}\n\n{references}", text.trim_end()))
}

fn counted_were(count: usize) -> String {
    format!("{} {}", counted(count, "subject"), if count == 1 { "was" } else { "were" })
}

/// Returns the sentences about a test.
fn of_test(test: &Test, plan: &Plan) -> Result<String> {
    let quantity = match test.signal.as_deref() {
        Some("position") => "the position of each point of the surface",
        Some("value") => "the value at each point of the surface",
        _ => "the displacement of each point of the surface along the normal of the mean",
    };
    let about = about(plan, test)?;
    let effect = match test.effect.split_once(':').filter(|_| !plan.manifest.columns.contains(&test.effect)) {
        Some((first, second)) if test.contrast.is_empty() => format!("the interaction of {first} and {second}"),
        Some((first, second)) => format!("a contrast in the model of {first}, {second} and their interaction"),
        None if test.contrast.is_empty() => format!("the effect of {}", test.effect),
        None => format!("a contrast in the model of {}", test.effect),
    };
    let mut text = format!(
        "In the test \"{}\", {effect} ({}) on {quantity} was tested",
        test.name,
        about["tested"].as_str().unwrap_or_default()
    );
    if !test.covariates.is_empty() {
        let plural = if test.covariates.len() == 1 { "a covariate" } else { "covariates" };
        let _ = write!(text, ", with {} as {plural}", test.covariates.join(", "));
    }
    text += " in a linear model at each vertex";
    if let Some(groups) = &test.variance_groups {
        let _ = write!(text, ", by the v or G statistic with variances by {groups} (Welch 1951; Winkler et al. 2014)");
    } else if test.welch {
        text += ", by Welch's t (Welch 1951)";
    }
    text += ". ";
    if let (Some(count), Some(assumption)) = (about["relabellings"].as_u64(), about["assumption"].as_str()) {
        let which = if about["exact"] == true { "all" } else { "random" };
        let _ = write!(
            text,
            "Family-wise p values were computed from the maximum over {} vertices in {count} relabellings ({which}), with \
             nuisance effects by the method of Freedman and Lane 1983 (Winkler et al. 2014), under the assumption of \
             {assumption}",
            about["vertices"].as_u64().unwrap_or_default(),
        );
        if let Some(blocks) = &test.blocks {
            let how = if test.whole_blocks { "of whole blocks" } else { "within blocks" };
            let _ = write!(text, ", {how} of {blocks} (Winkler et al. 2015)");
        }
        if test.tfce {
            text += ", with threshold-free cluster enhancement (Smith and Nichols 2009)";
        }
        if let Some(p) = test.cluster {
            let _ = write!(text, ", and for the area of clusters of uncorrected p below {p}");
        }
        text += ". ";
    }
    Ok(text)
}
