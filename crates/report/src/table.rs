//! Writes text tables as HTML, which the page's script can sort.

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
}

impl Table {
    /// Returns the table as HTML.
    pub(crate) fn html(&self) -> Result<String, ReportError> {
        let expected = self.columns.len();
        if let Some((row, cells)) = self.rows.iter().enumerate().find(|(_, cells)| cells.len() != expected) {
            let found = cells.len();
            return Err(ReportError::Cells { name: self.title.clone(), row: row + 1, expected, found });
        }
        let heads: String =
            self.columns.iter().map(|column| format!("<th scope=\"col\">{}</th>", name(column))).collect();
        let numeric: Vec<bool> = (0..expected).map(|column| self.numeric(column)).collect();
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
        Ok(format!(
            "<section class=\"table\"><h2>{}</h2><div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{}\">\
             <table class=\"sortable\"><thead><tr>{heads}</tr></thead><tbody>\n{rows}</tbody></table></div></section>\n",
            escape(&self.title),
            escape(&self.title)
        ))
    }

    /// Returns whether all non-empty cells of a column are numbers.
    fn numeric(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().map(|row| row[column].as_str()).filter(|cell| !matches!(*cell, "" | "–"));
        cells.clone().next().is_some() && cells.all(|cell| cell.parse::<f64>().is_ok())
    }
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
        };
        let html = table.html().unwrap();
        assert!(html.contains("&lt;i&gt;") && !html.contains("<i>") && html.contains("class=\"number\""), "{html}");
        table.rows[1].pop();
        assert!(matches!(table.html(), Err(ReportError::Cells { row: 2, expected: 2, found: 1, .. })));
    }
}
