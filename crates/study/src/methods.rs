//! Writes the methods paragraph for a paper, with versions, settings and citations.

use std::collections::HashSet;
use std::fmt::Write;

use anyhow::Result;
use serde_json::Value;
use spharm::parametrize::volume::is_volume;
use spharm::shape::outliers;
use spharm_cli::output::counted;
use spharm_cohort::Row;

use super::config::Method;
use super::exclusion::Named;
use super::plan::Plan;
use super::test::Test;
use super::warnings::{about, ids_in_state};
use spharm_analysis::Poses;

/// Name of the file in the study's output folder that contains the methods paragraph.
pub(super) const FILE: &str = "methods.md";

/// Cited publications, with the short forms by which the text refers to them.
const CITED: [(&str, &str); 9] = [
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
    (
        "Welch 1947",
        "B. L. Welch, The generalization of \"Student's\" problem when several different population variances are involved, \
         Biometrika 34, 1947.",
    ),
    ("Welch 1951", "B. L. Welch, On the comparison of several mean values, Biometrika 38, 1951."),
    (
        "Freedman and Lane 1983",
        "D. Freedman and D. Lane, A nonstochastic interpretation of reported significance levels, \
         Journal of Business and Economic Statistics 1, 1983.",
    ),
];

/// Returns the methods paragraph of a study, followed by the references. `subjects` is the number of subjects that
/// could be fitted; `failed` lists the ids of the subjects that couldn't be fitted, and `flagged` the ids of the
/// subjects that the quality control flagged.
pub(super) fn text(plan: &Plan, subjects: usize, failed: &[&str], flagged: &[&str]) -> Result<String> {
    let (version, study) = (env!("CARGO_PKG_VERSION"), &plan.study);
    let mut text = format!(
        "{} were modelled by spherical harmonics up to degree {} (Shen and Chung 2006) with spharm-rs \
         {version}",
        surfaces_of(plan, subjects, failed),
        study.fit.max_degree,
    );
    let arguments = plan.fit_arguments();
    if !arguments.is_empty() {
        let _ = write!(text, " (spharm fit {})", arguments.join(" "));
    }
    text += if plan.has_one_sphere() || plan.manifest.rows.iter().all(|row| row.sphere.is_some()) {
        ", using the given maps to the sphere"
    } else if plan.area() == Some(0.0) {
        ", using maps to the sphere that preserve angles"
    } else {
        ", using maps to the sphere that preserve areas (Brechbühler et al. 1995)"
    };
    text += ". ";
    text += &of_volumes(plan);
    if !failed.is_empty() {
        let count = counted(failed.len(), plan.row_noun());
        let _ = write!(text, "{count} could not be modelled ({}). ", failed.join(", "));
    }
    if subjects >= outliers::LEAST {
        text += "Outliers were detected by robust z scores (from the median and the median absolute deviation) beyond \
                 3.5 in volume, area, sphericity, residual, distance from the mean or scores on the modes of \
                 variation. ";
    }
    if !plan.excluded.is_empty() {
        let reasons = with_reasons(plan.excluded.iter().map(|(row, reason)| (row.id.as_str(), reason.as_str())));
        let _ = write!(text, "{} excluded ({reasons}). ", counted_were(plan.excluded.len(), plan.row_noun()));
    }
    // Only flagged subjects have the state `accepted`, so an accepted subject without flags isn't mentioned.
    let with_flags = ids_in_state(plan, "accepted")?;
    let accepted: Vec<&Named> = study.subjects.accept.iter().filter(|of| with_flags.contains(&of.id)).collect();
    if !accepted.is_empty() {
        let count = counted(accepted.len(), plan.row_noun());
        let accepted = with_reasons(accepted.iter().map(|of| (of.id.as_str(), of.reason.as_str())));
        let _ =
            write!(text, "{count} remained in the group regardless of flags from the quality control ({accepted}). ");
    }
    if !flagged.is_empty() {
        let count = counted(flagged.len(), plan.row_noun());
        let _ = write!(
            text,
            "{count} remained in the group although flagged by the quality control ({}). ",
            flagged.join(", ")
        );
    }
    let (scale, mirror) = (study.align.scale, study.align.mirror);
    text += match plan.method {
        Method::Correspond => {
            "Correspondence was established by groupwise registration of one template to all surfaces, without \
             knowledge of groups and covariates"
        }
        Method::Joint => "The models were aligned by rotations in space and rotations of the parameter spheres",
        Method::Fixed => {
            "The spherical maps were assumed to correspond, and the models were aligned by rotations and translations"
        }
        Method::None => {
            "The models were compared in their original positions, and their spherical maps were assumed to correspond"
        }
    };
    if plan.method != Method::None {
        text += if scale { ", and scaled to a common size" } else { ", without scaling" };
        text += if mirror { "; mirror images were also matched" } else { "" };
        text += match (plan.method, study.align.pose) {
            (Method::Correspond, Poses::Near) => {
                ". The given poses were improved by rigid registration to nearest points. "
            }
            (Method::Correspond, Poses::Given) => ". The given poses were kept. ",
            (Method::Correspond, Poses::Any) => {
                ". Poses were found by a search over all rotations, followed by rigid registration to nearest points. "
            }
            _ => ". ",
        };
    } else {
        text += ". ";
    }
    if let [_, second] = &study.subjects.sides[..] {
        let _ = write!(text, "Surfaces of the side {second} were mirrored first. ");
    }
    if plan.method == Method::Correspond {
        text += "The models of the group were fitted over the sphere of the template. ";
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
        text +=
            "The same linear models were applied to area, volume, sphericity and the scores on the modes of variation";
        text += if text.contains("Family-wise") { ", with family-wise p values over these measures. " } else { ". " };
        text += "False discovery rates (q) were computed as in Benjamini and Hochberg 1995. ";
    }
    let cited = CITED.iter().filter(|(mark, _)| text.contains(mark));
    let references: String = cited.map(|(_, reference)| format!("- {reference}\n")).collect();
    Ok(format!("{}\n\n{references}", text.trim_end()))
}

/// Returns the number of surfaces and subjects as the beginning of a sentence. With blocks, a subject may have several
/// rows in the table, so surfaces and blocks are counted instead.
fn surfaces_of(plan: &Plan, fitted: usize, failed: &[&str]) -> String {
    if let [first, second] = &plan.study.subjects.sides[..] {
        let of = counted(plan.subjects_counted(), "subject");
        return format!("The surfaces of both sides ({first}, {second}) of {of}, {fitted} surfaces in total,");
    }
    let Some(blocks) = plan.study.test.iter().find_map(|test| test.blocks.as_deref()) else {
        return format!("The surfaces of {}", counted(fitted, "subject"));
    };
    let at = plan.columns().position(|column| column == blocks);
    let rows = plan.manifest.rows.iter().filter(|row| !failed.contains(&row.id.as_str()));
    let levels: HashSet<&str> = rows.filter_map(|row| Some(row.extra.get(at?)?.trim())).collect();
    format!("{} in {} (levels of {blocks})", counted(fitted, "surface"), counted(levels.len(), "block"))
}

/// Lists ids, each with its reason if one was given.
fn with_reasons<'a>(listed: impl Iterator<Item = (&'a str, &'a str)>) -> String {
    let one = |(id, reason): (&str, &str)| if reason.is_empty() { id.to_owned() } else { format!("{id}: {reason}") };
    listed.map(one).collect::<Vec<_>>().join("; ")
}

fn counted_were(count: usize, noun: &str) -> String {
    format!("{} {}", counted(count, noun), if count == 1 { "was" } else { "were" })
}

/// Returns the sentences of the methods paragraph about a test.
fn of_test(test: &Test, plan: &Plan) -> Result<String> {
    let quantity = match test.signal.as_deref() {
        Some("position") => "the position of each surface point",
        Some("value") => "the value at each surface point",
        _ => "the displacement of each surface point along the mean's normal",
    };
    let side = match (&test.side, &plan.study.subjects.sides[..]) {
        (Some(_), [first, second]) if test.is_of_differences() => {
            format!(" (the difference {first} minus mirrored {second} in each subject)")
        }
        (Some(side), _) => format!(" on side {side}"),
        _ => String::new(),
    };
    let about = about(plan, test)?;
    let effect = match test.effect.split_once(':').filter(|_| !plan.manifest.columns.contains(&test.effect)) {
        Some((first, second)) if test.contrast.is_empty() => format!("the interaction of {first} and {second}"),
        Some((first, second)) => format!("a contrast in the model with {first}, {second} and their interaction"),
        None if test.contrast.is_empty() => format!("the effect of {}", test.effect),
        None => format!("a contrast in the model with {}", test.effect),
    };
    let tested = match test.mean {
        true => {
            let of = about["subjects"].as_u64().unwrap_or_default();
            format!("the mean of {quantity}{side} in {of} subjects was compared with zero")
        }
        false => {
            let (meaning, subjects) = (about["tested"].as_str().unwrap_or_default(), subjects_of(&about));
            format!("{effect} ({meaning}{subjects}) on {quantity}{side} was tested")
        }
    };
    let mut text = format!("In the test \"{}\", {tested}", test.name);
    if !test.covariates.is_empty() {
        let plural = if test.covariates.len() == 1 { "a covariate" } else { "covariates" };
        let _ = write!(text, ", with {} as {plural}", test.covariates.join(", "));
    }
    text += " in a linear model at each vertex";
    if let Some(groups) = &test.variance_groups {
        let _ = write!(
            text,
            ", with the v or G statistic and separate variances for the levels of {groups} (Welch 1951; Winkler et \
             al. 2014)"
        );
    } else if test.welch {
        text += ", with Welch's t (Welch 1947)";
    }
    text += ". ";
    if let Some(mask) = &test.mask {
        let _ = write!(text, "Only vertices within the mask {} were tested. ", mask.display());
    }
    if let Some(count) = about["without_counterpart"].as_u64().filter(|count| *count > 0) {
        let _ = write!(text, "Vertices without a counterpart on the subjects' surfaces ({count}) were left out. ");
    }
    if let (Some(count), Some(assumption)) = (about["relabellings"].as_u64(), about["assumption"].as_str()) {
        let which = if about["exact"] == true { "all" } else { "random" };
        let _ = write!(
            text,
            "Family-wise p values were computed from the maximum statistic over {} vertices in {count} relabellings \
             ({which}){} (Winkler et al. 2014), under the assumption of {assumption}",
            about["vertices"].as_u64().unwrap_or_default(),
            if has_nuisance(test, &about) {
                ", with nuisance effects treated by the method of Freedman and Lane 1983"
            } else {
                ""
            },
        );
        if let Some(blocks) = &test.blocks {
            let how = if test.whole_blocks { "of whole blocks" } else { "within blocks" };
            let _ = write!(text, ", with exchanges {how} of {blocks} (Winkler et al. 2015)");
        }
        if test.tfce {
            text += ", with threshold-free cluster enhancement (Smith and Nichols 2009)";
        }
        if let Some(p) = test.cluster {
            let _ = write!(text, ", and for the area of clusters with uncorrected p below {p}");
        }
        text += ". ";
    }
    let p = match test.map() {
        "q" => "the false-discovery rate",
        "p-tfce" => "the family-wise p values of threshold-free cluster enhancement",
        _ => "the family-wise p values",
    };
    let effect = if plan.test_folder(test).join("effect.shape.gii").is_file() { "the effect, " } else { "" };
    let _ = write!(text, "The figure of this test shows {effect}the statistic and -log10 of {p}. ");
    Ok(text)
}

/// Returns whether a test has terms besides the effect and the overall mean.
fn has_nuisance(test: &Test, about: &Value) -> bool {
    let columns = about["columns"].as_array().map_or(0, Vec::len);
    let of_all_levels = test.contrast.is_empty() && about["statistic"]["name"] == "F";
    !test.covariates.is_empty() || test.effect.contains(':') || columns > 2 && !of_all_levels
}

/// Returns the sentences about how surfaces were made from volumes; empty if the study has no volumes.
fn of_volumes(plan: &Plan) -> String {
    let fit = &plan.study.fit;
    let mapped = |row: &Row| row.sphere.is_none() && is_volume(&row.surface);
    if plan.has_one_sphere() || !plan.manifest.rows.iter().any(mapped) {
        return String::new();
    }
    let probability = fit.arguments.iter().any(|argument| argument == "--probability");
    let (body, volume) = match fit.value("--threshold") {
        Some(level) => {
            (format!("voxels with values of {level} or more in a volume"), "the volume of the interpolated values")
        }
        None if probability => {
            ("voxels with a probability of 0.5 or more".to_owned(), "the sum of the voxels' probabilities")
        }
        None => ("the voxels of a label".to_owned(), "the volume of the voxels"),
    };
    if fit.value("--label-surface") == Some("voxels") {
        return format!("Each surface consisted of the outer faces of {body}. ");
    }
    let image = ["--channel", "--time"].into_iter().filter_map(|name| Some((&name[2..], fit.value(name)?)));
    let image: String = image.map(|(name, number)| format!(", {name} {number}")).collect();
    let body = body + &image;
    let radius = fit.value("--smooth-radius").unwrap_or("0.5");
    format!(
        "Each surface minimised the bending energy while staying within {radius} voxels of the outer faces of {body}; \
         the enclosed volume was {volume}. "
    )
}

/// Returns the number of subjects of each level as text, such as "; 10 a, 12 b"; empty for an effect without levels.
fn subjects_of(about: &Value) -> String {
    let one = |level: &Value| Some(format!("{} {}", level["subjects"].as_u64()?, level["level"].as_str()?));
    let counts: Vec<String> = about["levels"].as_array().into_iter().flatten().filter_map(one).collect();
    if counts.is_empty() { String::new() } else { format!("; {}", counts.join(", ")) }
}
