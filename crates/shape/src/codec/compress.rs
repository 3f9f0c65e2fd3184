//! Compresses models.

use serde_json::{Map, Value};
use spharm_harmonics::Coefficients;
use spharm_model::{Model, Provenance};
use spharm_monitor::{Monitor, OnlyCancel, Stage};
use spharm_surface::Kind;

use crate::extent::{Extent, extent, finite};
use crate::smoothing::keep_penalty;

use super::arithmetic::Encoder;
use super::container::{Head, MOST_CHANNELS, MOST_GUESS, MOST_VALUES, Segment, plausible};
use super::distance::Reference;
use super::error::CodecError;
use super::expand::Level;
use super::quantizer::Quantised;
use super::search::{Trial, search};
use super::stream::Stream;

/// Minimum number of bytes between two default levels, which are the points at which the file may be truncated. Each
/// level has a checksum, and with this minimum the checksums are a negligible part of the file.
const LEAST_LEVEL: usize = 256;

/// Number of quantisation steps tried in the search for the smallest file. Each step is 1 % finer than the previous
/// step.
const COARSE_STEPS: usize = 200;

/// Criterion by which the quantisation step is chosen. Relative lengths of a surface refer to the surface scaled so
/// that its bounding box has volume 1. Relative lengths of a signal are fractions of each channel's standard deviation
/// over the sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Target {
    /// Maximum distance between the surface of the model and the surface of the compressed model, as a relative length
    /// from 1e-8 to 1. The distance is the root mean square distance to the nearest points or the root mean square
    /// displacement along the normal, whichever is larger. The distance reached is usually between 98 % and 100 % of
    /// the maximum. For a signal, the value is the maximum root mean square error.
    Tolerance(f64),
    /// Maximum file size in bytes. If possible, the file size is at least 99.5 % of this maximum.
    Bytes(usize),
    /// Quantisation step of the coefficients, a relative length from 1e-12 to 1.
    Step(f64),
}

/// Settings of the compression.
#[derive(Debug, Clone, PartialEq)]
pub struct CompressParams {
    /// Criterion by which the quantisation step is chosen.
    pub target: Target,
    /// Degrees after which the file may be truncated, in addition to the last degree; degrees that the file doesn't
    /// reach are ignored. By default the degrees 1, 3, 7, 15, 31 and so on, if they end at least 256 bytes after the
    /// preceding level.
    pub levels: Option<Vec<usize>>,
    /// Whether the file contains the model's provenance and scheme key, about 500 bytes; default true.
    pub provenance: bool,
}

impl CompressParams {
    /// Returns parameters with the given target and defaults for the rest.
    #[must_use]
    pub fn new(target: Target) -> Self {
        Self { target, levels: None, provenance: true }
    }
}

/// A compressed model.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Compressed {
    /// Content of the file.
    pub bytes: Vec<u8>,
    /// Root mean square distance between the model and the compressed model, a relative length as in
    /// [`Target::Tolerance`].
    pub distance: f64,
    /// Quantisation step, a relative length as in [`Target::Tolerance`].
    pub step: f64,
    /// Cube root of the volume of the bounding box of the model's surface, in the model's unit; 1 for a signal.
    pub scale: f64,
    /// Size of the file's header in bytes, including the provenance.
    pub head: usize,
    /// Points at which the file may be truncated; the last one is the end of the file.
    pub levels: Vec<Level>,
    /// Highest degree of the compressed model. It is below the original model's degree only if the original model has
    /// more coefficients than the format allows for a file of this size.
    pub max_degree: usize,
}

/// Compresses a model.
///
/// The sphere of the model is lost, and so are the number and order of the vertices that the model was fitted to. The
/// expanded model can be evaluated on any sphere. See the [module](super).
///
/// # Errors
///
/// - [`Parameter`](CodecError::Parameter) if a parameter is out of its range, or no step reaches the tolerance.
/// - [`Shape`](CodecError::Shape) if a coefficient isn't finite, or the surface is a point or a line.
/// - [`Flat`](CodecError::Flat) if the surface lies in a plane.
/// - [`TooLarge`](CodecError::TooLarge) if the model exceeds a limit of the format.
/// - [`TooFine`](CodecError::TooFine) if a coefficient exceeds the largest number of steps.
/// - [`TooFewBytes`](CodecError::TooFewBytes) if the smallest file is larger than [`Target::Bytes`], not counting files
///   whose surface is a point or a line.
/// - [`Interrupted`](CodecError::Interrupted) if the monitor cancels the compression.
pub fn compress(model: &Model, params: &CompressParams, monitor: &dyn Monitor) -> Result<Compressed, CodecError> {
    check(model, params)?;
    let surface = model.kind() == Kind::Surface;
    let reference = Reference::new(&model.coefficients, surface)?;
    let writer = Writer {
        model,
        surface,
        scales: reference.scales(),
        metadata: params.provenance.then(|| metadata(model)).transpose()?,
        levels: params.levels.as_deref(),
    };
    let trials = Trials { writer: &writer, reference: &reference, monitor };
    monitor.begin(Stage::counted("compress", "trials"), 0);
    let step = match params.target {
        Target::Step(step) => step,
        Target::Tolerance(tolerance) => trials.within(tolerance)?,
        Target::Bytes(bytes) => trials.of_size(bytes)?,
    };
    monitor.check()?;
    let quantised = writer.quantise(step)?;
    let file = writer.write(&quantised)?;
    let distance = reference.distance(&quantised.coefficients(), &OnlyCancel(monitor))?;
    monitor.end();
    let scale = if surface { writer.scales[0] } else { 1.0 };
    Ok(Compressed { distance, step, scale, ..file })
}

fn check(model: &Model, params: &CompressParams) -> Result<(), CodecError> {
    let wrong =
        |what, expected: &str, found: String| Err(CodecError::Parameter { what, expected: expected.to_owned(), found });
    match params.target {
        Target::Tolerance(tolerance) if !(1e-8..=1.0).contains(&tolerance) => {
            return wrong("tolerance", "1e-8 to 1", tolerance.to_string());
        }
        Target::Step(step) if !(1e-12..=1.0).contains(&step) => {
            return wrong("step", "1e-12 to 1", step.to_string());
        }
        Target::Bytes(0) => return wrong("bytes", "1 or more", "0".to_owned()),
        _ => {}
    }
    let channels = model.coefficients.channels();
    if channels == 0 {
        return wrong("channels of the model", "1 or more", channels.to_string());
    }
    for (what, most, found) in [
        ("channels of the model", MOST_CHANNELS, channels),
        ("highest degree of the model", spharm_harmonics::MAX_DEGREE, model.coefficients.max_degree()),
        ("coefficients of the model", MOST_VALUES, model.coefficients.values().len()),
    ] {
        if found > most {
            return Err(CodecError::TooLarge { what, most, found });
        }
    }
    finite(&model.coefficients)?;
    if model.kind() == Kind::Surface && extent(&model.coefficients)? == Extent::Flat {
        return Err(CodecError::Flat);
    }
    Ok(())
}

/// Search for the quantisation step that meets a target.
struct Trials<'a> {
    writer: &'a Writer<'a>,
    reference: &'a Reference<'a>,
    monitor: &'a dyn Monitor,
}

impl Trials<'_> {
    fn search(
        &self,
        start: f64,
        rising: bool,
        near: f64,
        excess: impl Fn(f64) -> Result<f64, CodecError>,
    ) -> Result<Option<f64>, CodecError> {
        search(start, rising, near, |step| {
            self.monitor.check()?;
            self.monitor.step(1);
            Ok(Trial { excess: excess(step)?, result: step })
        })
    }

    /// Returns the coarsest step found at which the distance from the original model is at most `tolerance`.
    fn within(&self, tolerance: f64) -> Result<f64, CodecError> {
        /// Maximum number of times that the estimated distance is corrected by the measured distance. Two corrections
        /// are enough for most models.
        const ROUNDS: usize = 8;
        let (mut start, mut aim, mut best) = (0.2 * tolerance, tolerance, None);
        for _ in 0..ROUNDS {
            let excess =
                |step: f64| Ok((self.reference.estimate(&self.writer.quantise(step)?.coefficients())? / aim).ln());
            let Some(step) = self.search(start, true, 0.003, excess)? else { break };
            let quantised = self.writer.quantise(step)?.coefficients();
            let distance = self.reference.distance(&quantised, &OnlyCancel(self.monitor))?;
            if distance <= tolerance {
                best = Some(best.map_or(step, |best: f64| best.max(step)));
                if distance >= 0.98 * tolerance {
                    break;
                }
            }
            // If the compressed surface is a point, its distance is infinite. The target distance of the next search is
            // then halved.
            aim *= if distance.is_finite() && distance > 0.0 { 0.993 * tolerance / distance } else { 0.5 };
            start = step;
        }
        best.ok_or_else(|| CodecError::Parameter {
            what: "tolerance",
            expected: "a tolerance that a quantisation step can reach".to_owned(),
            found: tolerance.to_string(),
        })
    }

    /// Returns the finest step found whose file has at most `bytes` bytes.
    fn of_size(&self, bytes: usize) -> Result<f64, CodecError> {
        let excess = |step: f64| match self.writer.quantise(step) {
            Ok(quantised) => Ok((self.writer.write(&quantised)?.bytes.len() as f64 / bytes as f64).ln()),
            Err(CodecError::TooFine { .. }) => Ok(f64::INFINITY),
            Err(error) => Err(error),
        };
        match self.search(1e-3, false, 0.005, excess)? {
            Some(step) if self.writer.has_extent(&self.writer.quantise(step)?) => Ok(step),
            _ => self.of_least_size(bytes),
        }
    }

    /// Tries a series of very coarse steps, and returns the finest of these steps whose file has at most `bytes` bytes.
    /// The smallest files contain few nonzero values, so their size changes in jumps. The general search may miss such
    /// a jump.
    fn of_least_size(&self, bytes: usize) -> Result<f64, CodecError> {
        let (mut found, mut least, mut tried) = (None, None, 0);
        let mut step = self.writer.coarsest();
        while tried < COARSE_STEPS {
            self.monitor.check()?;
            let quantised = self.writer.quantise(step)?;
            if self.writer.has_extent(&quantised) {
                let file = self.writer.write(&quantised)?;
                let size = (file.bytes.len(), file.head);
                found = if size.0 <= bytes { Some(step) } else { found };
                least = Some(least.map_or(size, |least: (usize, usize)| least.min(size)));
                tried += 1;
            }
            step *= 0.99;
        }
        let (least, of_which) = least.unwrap_or_default();
        found.ok_or(CodecError::TooFewBytes { wanted: bytes, least, of_which })
    }
}

/// Returns the metadata that an expansion restores, as JSON. Settings and distances of the fit are omitted, because
/// they don't apply to the compressed model. The only setting kept is the smoothing penalty, if any.
fn metadata(model: &Model) -> Result<String, CodecError> {
    let parameter = |error: serde_json::Error| CodecError::Parameter {
        what: "provenance of the model",
        expected: "values that JSON can represent".to_owned(),
        found: error.to_string(),
    };
    let tool = Some("shape compress".to_owned());
    let mut provenance =
        Provenance { tool, settings: None, distances: None, surface_rms: None, ..model.provenance.clone() };
    keep_penalty(model.provenance.settings.as_ref(), &mut provenance.other);
    let value = serde_json::to_value(provenance).map_err(parameter)?;
    let mut object = Map::from_iter([("provenance".to_owned(), value)]);
    if let Some(key) = &model.scheme_key {
        object.insert("scheme_key".to_owned(), Value::from(key.as_str()));
    }
    Ok(Value::Object(object).to_string())
}

/// Writes files of one model, with any quantisation step.
struct Writer<'a> {
    model: &'a Model,
    surface: bool,
    scales: Vec<f64>,
    metadata: Option<String>,
    levels: Option<&'a [usize]>,
}

impl Writer<'_> {
    /// Quantises the model with a relative step.
    fn quantise(&self, step: f64) -> Result<Quantised, CodecError> {
        let steps = self.scales.iter().map(|scale| scale * step).collect();
        Quantised::new(self.model.coefficients.values().view(), steps)
    }

    /// Returns a relative step at which all coefficients above degree 0 are rounded to 0: twice the largest relative
    /// magnitude of these coefficients.
    fn coarsest(&self) -> f64 {
        let values = self.model.coefficients.values().indexed_iter().skip(self.model.coefficients.channels());
        let relative = values.map(|((_, channel), value)| value.abs() / self.scales[channel % self.scales.len()]);
        let largest = relative.fold(0.0, f64::max);
        if largest > 0.0 { 2.0 * largest } else { 1.0 }
    }

    /// Returns whether quantised coefficients still describe a surface and not a point or a line; always true for a
    /// signal.
    fn has_extent(&self, quantised: &Quantised) -> bool {
        !self.surface || Coefficients::new(quantised.coefficients()).is_ok_and(|found| extent(&found).is_ok())
    }

    /// Creates the compressed file, without the distance, step and scale, which the caller fills in.
    fn write(&self, quantised: &Quantised) -> Result<Compressed, CodecError> {
        let channels = quantised.first.len();
        let top = quantised.top();
        let first: f64 = quantised.values.iter().take(4 * channels).map(|value| f64::from(value.unsigned_abs())).sum();
        let mean = first / (3 * channels) as f64;
        let guess = mean.max(1.0).log2().round().min(f64::from(MOST_GUESS)) as u32;
        let (mut stream, mut encoder) = (Stream::new(channels, guess), Encoder::new());
        let mut values = quantised.values.clone();
        let mut ends = Vec::new();
        for degree in 1..=top {
            // Writing never fails; only a decoder can run out of data.
            let _ = stream.degree(&mut values, &mut encoder);
            let last = ends.last().map_or(0, |&(_, end)| end);
            let wanted = match self.levels {
                Some(levels) => levels.contains(&degree),
                None => (degree + 1).is_power_of_two() && encoder.reach() >= last + LEAST_LEVEL,
            };
            if wanted && degree < top {
                ends.push((degree, encoder.reach()));
            }
        }
        let bytes = encoder.finish();
        // Coding a degree may add no byte to the stream, so an earlier level may end where the stream ends. Such a
        // level equals the last level, which is added below, so it is removed.
        ends.retain(|&(_, end)| end < bytes.len());
        if top > 0 {
            ends.push((top, bytes.len()));
        }
        let mut start = 0;
        let segments = ends.iter().map(|&(degree, end)| {
            let part = &bytes[start..end];
            start += part.len();
            Segment { degree, length: part.len(), crc: crc32c::crc32c(part) }
        });
        let mut head = Head {
            surface: self.surface,
            max_degree: self.model.coefficients.max_degree(),
            channels,
            top,
            guess,
            shifts: quantised.shifts,
            steps: quantised.steps.clone(),
            first: quantised.first.clone(),
            metadata: self.metadata.clone(),
            segments: segments.collect(),
        };
        let mut file = head.write()?;
        while !plausible(head.max_degree, top, channels, file.len() + bytes.len()) && head.max_degree > top {
            head.max_degree -= 1;
            file = head.write()?;
        }
        let length = file.len();
        let levels = Level::all(&head, length);
        file.extend(bytes);
        let (distance, step, scale) = (f64::NAN, f64::NAN, f64::NAN);
        Ok(Compressed { bytes: file, distance, step, scale, head: length, levels, max_degree: head.max_degree })
    }
}
