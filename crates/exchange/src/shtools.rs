//! Reads and writes SHTOOLS' text files, one file per channel, with lines `l, m, C_lm, S_lm` for m from 0 to l.
//!
//! pyshtools reads these files with `SHCoeffs.from_file(.., normalization="ortho", csphase=1)`. The files don't state
//! their convention.

use std::io::{self, Write};

use spharm_harmonics::Coefficients;
use spharm_harmonics::index::{column, degree_order};

use crate::flaw::Flaw;
use crate::format::Normalization;
use crate::text::{number, quoted, text};

/// Maximum degree accepted in a file. This limit is far above the degrees that this library can evaluate.
const HIGHEST: usize = 20_000;

pub(crate) fn write(
    out: &mut dyn Write,
    a: &Coefficients,
    channel: usize,
    normalization: Normalization,
) -> io::Result<()> {
    let value = |l: usize, m: isize| normalization.factor(l, m.unsigned_abs()) * a.values()[[column(l, m), channel]];
    for l in 0..=a.max_degree() {
        for m in 0..=l.cast_signed() {
            let sine = if m == 0 { 0.0 } else { value(l, -m) };
            writeln!(out, "{l}, {m}, {:.16e}, {sine:.16e}", value(l, m))?;
        }
    }
    Ok(())
}

/// Reads the coefficients of one channel. Non-numeric lines before the first coefficient are skipped as a header. Every
/// order of the degrees from the lowest to the highest in the file must occur exactly once, because a missing order
/// indicates lost data. The lowest degree need not be 0, because other programs omit degree 0 if its coefficient is 0.
pub(crate) fn read(bytes: &[u8], normalization: Normalization) -> Result<Vec<f64>, Flaw> {
    let mut found: Vec<(usize, usize, [f64; 2])> = Vec::new();
    for (line, text) in text(bytes)?.lines().enumerate() {
        let words: Vec<&str> = words_of(text).collect();
        let Some((l, m)) = degree_and_order(&words) else {
            if found.is_empty() || words.is_empty() || text.trim_start().starts_with('#') {
                continue;
            }
            return Err(Flaw::new(format!("a degree and an order on line {}", line + 1), quoted(text)));
        };
        // Columns after the fourth are the coefficients' errors, which are ignored; see `has_errors`.
        let [_, _, cosine, sine, ..] = words[..] else {
            if found.is_empty() {
                continue;
            }
            return Err(Flaw::new(format!("l, m, C, S on line {}", line + 1), quoted(text)));
        };
        if m > l || l > HIGHEST {
            return Err(Flaw::new(
                format!("a degree up to {HIGHEST} and an order up to this degree on line {}", line + 1),
                quoted(text),
            ));
        }
        found.push((l, m, [number(cosine, line + 1)?, number(sine, line + 1)?]));
    }
    let highest = found.iter().map(|&(l, ..)| l).max();
    let highest = highest.ok_or_else(|| match is_gfc(text(bytes).unwrap_or_default()) {
        true => Flaw::Other {
            found: "a gravity model in ICGEM's .gfc format",
            remedy: "read it with pyshtools.shio.read_icgem_gfc, save the coefficients with numpy.save, and import the \
                     .npy file with --normalization 4pi",
        },
        false => Flaw::new("lines with l, m, C, S", "none"),
    })?;
    // A single line may state a high degree, so allocate memory only if the file has at least as many lines as this
    // degree.
    if found.len() < highest {
        return Err(Flaw::new(format!("lines up to degree {highest}"), format!("{} lines", found.len())));
    }
    check_whole(&found, highest)?;
    let mut values = vec![0.0; (highest + 1) * (highest + 1)];
    for (l, m, [cosine, sine]) in found {
        let factor = normalization.factor(l, m);
        let at = column(l, m.cast_signed());
        if let Some(value) = values.get_mut(at) {
            *value = cosine / factor;
        }
        if let Some(value) = values.get_mut(at - 2 * m).filter(|_| m > 0) {
            *value = sine / factor;
        }
    }
    debug_assert_eq!(degree_order(values.len() - 1).0, highest);
    Ok(values)
}

/// Rejects coefficients if an order occurs twice or is missing; an order may be missing if the file is truncated.
fn check_whole(found: &[(usize, usize, [f64; 2])], highest: usize) -> Result<(), Flaw> {
    let mut orders: Vec<(usize, usize)> = found.iter().map(|&(l, m, _)| (l, m)).collect();
    orders.sort_unstable();
    if let Some(twice) = orders.windows(2).find(|pair| pair[0] == pair[1]) {
        let (l, m) = twice[0];
        return Err(Flaw::new("each degree and order once", format!("degree {l}, order {m} twice")));
    }
    let lowest = orders.first().map_or(0, |&(l, _)| l);
    let mut wanted = (lowest..=highest).flat_map(|l| (0..=l).map(move |m| (l, m)));
    let mut there = orders.iter().copied();
    match wanted.find(|&pair| there.next() != Some(pair)) {
        None => Ok(()),
        Some((l, m)) => Err(Flaw::new(
            format!("every order of the degrees {lowest} to {highest}"),
            format!("no coefficient of degree {l}, order {m}; the file may be truncated"),
        )),
    }
}

/// Returns the words of a line, which are separated by blanks or commas.
fn words_of(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty())
}

/// Returns whether the lines have further columns after l, m, C and S. These columns are the errors of the
/// coefficients, as written by pyshtools' `to_file(.., errors=True)`.
pub(crate) fn has_errors(bytes: &[u8]) -> bool {
    let last = text(bytes).ok().and_then(|text| text.lines().rev().find(|line| !line.trim().is_empty()));
    last.is_some_and(|line| !line.trim_start().starts_with('#') && words_of(line).count() > 4)
}

/// Returns whether a file's text has coefficients in ICGEM's `.gfc` format: lines `gfc l m C S`.
pub(crate) fn is_gfc(text: &str) -> bool {
    text.lines().any(|line| {
        let words: Vec<&str> = line.split_whitespace().take(3).collect();
        words.first() == Some(&"gfc") && degree_and_order(words.get(1..).unwrap_or_default()).is_some()
    })
}

/// Returns whether one of the first lines of a file's text consists of a degree, an order and two numbers. If the file
/// states errors of the coefficients, the line has four numbers instead of two.
pub(crate) fn is_shtools(text: &str) -> bool {
    let lines = text.lines().take(4).filter(|line| !line.trim_start().starts_with('#'));
    lines.map(|line| words_of(line).collect()).any(|words: Vec<&str>| {
        degree_and_order(&words).is_some_and(|(l, m)| m <= l)
            && [4, 6].contains(&words.len())
            && words.iter().skip(2).all(|word| number(word, 0).is_ok())
    })
}

fn degree_and_order(words: &[&str]) -> Option<(usize, usize)> {
    let [degree, order, ..] = words else { return None };
    Some((degree.parse().ok()?, order.parse().ok()?))
}
