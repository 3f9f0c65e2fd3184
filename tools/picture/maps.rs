//! Reads the maps on the first surface: values on its vertices, shown as colours or as a contour.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::Value;
use spharm_cli::console::Console;
use spharm_cli::inputs::{read_text, stem};
use spharm_cli::output::counted;
use spharm_monitor::number;
use spharm_render::{Contour, is_probability, scale_label, significance, symmetric_range};
use spharm_surface::Mesh;
use spharm_surface::io::read_signal;

use super::args::Cli;

/// Maximum size in bytes of the description of a test.
const LARGEST_DESCRIPTION: u64 = 64 << 20;
/// Default level of contours of p values.
const LEVEL: f64 = 0.05;

/// Contents of a picture: surfaces, maps on the first surface, and the map whose contour line is drawn.
pub(super) struct Content {
    pub(super) surfaces: Vec<PathBuf>,
    pub(super) maps: Vec<MapFile>,
    pub(super) contour: Option<MapFile>,
    /// Value along the contour; `None` for the default.
    pub(super) level: Option<f64>,
}

/// A file of one value per vertex of the first surface.
pub(super) struct MapFile {
    pub(super) path: PathBuf,
    /// Text beneath the panel.
    pub(super) caption: String,
    /// Name of the values, shown beneath the colour scale.
    label: String,
    /// Whether the colours are symmetric about 0, even if no value is negative.
    signed: bool,
}

impl Content {
    /// Returns the contents of the picture that the arguments request.
    pub(super) fn of(cli: &Cli) -> Result<Self> {
        if let Some(folder) = &cli.test {
            return Self::of_test(folder).with_context(|| format!("--test {}", folder.display()));
        }
        Ok(Self {
            surfaces: cli.surfaces.clone(),
            maps: cli.map.iter().map(|path| MapFile::new(path)).collect(),
            contour: cli.contour.as_deref().map(MapFile::new),
            level: cli.contour_level,
        })
    }

    /// Returns the result of `spharm shape test` in a folder: the mean, the effect, the statistic and the p values,
    /// with a line at the test's level. A test of several contrasts has no map of an effect.
    fn of_test(folder: &Path) -> Result<Self> {
        let path = folder.join("test.json");
        let text = read_text(&path, "description of a test", LARGEST_DESCRIPTION)
            .context("expected a folder written by `spharm shape test`")?;
        let about: Value = serde_json::from_str(&text).context("test.json isn't JSON")?;
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let (tested, statistic) = (text(&about["tested"]), text(&about["statistic"]["name"]));
        let outward = if about["signal"] == "normal" { ", positive outward" } else { "" };
        let file = |name: &str| {
            let files = ["shape.gii", "mgh"].map(|ending| folder.join(format!("{name}.{ending}")));
            files.into_iter().find(|path| path.is_file())
        };
        // The statistics t and v have a sign. Other statistics, such as F, are never negative.
        let has_sign = |name: &str| name == "effect" || name == "statistic" && ["t", "v"].contains(&statistic.as_str());
        let map = |name: &str, caption: &str, label: String| {
            file(name).map(|path| MapFile { path, caption: caption.to_owned(), label, signed: has_sign(name) })
        };
        let names = [("p-tfce", "family-wise p of TFCE"), ("p-fwe", "family-wise p"), ("q", "false discovery rate q")];
        let p = || names.iter().find_map(|(name, label)| map(name, label, (*label).to_owned()));
        let effect = map("effect", "effect", format!("{tested}{outward}"));
        let of_statistic = map("statistic", &statistic, format!("{statistic} of {tested}"));
        if of_statistic.is_none() {
            bail!("expected maps written by `spharm shape test`, found no statistic.shape.gii");
        }
        Ok(Self {
            surfaces: vec![folder.join("mean.surf.gii")],
            maps: [effect, of_statistic, p()].into_iter().flatten().collect(),
            contour: p(),
            level: about["level"].as_f64(),
        })
    }
}

impl MapFile {
    fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), caption: stem(path), label: stem(path), signed: false }
    }

    /// Returns whether the values are p values or false-discovery rates, judging by the file's name.
    fn is_probability(&self) -> bool {
        is_probability(&stem(&self.path))
    }

    /// Reads a map to be shown in colours.
    pub(super) fn read(self, surface: &Mesh, range: Option<(f64, f64)>) -> Result<Coloured> {
        let values = read_map(&self.path, surface)?;
        // p values are shown as -log10 p, so that the smallest p values get the colours at the upper end of the scale,
        // as on pages made by `spharm report`.
        let (values, own) = if self.is_probability() {
            significance(&values)
        } else {
            let range = if self.signed { symmetric_range(&values) } else { range_of(&values) };
            (values, range)
        };
        let range = range.unwrap_or(own);
        let label = scale_label(&self.label, self.is_probability(), &values, range);
        Ok(Coloured { values, range, label, caption: self.caption })
    }
}

/// A map to be shown in colours.
pub(super) struct Coloured {
    pub(super) values: Vec<f64>,
    /// Values at the lower and the upper end of the colour scale.
    pub(super) range: (f64, f64),
    /// Text beneath the colour scale.
    pub(super) label: String,
    /// Text beneath the panel.
    pub(super) caption: String,
}

/// A map, and the value along the contour to draw. For a map of p values, the values and the contour's value are -log10
/// p.
pub(super) struct ContourMap {
    pub(super) values: Vec<f64>,
    level: f64,
    label: String,
    /// Value along the contour, as the user gave it, without conversion to -log10.
    stated: f64,
    /// Number of values that are at most `stated`.
    at_most: usize,
    /// Range of the map's values, in the unit of `stated`.
    range: (f64, f64),
}

impl ContourMap {
    /// Reads a map, and warns if the map has no contour line at the level.
    pub(super) fn read(map: MapFile, level: Option<f64>, surface: &Mesh, console: &Console) -> Result<Self> {
        let path = map.path.display();
        let values = read_map(&map.path, surface)?;
        let range = values.iter().fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(*x), high.max(*x)));
        let stated = level.unwrap_or(LEVEL);
        let at_most = values.iter().filter(|value| **value <= stated).count();
        let (values, level) = match (level, map.is_probability()) {
            (None, false) => bail!("{path}: --contour-level is required for maps other than p values"),
            (Some(level), true) if !(level > 0.0 && level < 1.0) => {
                bail!("--contour-level: expected a value between 0 and 1 for p values ({path}), found {level}")
            }
            (Some(level), false) => (values, level),
            (_, true) => (significance(&values).0, -stated.log10()),
        };
        let contour = Self { values, level, stated, at_most, range, label: map.label.clone() };
        if contour.line().is_none() {
            let (low, high) = contour.range;
            let (low, high) = (number(low), number(high));
            console.warn(format!(
                "{path}: the picture has no contour line at {stated}, because all values are between {low} and {high}"
            ));
        }
        Ok(contour)
    }

    /// Returns the line to draw, if the map has values on both sides of the level.
    pub(super) fn line(&self) -> Option<Contour<'_>> {
        let crosses =
            self.values.iter().any(|value| *value < self.level) && self.values.iter().any(|value| *value >= self.level);
        crosses.then_some(Contour { values: &self.values, level: self.level })
    }

    /// Returns the text beneath the picture. The contour line may surround the vertices with higher values or those
    /// with lower values, so the text also states how many vertices have the lower values.
    pub(super) fn note(&self) -> String {
        let (label, stated) = (&self.label, self.stated);
        if self.line().is_some() {
            format!("line: {label} = {stated}; at most {stated} at {} of {} vertices", self.at_most, self.values.len())
        } else {
            let (low, high) = self.range;
            let side = if low > stated { "above" } else { "at most" };
            format!("no contour line: {label} is {side} {stated} everywhere ({} to {})", number(low), number(high))
        }
    }
}

/// Reads values on a surface's vertices.
fn read_map(path: &Path, surface: &Mesh) -> Result<Vec<f64>> {
    let signal = read_signal(path)?;
    let (vertices, found) = (surface.vertices.len(), (signal.vertices, signal.channels));
    if found != (vertices, 1) {
        bail!(
            "{}: expected one value for each of the {vertices} vertices, found {} for each of {} vertices",
            path.display(),
            counted(found.1, "value"),
            found.0
        );
    }
    match signal.values.iter().position(|value| !value.is_finite()) {
        Some(vertex) => bail!("{}: vertex {vertex} has no finite value", path.display()),
        None => Ok(signal.values),
    }
}

/// Returns the range of the colours: symmetric about 0 if there are negative values, otherwise from the minimum to the
/// maximum.
pub(super) fn range_of(values: &[f64]) -> (f64, f64) {
    let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(*x), high.max(*x)));
    if low < 0.0 {
        return symmetric_range(values);
    }
    if low < high { (low, high) } else { (low, low + f64::MIN_POSITIVE.max(low.abs())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_note_tells_how_many_values_are_beyond_the_line() {
        let (p, label) = ([0.01, 0.02, 0.03, 0.5], "p-fwe".to_owned());
        let values = significance(&p).0;
        let map = ContourMap { values, level: -LEVEL.log10(), label, stated: LEVEL, at_most: 3, range: (0.01, 0.5) };
        assert_eq!(map.note(), "line: p-fwe = 0.05; at most 0.05 at 3 of 4 vertices");
    }
}
