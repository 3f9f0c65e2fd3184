//! Creates the section on quality control of a group: a table of the subjects in which flagged values are marked, and
//! a picture of each subject.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use spharm_shape::outliers::FAR;

use crate::ReportError;
use crate::table::{head, numeric};
use crate::text::{escape, name, number};

/// Quality control of a group, from `spharm shape check`.
#[derive(Debug, Clone, Default)]
pub struct Check {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Subjects, in order from worst to best.
    pub subjects: Vec<CheckedSubject>,
    /// Distance between surface and model that the pictures show in red, in the surfaces' unit.
    pub red_at: Option<f64>,
}

/// A subject of a group.
#[derive(Debug, Clone, Default)]
pub struct CheckedSubject {
    /// Id of the subject.
    pub id: String,
    /// State of the subject: `ok`, `flagged`, `accepted`, `failed` or `excluded`.
    pub state: String,
    /// Reasons why the subject is flagged or has no model.
    pub flags: Vec<String>,
    /// Values of the subject, one per column.
    pub cells: Vec<CheckedCell>,
    /// Picture of the surface as PNG, if any.
    pub picture: Option<Vec<u8>>,
    /// Scale of the picture, if known: 1, or less if the surface is larger than the box that all pictures share.
    pub scale: Option<f64>,
}

/// Value of a subject in a column.
#[derive(Debug, Clone, Default)]
pub struct CheckedCell {
    /// Text of the value; empty if unknown.
    pub text: String,
    /// Robust z of the value, if it is compared with the other subjects.
    pub z: Option<f64>,
    /// Whether the value is marked because it is far from the other subjects' values.
    pub far: bool,
}

/// Absolute robust z above which a value is marked more strongly.
const VERY_FAR: f64 = 3.0 * FAR;

/// Scale of a picture below which its caption states the scale.
const SMALLER: f64 = 0.95;

/// Returns the section on quality control as HTML.
pub(crate) fn section(check: &Check) -> Result<String, ReportError> {
    let expected = check.columns.len();
    if let Some((row, subject)) = check.subjects.iter().enumerate().find(|(_, of)| of.cells.len() != expected) {
        let found = subject.cells.len();
        return Err(ReportError::Cells { name: "quality control".to_owned(), row: row + 1, expected, found });
    }
    let count = |state: &str| check.subjects.iter().filter(|subject| subject.state == state).count();
    let states = ["flagged", "accepted", "failed", "excluded"].map(|state| (count(state), state));
    let states: Vec<String> =
        states.iter().filter(|(count, _)| *count > 0).map(|(count, state)| format!("{count} {state}")).collect();
    let summary = match states.is_empty() {
        true => "none flagged".to_owned(),
        false => states.join(", "),
    };
    let total = match check.subjects.len() {
        1 => "1 subject".to_owned(),
        count => format!("{count} subjects"),
    };
    let is_numeric = |column: usize| numeric(check.subjects.iter().map(|of| of.cells[column].text.as_str()));
    let numeric: Vec<bool> = (0..expected).map(is_numeric).collect();
    let texts = ["subject", "state", "why"].map(|column| head(column, false)).concat();
    let values: String = check.columns.iter().zip(&numeric).map(|(column, numeric)| head(column, *numeric)).collect();
    let heads = texts + &values;
    let rows: String = check.subjects.iter().enumerate().map(|(index, of)| row(index, of, &numeric)).collect();
    Ok(format!(
        "<section class=\"table check\" id=\"quality-control\"><h2>Quality control</h2>\n\
         <p>{total}: {summary}. Marked values are far from the other subjects' values (robust z above {FAR} or \
         below -{FAR}).</p>\n\
         <div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Quality control\">\
         <table class=\"sortable\"><thead><tr>{heads}</tr></thead><tbody>\n{rows}</tbody></table></div>\n{}</section>\n",
        pictures(check)
    ))
}

/// Returns the table row of a subject as HTML; `numeric` states which columns contain numbers.
fn row(index: usize, subject: &CheckedSubject, numeric: &[bool]) -> String {
    let CheckedSubject { id, state, flags, cells, picture, .. } = subject;
    let id = match picture {
        Some(_) => format!("<a href=\"#picture-{index}\">{}</a>", name(id)),
        None => name(id),
    };
    let cell = |(cell, numeric): (&CheckedCell, &bool)| {
        let (mark, title) = match cell.z {
            Some(z) => {
                let mark = match cell.far {
                    true if z.abs() > VERY_FAR => " very-far",
                    true => " far",
                    false => "",
                };
                (mark, format!(" title=\"robust z {z:.1}\""))
            }
            None => ("", String::new()),
        };
        let class = if *numeric { "number" } else { "" };
        format!("<td class=\"{class}{mark}\"{title}>{}</td>", name(&cell.text))
    };
    let state = escape(state);
    let cells: String = cells.iter().zip(numeric).map(cell).collect();
    let why = reasons(flags);
    format!(
        "<tr class=\"{state}\"><th scope=\"row\">{id}</th><td>{state}</td><td class=\"why\">{why}</td>{cells}</tr>\n"
    )
}

/// Number of reasons that are shown initially if a subject has at least two more reasons; the other reasons unfold on
/// request. With fewer reasons, all are shown.
const SHOWN: usize = 3;

/// Returns the reasons for flags as HTML, one per line.
fn reasons(flags: &[String]) -> String {
    let lines = |flags: &[String]| flags.iter().map(|flag| name(flag)).collect::<Vec<_>>().join("<br>");
    match flags.split_at_checked(SHOWN) {
        Some((first, others)) if others.len() > 1 => {
            format!("{}<details><summary>{} more</summary>{}</details>", lines(first), others.len(), lines(others))
        }
        _ => lines(flags),
    }
}

/// Returns the grid of the subjects' pictures as HTML.
fn pictures(check: &Check) -> String {
    let one = |(index, subject): (usize, &CheckedSubject)| {
        let png = STANDARD.encode(subject.picture.as_ref()?);
        let (mut id, state) = (name(&subject.id), escape(&subject.state));
        if let Some(scale) = subject.scale.filter(|scale| *scale < SMALLER) {
            id += &format!(" (at 1/{} of the scale)", number(1.0 / scale));
        }
        let alt = escape(&format!("{}: surface, {}", subject.id, subject.state));
        Some(format!(
            "<figure class=\"{state}\" id=\"picture-{index}\"><img alt=\"{alt}\" width=\"160\" height=\"120\" \
             loading=\"lazy\" decoding=\"async\" src=\"data:image/png;base64,{png}\"><figcaption>{id}</figcaption>\
             </figure>\n"
        ))
    };
    let figures: String = check.subjects.iter().enumerate().filter_map(one).collect();
    if figures.is_empty() {
        return String::new();
    }
    let legend = check.red_at.map_or_else(String::new, |red_at| {
        format!(
            "<p class=\"scale\">Distance of the surface from its model: <span>0</span> <span class=\"ramp\"></span> \
             <span>{}</span></p>\n",
            number(red_at)
        )
    });
    format!("<h3>All subjects in one pose</h3>\n{legend}<div class=\"pictures\">\n{figures}</div>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check() -> Check {
        let cell =
            |text: &str, z: Option<f64>| CheckedCell { text: text.to_owned(), z, far: z.is_some_and(|z| z > FAR) };
        let subject = |id: &str, state: &str, flags: &[&str], cells: Vec<CheckedCell>, picture: Option<Vec<u8>>| {
            let flags = flags.iter().map(|flag| (*flag).to_owned()).collect();
            CheckedSubject { id: id.to_owned(), state: state.to_owned(), flags, cells, picture, scale: Some(0.1) }
        };
        Check {
            columns: vec!["volume".to_owned(), "repair".to_owned()],
            subjects: vec![
                subject(
                    "<giant>",
                    "flagged",
                    &["volume 2e6"],
                    vec![cell("2000000", Some(80.0)), cell("", None)],
                    Some(vec![1]),
                ),
                subject("b", "failed", &["no such file"], vec![cell("", None), cell("", None)], None),
                subject("c", "ok", &[], vec![cell("2000", Some(-0.5)), cell("pieces dropped 1", None)], Some(vec![2])),
            ],
            red_at: Some(0.8),
        }
    }

    #[test]
    fn far_values_are_marked_and_names_are_text() {
        let html = section(&check()).unwrap();
        assert!(html.contains("3 subjects: 1 flagged, 1 failed."), "{html}");
        assert!(html.contains("&lt;giant&gt;") && !html.contains("<giant>"), "{html}");
        assert_eq!(html.matches("very-far").count(), 1, "{html}");
        assert!(
            html.contains("<th scope=\"col\" class=\"number\"><bdi>volume") && !html.contains("number\"><bdi>repair")
        );
        assert_eq!(html.matches("<td class=\"number").count(), 3, "the cells of volumes: {html}");
        assert_eq!((html.matches("<figure").count(), html.matches("href=\"#picture-").count()), (2, 2));
        assert!(html.contains("<span>0.8</span>") && html.contains("(at 1/10 of the scale)"));
        assert!(html.contains("volume 2e6</bdi></td>") && !html.contains("<details>"));
        let mut more = check();
        more.subjects[0].flags = ["a", "b", "c", "d", "e<"].map(str::to_owned).to_vec();
        let html = section(&more).unwrap();
        assert!(
            html.contains(
                "<bdi>c</bdi><details><summary>2 more</summary><bdi>d</bdi><br><bdi>e&lt;</bdi></details></td>"
            ),
            "{html}"
        );
        let mut wrong = check();
        wrong.subjects[1].cells.pop();
        assert!(matches!(section(&wrong), Err(ReportError::Cells { row: 2, expected: 2, found: 1, .. })));
    }

    #[test]
    fn a_group_without_flags_and_pictures_says_so() {
        let subjects = vec![CheckedSubject { id: "a".to_owned(), state: "ok".to_owned(), ..CheckedSubject::default() }];
        let html = section(&Check { subjects, ..Check::default() }).unwrap();
        assert!(html.contains("1 subject: none flagged."), "{html}");
        assert!(!html.contains("class=\"pictures\""));
    }
}
