//! The study file: TOML with checked keys.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use spharm_cli::inputs::read_text;
use toml::Table;

use super::exclusion::Named;
use super::keys;
use super::test::Test;
use spharm_analysis::Poses;
use spharm_analysis::With;

/// Contents of a study file; paths are as written in the file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub(super) struct Study {
    pub(super) title: String,
    pub(super) output: PathBuf,
    pub(super) subjects: Subjects,
    pub(super) fit: Fit,
    pub(super) align: Align,
    pub(super) modes: Modes,
    pub(super) quality: Quality,
    pub(super) test: Vec<Test>,
    pub(super) page: Page,
}

impl Default for Study {
    fn default() -> Self {
        Self {
            title: "Study".to_owned(),
            output: PathBuf::from("study"),
            subjects: Subjects::default(),
            fit: Fit::default(),
            align: Align::default(),
            modes: Modes::default(),
            quality: Quality::default(),
            test: Vec::new(),
            page: Page::default(),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub(super) struct Subjects {
    pub(super) table: PathBuf,
    /// Name of the column that contains the ids, if patterns name the subjects' files.
    pub(super) id: String,
    /// Path of each subject's surface, a pattern with `{id}`.
    pub(super) surface: Option<String>,
    /// Path of each subject's sphere, a pattern with `{id}`.
    pub(super) sphere: Option<String>,
    /// Path of each subject's landmarks, a pattern with `{id}`.
    pub(super) landmarks: Option<String>,
    /// Values on the vertices of the surface: a column of the table, or a pattern with `{id}`.
    pub(super) signal: Option<String>,
    /// Vertices at which the signal is read: a column, a pattern with `{id}`, or `none`.
    pub(super) mask: Option<String>,
    /// Names of the two sides of each subject, which replace `{side}` in patterns. The second side is mirrored.
    pub(super) sides: Vec<String>,
    /// Label of the surface in every subject's volume, if the surfaces are given by a pattern.
    pub(super) label: Option<i64>,
    /// Label of each side, if each volume contains both sides.
    pub(super) labels: Vec<i64>,
    /// Subjects to exclude, with reasons.
    pub(super) exclude: Vec<Named>,
    /// Subjects whose flags are accepted, with reasons.
    pub(super) accept: Vec<Named>,
}

impl Default for Subjects {
    fn default() -> Self {
        Self {
            table: PathBuf::new(),
            id: "id".to_owned(),
            surface: None,
            sphere: None,
            landmarks: None,
            signal: None,
            mask: None,
            sides: Vec::new(),
            label: None,
            labels: Vec::new(),
            exclude: Vec::new(),
            accept: Vec::new(),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub(super) struct Fit {
    pub(super) max_degree: usize,
    pub(super) arguments: Vec<String>,
}

impl Fit {
    /// Returns the arguments that concern the reading of volumes.
    pub(super) fn of_volumes(&self) -> Vec<String> {
        let with_value =
            ["--voxel-size", "--axes", "--threshold", "--channel", "--time", "--smooth-radius"].into_iter();
        let mut found: Vec<String> =
            with_value.filter_map(|name| Some([name.to_owned(), self.value(name)?.to_owned()])).flatten().collect();
        found.extend(self.arguments.iter().find(|argument| *argument == "--probability").cloned());
        found
    }

    /// Returns the sphere shared by all fits, if the arguments contain one.
    pub(super) fn sphere(&self) -> Option<&str> {
        self.value("--sphere")
    }

    /// Returns the value of an option in the arguments.
    pub(super) fn value(&self, name: &str) -> Option<&str> {
        let given = |argument: &String| argument.split('=').next() == Some(name);
        let at = self.arguments.iter().position(given)?;
        match self.arguments[at].split_once('=') {
            Some((_, value)) => Some(value),
            None => self.arguments.get(at + 1).map(String::as_str),
        }
    }
}

/// Method of bringing the subjects into correspondence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub(super) enum Method {
    /// One template is registered to all surfaces.
    Correspond,
    /// Surfaces were mapped individually; rotations of space and of the parameters are searched.
    Joint,
    /// Spheres correspond; only rotations of space are searched.
    Fixed,
    None,
}

impl Method {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Correspond => "correspond",
            Self::Joint => "joint",
            Self::Fixed => "fixed",
            Self::None => "none",
        }
    }
}

impl TryFrom<String> for Method {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let all = [Self::Correspond, Self::Joint, Self::Fixed, Self::None];
        if let Some(method) = all.into_iter().find(|method| method.name() == name) {
            return Ok(method);
        }
        let nearest = all.map(Self::name).into_iter();
        let nearest = nearest.map(|known| (strsim::damerau_levenshtein(&name, known), known)).min();
        let hint =
            nearest.filter(|(distance, _)| *distance <= 2).map(|(_, known)| format!("; did you mean {known:?}?"));
        Err(format!(
            "expected \"correspond\", \"joint\", \"fixed\" or \"none\", found {name:?}{}",
            hint.unwrap_or_default()
        ))
    }
}

#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub(super) struct Align {
    /// Method of correspondence; `None` selects "fixed" if all subjects have spheres, otherwise "correspond".
    pub(super) method: Option<Method>,
    /// Poses that the correspondence considers, as for `shape correspond --pose`.
    pub(super) pose: Poses,
    pub(super) scale: bool,
    pub(super) mirror: bool,
    /// Whether the landmarks guide the correspondence.
    pub(super) guide: bool,
    /// Signals that the correspondence also matches: columns of the table, or patterns with `{id}`.
    pub(super) signals: Vec<With>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub(super) struct Modes {
    pub(super) count: usize,
}

impl Default for Modes {
    fn default() -> Self {
        Self { count: 10 }
    }
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default)]
pub(super) struct Quality {
    /// Whether the plain alignment ("joint") is also computed and measured, for comparison.
    pub(super) plain: bool,
    /// Whether generalisation and specificity are also measured by the distance between surfaces.
    pub(super) surfaces: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self { plain: true, surfaces: true }
    }
}

#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub(super) struct Page {
    pub(super) subjects: bool,
}

/// Largest size of a study file, in bytes.
const LARGEST: u64 = 1 << 20;

impl Study {
    /// Reads the text of a study file.
    ///
    /// # Errors
    ///
    /// If the file can't be read.
    pub(super) fn text(path: &Path) -> Result<String> {
        read_text(path, "study", LARGEST)
    }

    /// Parses the text of a study file.
    ///
    /// # Errors
    ///
    /// If the text has an unknown key, lacks a required key, or has a value of the wrong type.
    pub(super) fn parse(text: &str) -> Result<Self> {
        let table: Table = text.parse().map_err(|error: toml::de::Error| told(text, &error))?;
        keys::check(&table)?;
        let study: Self = toml::from_str(text).map_err(|error| told(text, &error))?;
        study.check()?;
        Ok(study)
    }

    fn check(&self) -> Result<()> {
        if self.output.as_os_str().is_empty() || self.subjects.table.as_os_str().is_empty() {
            bail!("`output` and `table` in [subjects] are paths and can't be empty");
        }
        if self.fit.max_degree == 0 {
            bail!("`max_degree` in [fit]: expected a degree of at least 1, found 0");
        }
        for (index, test) in self.test.iter().enumerate() {
            let plain = |c: char| c.is_alphanumeric() || "-_.".contains(c);
            if test.name.is_empty() || test.name.starts_with('.') || !test.name.chars().all(plain) {
                bail!(
                    "test {:?}: expected a name made up of letters, digits, -, _ and ., because the test's folder has \
                     this name; found {:?}",
                    index + 1,
                    test.name
                );
            }
            if self.test[..index].iter().any(|other| other.name == test.name) {
                bail!("test {:?}: the name is used twice", test.name);
            }
            test.check().with_context(|| format!("test {:?}", test.name))?;
        }
        Ok(())
    }
}

/// Formats a TOML error as one line, with the line number and the key in that line.
fn told(text: &str, error: &toml::de::Error) -> anyhow::Error {
    let message = error.message().replace('\n', " ").replace("usize", "a whole number");
    let Some(before) = error.span().and_then(|span| text.get(..span.start)) else { return anyhow::anyhow!(message) };
    let line = before.matches('\n').count() + 1;
    let key = before.rsplit('\n').next().and_then(|start| start.split_once('=')).map(|(key, _)| key.trim());
    match key {
        Some(key) => anyhow::anyhow!("line {line}: `{key}`: {message}"),
        None => anyhow::anyhow!("line {line}: {message}"),
    }
}

/// Escapes a string for use in a quoted TOML string.
pub(super) fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"")
}

/// Returns the commented template of a study file; `table` is the path of its table, if given.
pub(super) fn template(table: Option<&str>) -> String {
    let template = include_str!("template.toml");
    match table {
        Some(table) => template.replace("table = \"subjects.tsv\"", &format!("table = \"{}\"", escaped(table))),
        None => template.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEMPLATE: &str = include_str!("template.toml");

    #[test]
    fn the_template_is_a_study() {
        let study = Study::parse(TEMPLATE).unwrap();
        assert_eq!((study.fit.max_degree, study.modes.count, study.align.method), (15, 10, None));
        assert_eq!(
            Study::parse(&TEMPLATE.replace("# method", "method")).unwrap().align.method,
            Some(Method::Correspond)
        );
        assert_eq!((study.test.len(), study.test[0].effect.as_str()), (1, "group"));
        let other = Study::parse(&template(Some("a \"b\"/s.csv"))).unwrap();
        assert_eq!(other.subjects.table, Path::new("a \"b\"/s.csv"));
        let shortest = "[subjects]\ntable = \"s.tsv\"\n[fit]\nmax_degree = 4\n";
        assert_eq!(Study::parse(shortest).unwrap().output, Path::new("study"));
    }

    #[test]
    fn what_is_wrong_is_named_with_the_nearest_key() {
        for (from, to, expected) in [
            ("max_degree", "max_degre", "unknown key `max_degre` in [fit]: did you mean `max_degree`?"),
            (
                "max_degree = 15",
                "max_degree = 15\nfix = true",
                "to pass an option to spharm fit, write `arguments = [\"--fix\"]`",
            ),
            ("effect =", "effects =", "unknown key `effects` in [[test]]: did you mean `effect`?"),
            ("[modes]", "[mode]", "unknown key `mode`: did you mean `modes`?"),
            ("count =", "colour =", "unknown key `colour` in [modes]: expected one of count"),
            ("table = \"subjects.tsv\"", "", "expected a key `table` in [subjects], found none"),
            ("[fit]\n", "", "in [subjects]"),
            ("[[test]]", "[test]", "expected [[test]]"),
            (
                "max_degree = 15",
                "max_degree = \"15\"",
                "`max_degree`: invalid type: string \"15\", expected a whole number",
            ),
            (
                "# method = \"correspond\"",
                "method = \"jiont\"",
                "`method`: expected \"correspond\", \"joint\", \"fixed\" or \"none\", found \"jiont\"; did you mean \"joint\"?",
            ),
            ("max_degree = 15", "max_degree = ", "line "),
            ("max_degree = 15", "max_degree = 0", "at least 1"),
            ("name = \"group\"", "name = \"../group\"", "letters, digits"),
            ("# tfce = true", "errors = \"normal\"\n#", "expected exchangeable, symmetric or both, found \"normal\""),
            ("# tfce = true", "cluster = 2.0\n#", "above 0 and below 1, found 2"),
            ("# tfce = true", "whole_blocks = true\n#", "whole_blocks: needs `blocks`"),
            ("# tfce = true", "tfce = true\npermutations = 0\n#", "need relabellings"),
        ] {
            assert!(TEMPLATE.contains(from), "{from}");
            let error = format!("{:#}", Study::parse(&TEMPLATE.replace(from, to)).unwrap_err());
            assert!(error.contains(expected) && !error.contains('\n'), "{to}: {error}");
        }
        let twice = TEMPLATE.to_owned() + "[[test]]\nname = \"group\"\neffect = \"age\"\n";
        assert!(Study::parse(&twice).unwrap_err().to_string().contains("twice"));
    }
}
