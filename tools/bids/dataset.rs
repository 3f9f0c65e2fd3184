//! The files that make a folder a BIDS derivative: the description, the list of participants, and the list of files
//! that validators must ignore.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use spharm_cli::inputs::MOST_OWN;
use spharm_surface::io::write_new;

/// Version of BIDS that the file names follow.
const VERSION: &str = "1.10.0";
/// Patterns for `.bidsignore` that match the names of output files that aren't part of BIDS. fMRIPrep and sMRIPrep also
/// write such patterns for their own outputs.
const IGNORED: &str = "*.surf.gii\n*.shape.gii\n*.npz\n*_spectrum.tsv\n*_pial.json\n*_white.json\n*_midthickness.json\n*.html\nlogs/\ngroup_*\n";
const DESCRIPTION: &str = "dataset_description.json";

/// Writes the top-level files of a derivative dataset, unless they exist.
///
/// # Errors
///
/// If the folder contains the description of another dataset, or can't be written to.
pub(super) fn prepare(output: &Path, source: &Path, subjects: &[&str]) -> Result<()> {
    std::fs::create_dir_all(output.join("logs")).with_context(|| output.display().to_string())?;
    let path = output.join(DESCRIPTION);
    match spharm_files::read_text(&path, MOST_OWN) {
        Ok(text) if !is_ours(&text) => {
            bail!(
                "{}: expected a dataset made by spharm, found the description of another dataset; choose another OUT",
                path.display()
            )
        }
        Ok(_) => {}
        Err(_) => {
            let description = json!({
                "Name": "spharm: spherical-harmonic models of surfaces",
                "BIDSVersion": VERSION,
                "DatasetType": "derivative",
                "GeneratedBy": [{ "Name": "spharm", "Version": env!("CARGO_PKG_VERSION") }],
                "SourceDatasets": [{ "URL": source.canonicalize().unwrap_or_else(|_| source.to_owned()) }],
            });
            text(&path, &(serde_json::to_string_pretty(&description)? + "\n"))?;
        }
    }
    text(&output.join(".bidsignore"), IGNORED)?;
    text(
        &output.join("README.md"),
        "# spharm\n\nSpherical-harmonic models of cortical surfaces, fitted by `spharm bids`. Each model is a NumPy \
         archive with a .json file that describes how it was made. Files whose names begin in the same way contain the \
         spectrum of the model, its surface at the vertices of an icosphere, and its distances from the fitted \
         vertices.\n",
    )?;
    let mut rows: Vec<String> = subjects.iter().map(|subject| format!("sub-{subject}\n")).collect();
    if let Ok(found) = spharm_files::read_text(output.join("participants.tsv"), MOST_OWN) {
        rows.extend(found.lines().skip(1).map(|line| format!("{line}\n")));
    }
    rows.sort_unstable();
    rows.dedup();
    text(&output.join("participants.tsv"), &format!("participant_id\n{}", rows.concat()))
}

fn is_ours(text: &str) -> bool {
    let description: Value = serde_json::from_str(text).unwrap_or_default();
    let by = description["GeneratedBy"].as_array();
    by.is_some_and(|by| by.iter().any(|tool| tool["Name"] == "spharm"))
}

/// Writes a text file atomically; leaves the file untouched if it already has these contents.
///
/// # Errors
///
/// If the file can't be written.
pub(super) fn text(path: &Path, text: &str) -> Result<()> {
    if spharm_files::read(path, text.len() as u64).is_ok_and(|found| found == text.as_bytes()) {
        return Ok(());
    }
    spharm_cli::output::prepare(path)?;
    write_new(path, true, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}
