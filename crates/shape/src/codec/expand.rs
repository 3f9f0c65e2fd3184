//! Expands compressed models.

use serde_json::{Map, Value, json};
use spharm_harmonics::{Coefficients, basis_size};
use spharm_model::{Fitted, Model, Provenance};
use spharm_surface::Kind;

use super::arithmetic::Decoder;
use super::container::{Head, Parsed};
use super::error::CodecError;
use super::quantizer::Quantised;
use super::stream::Stream;

/// Name of the provenance field that lists the operations applied to a model.
const TRANSFORM: &str = "transform";

/// Settings of the expansion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ExpandParams {
    /// Highest degree of the expanded model. By default, or if the file has a lower degree, all degrees of the file are
    /// expanded.
    pub max_degree: Option<usize>,
    /// Whether the bytes may be a prefix of a file. The complete levels of a prefix are expanded. False by default: a
    /// truncated file is then an error.
    pub prefix: bool,
}

/// A point at which a file may be truncated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Level {
    /// Highest degree of the model that the preceding bytes contain.
    pub degree: usize,
    /// Number of preceding bytes.
    pub bytes: usize,
}

impl Level {
    pub(super) fn all(head: &Head, length: usize) -> Vec<Self> {
        let mut bytes = length;
        let each = head.segments.iter().map(|segment| {
            bytes += segment.length;
            Self { degree: segment.degree, bytes }
        });
        let levels: Vec<Self> = each.collect();
        // The complete file contains all degrees: the coefficients above the stream's highest degree are zero.
        let whole = Self { degree: head.max_degree, bytes };
        levels.iter().rev().skip(1).rev().copied().chain([whole]).collect()
    }
}

/// An expanded model.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Expanded {
    /// The model, without a sphere. If the file contains the original model's provenance, the expanded model has the
    /// same provenance without the settings and distances of the fit. The last entry of the provenance's `transform` is
    /// `compressed`. This entry has the version of the format, the number of bytes, and the steps in the model's unit.
    pub model: Model,
    /// Points at which the file may be truncated.
    pub levels: Vec<Level>,
    /// Number of bytes of the file that were expanded.
    pub bytes: usize,
}

/// Expands a file, or a prefix of a file.
///
/// Checksums of all bytes used are verified first. Memory grows with the content of the stream, not with the sizes
/// that the header declares.
///
/// # Errors
///
/// - [`Magic`](CodecError::Magic) if the bytes aren't a compressed model.
/// - [`Version`](CodecError::Version) if the version of the format isn't supported.
/// - [`Damaged`](CodecError::Damaged) if the bytes violate the format, or a checksum differs.
/// - [`CutOff`](CodecError::CutOff) if the file is truncated, unless a prefix is allowed and contains a complete level.
pub fn expand(bytes: &[u8], params: &ExpandParams) -> Result<Expanded, CodecError> {
    let Parsed { head, length } = Head::read(bytes)?;
    let levels = Level::all(&head, length);
    let whole = levels.last().map_or(length, |level| level.bytes);
    let there = levels.iter().rfind(|level| level.bytes <= bytes.len()).copied();
    if bytes.len() > whole {
        return Err(CodecError::damaged("length", format!("{whole} bytes"), bytes.len()));
    }
    let found = bytes.len();
    let level = match there {
        Some(level) if params.prefix || level.bytes == whole => level,
        Some(level) => return Err(CodecError::CutOff { expected: whole, found, level: Some(level.degree) }),
        None => {
            let expected = if params.prefix { levels.first().map_or(whole, |level| level.bytes) } else { whole };
            return Err(CodecError::CutOff { expected, found, level: None });
        }
    };
    let stream = checked(&head, &bytes[length..level.bytes])?;
    let degree = level.degree.min(params.max_degree.unwrap_or(usize::MAX));
    let quantised = read(&head, stream, degree)?;
    let model = restore(&head, &quantised, level.bytes)?;
    Ok(Expanded { model, levels, bytes: level.bytes })
}

/// Verifies the checksums of the segments that are complete, and returns the stream unchanged.
fn checked<'a>(head: &Head, stream: &'a [u8]) -> Result<&'a [u8], CodecError> {
    let mut rest = stream;
    for segment in &head.segments {
        let Some((part, after)) = rest.split_at_checked(segment.length) else { break };
        let found = crc32c::crc32c(part);
        if found != segment.crc {
            let (expected, found) = (format!("{:08x}", segment.crc), format!("{found:08x}"));
            return Err(CodecError::damaged("checksum of a level", expected, found));
        }
        rest = after;
    }
    Ok(stream)
}

/// Reads the quantised coefficients up to a degree.
fn read(head: &Head, bytes: &[u8], degree: usize) -> Result<Quantised, CodecError> {
    let (mut stream, mut decoder) = (Stream::new(head.channels, head.guess), Decoder::new(bytes));
    let mut values = vec![0; head.channels];
    for l in 1..=degree.min(head.top) {
        values.resize(basis_size(l) * head.channels, 0);
        let ended = |_| {
            let expected = format!("degrees up to {}", head.top);
            CodecError::damaged("stream", expected, format!("the end of the stream at degree {l}"))
        };
        stream.degree(&mut values, &mut decoder).map_err(ended)?;
    }
    values.resize(basis_size(degree) * head.channels, 0);
    Ok(Quantised { steps: head.steps.clone(), first: head.first.clone(), shifts: head.shifts, values })
}

fn restore(head: &Head, quantised: &Quantised, bytes: usize) -> Result<Model, CodecError> {
    let values = quantised.coefficients();
    if let Some(value) = values.iter().find(|value| !value.is_finite()) {
        return Err(CodecError::damaged("coefficients", "finite numbers", value));
    }
    let rows = values.nrows();
    let coefficients = Coefficients::new(values)
        .map_err(|_| CodecError::damaged("number of coefficients", "(L + 1)^2 for a degree L", rows))?;
    let (mut provenance, scheme_key) = match &head.metadata {
        Some(text) => described(text)?,
        None => (Provenance::default(), None),
    };
    let steps = if head.surface || head.channels == 1 { Value::from(head.steps[0]) } else { head.steps.clone().into() };
    let compressed = json!({ "compressed": { "format": super::VERSION, "bytes": bytes, "step": steps } });
    match provenance.other.get_mut(TRANSFORM) {
        Some(Value::Array(done)) => done.push(compressed),
        _ => drop(provenance.other.insert(TRANSFORM.to_owned(), Value::Array(vec![compressed]))),
    }
    let kind = if head.surface { Kind::Surface } else { Kind::Signal };
    Ok(Model::without_sphere(Fitted { coefficients, scheme_key, provenance }, kind))
}

fn described(text: &str) -> Result<(Provenance, Option<String>), CodecError> {
    let wrong = |error: serde_json::Error| CodecError::damaged("provenance", "JSON", error);
    let object: Map<String, Value> = serde_json::from_str(text).map_err(wrong)?;
    let provenance = object.get("provenance").map(|value| Provenance::parse(&value.to_string())).unwrap_or_default();
    Ok((provenance, object.get("scheme_key").and_then(Value::as_str).map(str::to_owned)))
}
