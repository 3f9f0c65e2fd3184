//! Derives the names of outputs from each input's path alone.
//!
//! A name must not depend on the other inputs of a call, because a cluster job with one subject and a call with all
//! subjects must write the same files. Names are therefore made from a template, and inputs for which the template
//! gives equal names are refused.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Result, bail};
use spharm_cohort::file_stem;
use spharm_surface::io::is_named_mesh;

/// Largest number N in a placeholder `{parentN}`, which stands for the folder N levels above the file.
const DEEPEST: usize = 9;

/// A name with placeholders. `{stem}` is the input's name without its folder and the extension of its format,
/// `{parent}` is the name of the folder that contains it, `{parent2}` is the name of the folder above that, and so on,
/// with links resolved. `{label}` is a volume's label. For volumes, `.{label}` is appended to a template without this
/// placeholder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NameTemplate(Vec<Part>);

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Text(String),
    Stem,
    Label,
    /// Name of the folder at this number of levels above the file; 1 is the folder that contains the file.
    Parent(usize),
}

impl FromStr for NameTemplate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (mut parts, mut rest) = (Vec::new(), text);
        while let Some((before, after)) = rest.split_once('{') {
            let (name, after) = after
                .split_once('}')
                .ok_or_else(|| format!("expected }} after each {{ in the template, found {text}"))?;
            if !before.is_empty() {
                parts.push(Part::Text(before.to_owned()));
            }
            let level = name.strip_prefix("parent").map(|level| if level.is_empty() { "1" } else { level });
            parts.push(match (name, level.and_then(|level| level.parse().ok())) {
                ("stem", _) => Part::Stem,
                ("label", _) => Part::Label,
                (_, Some(level @ 1..=DEEPEST)) => Part::Parent(level),
                _ => {
                    return Err(format!(
                        "{{{name}}}: expected {{stem}}, {{label}}, {{parent}} or {{parent2}} to {{parent{DEEPEST}}}"
                    ));
                }
            });
            rest = after;
        }
        if !rest.is_empty() {
            parts.push(Part::Text(rest.to_owned()));
        }
        let separators = |part: &Part| matches!(part, Part::Text(text) if text.contains(['/', '\\']));
        if parts.iter().any(separators) {
            return Err("a name can't contain folders; give the folder with --output".to_owned());
        }
        if parts.iter().all(|part| matches!(part, Part::Text(_))) {
            return Err("expected a placeholder, such as {stem}; otherwise all outputs have the same name".to_owned());
        }
        Ok(Self(parts))
    }
}

impl std::fmt::Display for NameTemplate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|part| match part {
            Part::Text(text) => f.write_str(text),
            Part::Stem => f.write_str("{stem}"),
            Part::Label => f.write_str("{label}"),
            Part::Parent(1) => f.write_str("{parent}"),
            Part::Parent(level) => write!(f, "{{parent{level}}}"),
        })
    }
}

impl NameTemplate {
    /// Returns the name of an input (and of a label, if the input is a volume), for display. A placeholder for a folder
    /// that isn't in the path is replaced by nothing.
    #[must_use]
    pub fn name(&self, input: &Path, label: Option<i64>) -> String {
        self.file_name(input, label).to_string_lossy().into_owned()
    }

    /// Returns the name of an input with the exact bytes of its path, for use in file names.
    #[must_use]
    pub fn file_name(&self, input: &Path, label: Option<i64>) -> OsString {
        let input = in_its_folder(input);
        let folder = |level: usize| input.ancestors().nth(level).and_then(Path::file_name);
        let part = |part: &Part| match part {
            Part::Text(text) => OsString::from(text),
            Part::Stem => file_stem(&input),
            Part::Label => label.map(|label| label.to_string()).unwrap_or_default().into(),
            Part::Parent(level) => folder(*level).unwrap_or_default().to_owned(),
        };
        let unnamed = label.filter(|_| !self.0.contains(&Part::Label));
        let end = unnamed.map(|label| format!(".{label}").into());
        self.0.iter().map(part).chain(end).collect()
    }

    /// Returns the path of the output file for each input and label, made from `folder`, the name and `ending`.
    ///
    /// # Errors
    ///
    /// If two inputs would share a file, or if `{label}` is the template's only placeholder and an input has no label.
    /// For inputs that would share a file, the message gives a template that distinguishes them.
    pub fn outputs(&self, inputs: &[(PathBuf, Option<i64>)], folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
        let of_input = self.0.iter().any(|part| matches!(part, Part::Stem | Part::Parent(_)));
        if let (false, Some((input, _))) = (of_input, inputs.iter().find(|(_, label)| label.is_none())) {
            bail!(
                "{}: --name-template '{self}' has only the placeholder {{label}}, but this input isn't a label of a \
                 volume",
                input.display()
            );
        }
        let output = |(input, label): &(PathBuf, _)| {
            let mut name = self.file_name(input, *label);
            name.push(ending);
            folder.join(name)
        };
        let outputs: Vec<PathBuf> = inputs.iter().map(output).collect();
        let mut order: Vec<usize> = (0..inputs.len()).collect();
        order.sort_by(|&a, &b| outputs[a].cmp(&outputs[b]));
        if let Some(pair) = order.windows(2).find(|pair| outputs[pair[0]] == outputs[pair[1]]) {
            let [first, second] = [pair[0], pair[1]].map(|number| inputs[number].0.display());
            let paths: Vec<PathBuf> = inputs.iter().map(|(input, _)| input.clone()).collect();
            let remedy = match Self::distinguishing(&paths) {
                Some(template) => format!("give --name-template '{template}'"),
                None => "rename one of the inputs, or process the inputs in separate calls".to_owned(),
            };
            bail!(
                "the results of {first} and {second} would both be written to {}; {remedy}",
                outputs[pair[0]].display()
            );
        }
        Ok(outputs)
    }

    /// Returns a template that gives each input a distinct name, made of one or two folders and the stem. Returns
    /// `None` if no such template exists.
    #[must_use]
    pub fn distinguishing(inputs: &[PathBuf]) -> Option<Self> {
        let one = (1..=DEEPEST).map(|level| vec![level]);
        let two = (1..=DEEPEST).flat_map(|low| (low + 1..=DEEPEST).map(move |high| vec![high, low]));
        let template = |levels: Vec<usize>| {
            let folders = levels.into_iter().flat_map(|level| [Part::Parent(level), Part::Text(".".to_owned())]);
            Self(folders.chain([Part::Stem]).collect())
        };
        let distinguishes = |template: &Self| {
            let mut names: Vec<OsString> = inputs.iter().map(|input| template.file_name(input, None)).collect();
            names.sort_unstable();
            names.windows(2).all(|pair| pair[0] != pair[1])
        };
        one.chain(two).map(template).find(distinguishes)
    }
}

/// Makes a file's path absolute and resolves the links in its folder, but not the file's own name. If the folder
/// doesn't exist, no links are resolved.
fn in_its_folder(input: &Path) -> PathBuf {
    let absolute = std::path::absolute(input).unwrap_or_else(|_| input.to_owned());
    let folder = absolute.parent().and_then(|folder| folder.canonicalize().ok());
    match (folder, absolute.file_name()) {
        (Some(folder), Some(name)) => folder.join(name),
        _ => absolute,
    }
}

/// Returns whether a path names a file rather than a folder: it isn't an existing folder, and it has the extension of a
/// file format.
#[must_use]
pub fn is_named_file(path: &Path) -> bool {
    const ENDINGS: [&str; 11] = ["npz", "sphz", "csv", "tsv", "npy", "json", "gii", "gz", "png", "mgh", "mgz"];
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    !path.is_dir() && (ENDINGS.contains(&ending.as_str()) || is_named_mesh(path))
}

/// Returns the model's file for each surface. The file is `output` itself if `output` ends in `.npz` and there is only
/// one surface. Otherwise it is a file in the folder `output`, or in the current folder if `output` is `None`.
///
/// # Errors
///
/// If `output` is a model's file but there are several surfaces, if `output` has the extension of another format, or if
/// two surfaces would have the same file.
pub fn model_files(
    output: Option<&Path>,
    template: &NameTemplate,
    surfaces: &[(PathBuf, Option<i64>)],
) -> Result<Vec<PathBuf>> {
    let folder = output.unwrap_or(Path::new(""));
    let ending = folder.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match surfaces {
        _ if folder.is_dir() => {}
        [_] if ending == "npz" => return Ok(vec![folder.to_owned()]),
        several if ending == "npz" => {
            bail!(
                "{}: one file can't hold the results of {} surfaces; --output must name a folder",
                folder.display(),
                several.len()
            );
        }
        _ if is_named_file(folder) => {
            bail!("{}: --output must name a folder, or a file ending in .npz", folder.display());
        }
        _ => {}
    }
    template.outputs(surfaces, folder, ".spharm.npz")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(template: &str, input: &str) -> String {
        template.parse::<NameTemplate>().unwrap().name(Path::new(input), None)
    }

    #[test]
    fn placeholders_are_the_stem_and_the_folders_above() {
        let input = "/data/sub-01/surf/lh.pial.surf.gii";
        assert_eq!(name("{stem}", input), "lh.pial");
        assert_eq!(name("{parent2}_{stem}.v1", input), "sub-01_lh.pial.v1");
        assert_eq!(name("{parent}{parent3}", input), "surfdata");
        assert_eq!(name("{parent9}.{stem}", input), ".lh.pial");
        let here = std::env::current_dir().unwrap();
        assert_eq!(name("{parent}", "lh.pial"), here.file_name().unwrap().to_string_lossy());
    }

    #[test]
    fn labels_are_named_where_the_template_says_or_at_the_end() {
        let name =
            |template: &str| template.parse::<NameTemplate>().unwrap().name(Path::new("/d/cells.nii.gz"), Some(-3));
        assert_eq!(name("{stem}"), "cells.-3");
        assert_eq!(name("cell{label}_of_{stem}"), "cell-3_of_cells");
        assert_eq!(name("cell{label}"), "cell-3");
        let template: NameTemplate = "cell{label}".parse().unwrap();
        let error = template.outputs(&[("a.ply".into(), None)], Path::new(""), ".npz").unwrap_err();
        assert!(error.to_string().contains("a.ply") && error.to_string().contains("'cell{label}'"), "{error}");
    }

    #[test]
    fn a_name_is_the_same_however_the_path_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let subject = folder.path().canonicalize().unwrap().join("sub-01");
        [subject.join("mri"), subject.join("surf")].iter().for_each(|folder| std::fs::create_dir_all(folder).unwrap());
        for path in ["surf/lh.pial", "mri/../surf/lh.pial", "mri/.././surf/../surf/lh.pial"] {
            let path = subject.join(path);
            assert_eq!(name("{parent2}.{stem}", path.to_str().unwrap()), "sub-01.lh.pial", "{}", path.display());
        }
    }

    #[test]
    fn templates_without_a_placeholder_or_with_an_unknown_one_are_refused() {
        for (template, why) in [
            ("model", "placeholder"),
            ("{subject}", "{subject}"),
            ("{parent0}", "{parent0}"),
            ("{stem", "expected } after each {"),
            ("a/{stem}", "--output"),
        ] {
            let error = template.parse::<NameTemplate>().unwrap_err();
            assert!(error.contains(why), "{template}: {error}");
        }
    }

    #[test]
    fn names_of_other_files_are_no_folders() {
        let files =
            |output: &str| model_files(Some(Path::new(output)), &"{stem}".parse().unwrap(), &[("a.ply".into(), None)]);
        for output in ["out.sphz", "out.PLY", "out.mgz"] {
            let error = files(output).unwrap_err().to_string();
            assert!(error.contains("--output must name a folder, or a file ending in .npz"), "{error}");
        }
        for (output, file) in [("out.npz", "out.npz"), ("v1.2", "v1.2/a.spharm.npz")] {
            assert_eq!(files(output).unwrap(), [PathBuf::from(file)]);
        }
    }

    #[test]
    fn a_template_that_distinguishes_inputs_is_found() {
        let of = |inputs: &[&str]| {
            let inputs: Vec<PathBuf> = inputs.iter().map(PathBuf::from).collect();
            NameTemplate::distinguishing(&inputs).map(|template| template.to_string())
        };
        assert_eq!(of(&["/d/a/lh.pial", "/d/b/lh.pial"]).as_deref(), Some("{parent}.{stem}"));
        assert_eq!(of(&["/d/sub-01/surf/lh.pial", "/d/sub-02/surf/lh.pial"]).as_deref(), Some("{parent2}.{stem}"));
        let sites = ["/a/s1/lh.pial", "/a/s2/lh.pial", "/b/s1/lh.pial"];
        assert_eq!(of(&sites).as_deref(), Some("{parent2}.{parent}.{stem}"));
        assert_eq!(of(&["/d/x.obj", "/d/x.ply"]), None);
    }
}
