//! Parses contrasts: linear combinations of a design's columns, such as `patient - control`.
//!
//! A contrast is a sum of terms `WEIGHT NAME`, `WEIGHT * NAME` or `NAME`, with signs between them. Weights are numbers
//! or fractions such as `1/3`. Names may contain spaces, signs and digits. If several names match, the longest name is
//! used. A name may be in double quotes. It must be in double quotes if it can also be read as a combination of other
//! columns, such as a level `a - b` in a design with levels `a` and `b`.

use ndarray::Array2;

use super::design::{Contrast, Design};
use crate::ShapeError;

impl Design {
    /// Parses a contrast from its rows, each of which is a combination of the design's columns, such as
    /// `patient - control` or `0.5 mild + 0.5 severe - control`.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Contrast`] if a row isn't such a combination, is zero, or has a name that two columns share;
    /// [`ShapeError::NoColumn`] if a name isn't a column of the design; [`ShapeError::AmbiguousName`] if a name without
    /// double quotes is also a combination of other columns.
    ///
    /// ```
    /// use spharm_shape::stats::Design;
    /// let design = Design::groups(&[2, 2, 2])?;
    /// let contrast = design.contrast(&["group 1 - 1/2 group 2 - 0.5*group 3"])?;
    /// assert_eq!(contrast.weights, ndarray::array![[1.0, -0.5, -0.5]]);
    /// # Ok::<(), spharm_shape::ShapeError>(())
    /// ```
    pub fn contrast(&self, rows: &[impl AsRef<str>]) -> Result<Contrast, ShapeError> {
        let names = self.names();
        let mut weights = Array2::zeros((rows.len(), names.len()));
        for (text, mut weights) in rows.iter().zip(weights.rows_mut()) {
            for (weight, column) in summands(text.as_ref(), names)? {
                weights[column] += weight;
            }
            if weights.iter().all(|weight| *weight == 0.0) {
                let expected = "a combination of columns with at least one nonzero weight";
                return Err(ShapeError::Contrast { expected, found: format!("{:?}", text.as_ref()) });
            }
        }
        Ok(Contrast { weights })
    }
}

/// Parses the summands of one row, and returns the weight and the column of each.
fn summands(text: &str, names: &[String]) -> Result<Vec<(f64, usize)>, ShapeError> {
    let mut rest = text.trim();
    let mut found = Vec::new();
    while !rest.is_empty() || found.is_empty() {
        let mut sign = 1.0;
        // A name may begin with a sign, so at the start of the text a name takes precedence over a sign.
        if !(found.is_empty() && column_at(rest, names).is_some()) {
            let signed = rest.strip_prefix(SIGNS);
            if signed.is_none() && !found.is_empty() {
                return Err(malformed(text, names));
            }
            sign = if rest.starts_with(['-', '\u{2212}']) { -1.0 } else { 1.0 };
            rest = signed.unwrap_or(rest).trim_start();
        }
        // Try to parse a column's name before a weight, because names of levels may be numbers.
        let (weight, named) = match column_at(rest, names) {
            Some(_) => (1.0, rest),
            None => weight_at(rest).unwrap_or((1.0, rest)),
        };
        let Some((column, left)) = column_at(named, names) else {
            let unknown = name_at(named);
            if unknown.is_empty() {
                return Err(malformed(text, names));
            }
            return Err(ShapeError::NoColumn { found: unknown.to_owned(), columns: names.to_vec() });
        };
        if names.iter().filter(|name| **name == names[column]).count() > 1 {
            let found = format!("{:?}, the name of two columns", names[column]);
            return Err(ShapeError::Contrast { expected: "names that occur only once in the design", found });
        }
        if named.starts_with(&names[column]) && is_combination(&names[column], names) {
            return Err(ShapeError::AmbiguousName { name: names[column].clone(), found: text.to_owned() });
        }
        found.push((sign * weight, column));
        rest = left;
    }
    Ok(found)
}

/// Signs allowed between summands.
const SIGNS: [char; 3] = ['+', '-', '\u{2212}'];

fn malformed(text: &str, names: &[String]) -> ShapeError {
    ShapeError::Contrast {
        expected: "a combination of columns of the design, such as \"patient - control\" or \"0.5 a + 0.5 b - c\"",
        found: format!("{text:?}; the columns are {}", names.join(", ")),
    }
}

/// Returns whether a column's name is also a combination of two or more other columns.
fn is_combination(name: &str, names: &[String]) -> bool {
    let others: Vec<String> = names.iter().filter(|other| *other != name).cloned().collect();
    match summands(name, &others) {
        Ok(found) => found.len() > 1,
        Err(error) => matches!(error, ShapeError::AmbiguousName { .. }),
    }
}

/// Returns the unknown name at the start of the text, without its quotes.
fn name_at(text: &str) -> &str {
    if let Some((name, _)) = text.strip_prefix('"').and_then(|rest| rest.split_once('"')) {
        return name.trim();
    }
    let end = [" - ", " + "].into_iter().filter_map(|sign| text.find(sign)).min().unwrap_or(text.len());
    text[..end].trim()
}

/// Finds the column whose name, with or without double quotes, is at the start of the text and is followed by a sign or
/// the end of the text. If several columns match, the column with the longest name is returned. Returns the column and
/// the text after its name.
fn column_at<'a>(text: &'a str, names: &[String]) -> Option<(usize, &'a str)> {
    let candidates = names.iter().enumerate().filter_map(|(column, name)| {
        let quoted = || text.strip_prefix('"')?.strip_prefix(name.as_str())?.strip_prefix('"');
        let rest = text.strip_prefix(name.as_str()).or_else(quoted)?.trim_start();
        (rest.is_empty() || rest.starts_with(SIGNS)).then_some((name.len(), column, rest))
    });
    candidates.max_by_key(|(length, ..)| *length).map(|(_, column, rest)| (column, rest))
}

/// Parses the number or fraction at the start of the text. Returns the number and the rest of the text, without a
/// leading asterisk.
fn weight_at(text: &str) -> Option<(f64, &str)> {
    let end = text.find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '/'))).unwrap_or(text.len());
    let weight = match text[..end].split_once('/') {
        Some((over, under)) => over.parse::<f64>().ok()? / under.parse::<f64>().ok()?,
        None => text[..end].parse().ok()?,
    };
    let rest = text[end..].trim_start();
    weight.is_finite().then(|| (weight, rest.strip_prefix('*').unwrap_or(rest).trim_start()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str, names: &[&str]) -> Result<Vec<(f64, usize)>, String> {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        summands(text, &names).map_err(|error| error.to_string())
    }

    #[test]
    fn combinations_of_names_are_parsed() {
        let names = ["a", "b", "non-responder", "site y", "1", "2", "a:age"];
        assert_eq!(parsed("a-b", &names).unwrap(), [(1.0, 0), (-1.0, 1)]);
        assert_eq!(parsed("-1/2a + 0.5 * b", &names).unwrap(), [(-0.5, 0), (0.5, 1)]);
        assert_eq!(parsed("non-responder - a", &names).unwrap(), [(1.0, 2), (-1.0, 0)]);
        assert_eq!(parsed("2 site y", &names).unwrap(), [(2.0, 3)]);
        assert_eq!(parsed("1 - 2", &names).unwrap(), [(1.0, 4), (-1.0, 5)]);
        assert_eq!(parsed("3 2", &names).unwrap(), [(3.0, 5)]);
        assert_eq!(parsed("a:age", &names).unwrap(), [(1.0, 6)]);
        let signed = ["-1", "0", "1", "+/-", "+/+"];
        assert_eq!(parsed("-1 - 1", &signed).unwrap(), [(1.0, 0), (-1.0, 2)]);
        assert_eq!(parsed("1 - -1", &signed).unwrap(), [(1.0, 2), (-1.0, 0)]);
        assert_eq!(parsed("+/- - +/+", &signed).unwrap(), [(1.0, 3), (-1.0, 4)]);
    }

    #[test]
    fn names_that_are_also_combinations_need_quotes() {
        let names = ["a", "b", "a - b", "c+d", "c"];
        for text in ["a - b", "c - a - b", "2 a - b"] {
            let found = parsed(text, &names).unwrap_err();
            assert!(found.contains("\"a - b\" is the name of a column and also a combination"), "{found}");
        }
        assert_eq!(parsed("\"a - b\" - c", &names).unwrap(), [(1.0, 2), (-1.0, 4)]);
        assert_eq!(parsed("\"a\" - \"b\"", &names).unwrap(), [(1.0, 0), (-1.0, 1)]);
        assert_eq!(parsed("b - 1/2 \"a - b\"", &names).unwrap(), [(1.0, 1), (-0.5, 2)]);
        assert_eq!(parsed("c+d - c", &names).unwrap(), [(1.0, 3), (-1.0, 4)], "d isn't a column");
        assert!(parsed("\"d - e\" - c", &names).unwrap_err().contains("found \"d - e\""));
    }

    #[test]
    fn other_text_is_refused_by_what_is_wrong() {
        for text in ["", "  ", "a -", "+", "a - 3"] {
            assert!(parsed(text, &["a", "b"]).unwrap_err().contains("expected a combination"), "{text:?}");
        }
        let found = parsed("a - patient", &["a", "b"]).unwrap_err();
        assert!(found.contains("\"patient\"") && found.contains("a, b"), "{found}");
        assert!(parsed("a b", &["a", "b"]).unwrap_err().contains("\"a b\""));
        assert!(parsed("patient + a - b", &["a", "b"]).unwrap_err().contains("found \"patient\""));
        assert!(parsed("a - b", &["a", "b", "a"]).unwrap_err().contains("two columns"));
    }
}
