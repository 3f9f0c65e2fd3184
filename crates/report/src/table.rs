//! Writes tables of text as HTML tables that the page's script can sort.

use crate::ReportError;
use crate::text::{escape, name};

/// A table, such as the list of models or a cohort's status.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Title of the table.
    pub title: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows of the table, with one cell per column.
    pub rows: Vec<Vec<String>>,
    /// Note under the table, such as the name of the file that contains further rows.
    pub note: Option<String>,
}

impl Table {
    /// Returns the table as HTML.
    pub(crate) fn html(&self) -> Result<String, ReportError> {
        let expected = self.columns.len();
        if let Some((row, cells)) = self.rows.iter().enumerate().find(|(_, cells)| cells.len() != expected) {
            let found = cells.len();
            return Err(ReportError::Cells { name: self.title.clone(), row: row + 1, expected, found });
        }
        let is_numeric = |column: usize| numeric(self.rows.iter().map(|row| row[column].as_str()));
        let numeric: Vec<bool> = (0..expected).map(is_numeric).collect();
        let heads: String = self.columns.iter().zip(&numeric).map(|(column, numeric)| head(column, *numeric)).collect();
        let cell = |(text, numeric): (&String, &bool)| {
            let class = match text.as_str() {
                _ if *numeric => " class=\"number\"",
                "failed" => " class=\"failed\"",
                _ => "",
            };
            format!("<td{class}>{}</td>", name(text))
        };
        let row =
            |cells: &Vec<String>| format!("<tr>{}</tr>\n", cells.iter().zip(&numeric).map(cell).collect::<String>());
        let rows: String = self.rows.iter().map(row).collect();
        let note = self.note.as_ref().map_or_else(String::new, |note| format!("<p class=\"note\">{}</p>", name(note)));
        Ok(format!(
            "<section class=\"table\"><h2>{}</h2><div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{}\">\
             <table class=\"sortable\"><thead><tr>{heads}</tr></thead><tbody>\n{rows}</tbody></table></div>{note}</section>\n",
            escape(&self.title),
            escape(&self.title)
        ))
    }
}

/// Returns the heading of a column as HTML, aligned like the cells of the column.
pub(crate) fn head(column: &str, numeric: bool) -> String {
    let class = if numeric { " class=\"number\"" } else { "" };
    format!("<th scope=\"col\"{class}>{}</th>", name(column))
}

/// Returns whether a column has non-empty cells, and all of them are numbers.
pub(crate) fn numeric<'a>(cells: impl Iterator<Item = &'a str>) -> bool {
    let mut filled = cells.filter(|cell| !matches!(*cell, "" | "–")).peekable();
    filled.peek().is_some() && filled.all(|cell| cell.parse::<f64>().is_ok())
}

/// Returns rows of names and values as an HTML table.
pub(crate) fn pairs(title: &str, rows: &[(String, String)]) -> String {
    let row = |(key, value): &(String, String)| {
        format!("<tr><th scope=\"row\">{}</th><td>{}</td></tr>", escape(key), name(value))
    };
    let rows: String = rows.iter().map(row).collect();
    format!("<div class=\"pairs\"><h3>{}</h3><table>{rows}</table></div>", escape(title))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_text_and_rows_are_whole() {
        let mut table = Table {
            title: "Status".to_owned(),
            columns: vec!["id".to_owned(), "msd".to_owned()],
            rows: vec![vec!["<i>".to_owned(), "1e-5".to_owned()], vec!["b".to_owned(), String::new()]],
            note: Some("more in <b>".to_owned()),
        };
        let html = table.html().unwrap();
        assert!(html.contains("&lt;i&gt;") && !html.contains("<i>"), "{html}");
        assert!(html.contains("</div><p class=\"note\"><bdi>more in &lt;b&gt;</bdi></p></section>"), "{html}");
        table.rows[1].pop();
        assert!(matches!(table.html(), Err(ReportError::Cells { row: 2, expected: 2, found: 1, .. })));
    }

    #[test]
    fn headings_are_aligned_like_their_columns() {
        let row = |cells: [&str; 4]| cells.map(str::to_owned).to_vec();
        let table = Table {
            title: "Status".to_owned(),
            columns: row(["id", "msd", "mixed", "empty"]),
            rows: vec![row(["a", "1e-5", "1", ""]), row(["b", "–", "b", "–"])],
            note: None,
        };
        let html = table.html().unwrap();
        for column in ["<th scope=\"col\"><bdi>id", "<th scope=\"col\" class=\"number\"><bdi>msd"] {
            assert!(html.contains(column), "{html}");
        }
        let numbers = ["msd", "1e-5", "–"].map(|text| format!(" class=\"number\"><bdi>{text}</bdi>"));
        assert!(numbers.iter().all(|cell| html.contains(cell)), "{html}");
        assert_eq!(html.matches("class=\"number\"").count(), 3, "{html}");
        assert!(!html.contains("class=\"note\""), "{html}");
    }
}
