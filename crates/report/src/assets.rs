//! Provides the assets of a report page: script, WebAssembly and style sheet.
//!
//! `./run report-assets` builds the script from `viewer/` and the WebAssembly from `crates/viewer`, and writes the
//! hashes of their sources to `assets/sources.txt`. A test compares these hashes with the current sources.

use std::io::Read;

use flate2::read::GzDecoder;

use crate::ReportError;

/// The page's script, gzipped: `viewer/src` and three.js, including the licence of three.js.
const SCRIPT: &[u8] = include_bytes!("../assets/page.js.gz");
/// `crates/viewer` as WebAssembly, gzipped.
pub(crate) const WASM: &[u8] = include_bytes!("../assets/viewer.wasm.gz");
/// The page's style sheets, concatenated.
pub(crate) const STYLE: &str =
    concat!(include_str!("page.css"), include_str!("table.css"), include_str!("chart.css"), include_str!("check.css"));
/// HTML elements of a 3D view, which the script fills in.
pub(crate) const VIEW: &str = include_str!("view.html");

/// Returns the text of the page's script.
pub(crate) fn script() -> Result<String, ReportError> {
    let mut text = String::new();
    GzDecoder::new(SCRIPT).read_to_string(&mut text).map_err(ReportError::Assets)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::{Path, PathBuf};

    use sha2::{Digest, Sha256};

    use super::*;

    /// Returns the files in a folder and its subfolders, sorted, except for `node_modules`.
    fn files(folder: &Path) -> Vec<PathBuf> {
        let mut entries: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        entries.sort();
        entries.retain(|path| path.file_name().is_some_and(|name| name != "node_modules"));
        let all = entries.into_iter().map(|path| if path.is_dir() { files(&path) } else { vec![path] });
        all.flatten().collect()
    }

    /// The assets are compared with the current sources. In a published package, which doesn't contain the sources of
    /// the script, the comparison is skipped.
    #[test]
    fn the_assets_are_built_from_these_sources() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        if !root.join("viewer").is_dir() {
            eprintln!("skipped: no viewer/ here");
            return;
        }
        let folders = ["viewer", "crates/viewer", "crates/transform/src", "crates/harmonics/src"];
        let found = folders.iter().flat_map(|folder| files(&root.join(folder))).map(|path| {
            let digest = Sha256::digest(fs::read(&path).unwrap());
            let digest: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
            format!("{digest}  {}", path.strip_prefix(&root).unwrap().display())
        });
        let found: BTreeSet<String> = found.collect();
        let recorded: BTreeSet<String> = include_str!("../assets/sources.txt").lines().map(str::to_owned).collect();
        let changed: Vec<&String> = found.symmetric_difference(&recorded).collect();
        assert!(changed.is_empty(), "these have changed: run ./run report-assets: {changed:#?}");
    }

    #[test]
    fn the_script_is_one_element_with_its_licence() {
        let script = script().unwrap();
        assert!(!script.contains("</script") && !script.contains("<!--") && !script.contains(['\r', '\0']));
        assert!(script.contains("three.js") && script.contains("MIT"), "the notice of three.js");
        assert!(SCRIPT.len() + WASM.len() < 600_000);
        assert!(!STYLE.contains("</") && !STYLE.contains("url("));
    }
}
