//! Reads and writes coefficients as text: a CSV table or a JSON object.
//!
//! The table has columns `l,m,x,y,z` with canonical coefficients, or `l,m,c0,c1,...` if the number of channels isn't
//! three. Tables written by `spharm fit --coefficients-csv` can also be read: their columns `l,m,x_re,x_im,...` have
//! the complex coefficients of Shen and Chung's paper. The JSON object has the members `convention`, `max_degree`,
//! `channels` and `coefficients`, with one row of coefficients per harmonic.

use std::io::{self, Write};

use ndarray::Array2;
use num_complex::Complex64;
use serde_json::Value;
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::degree_order;
use spharm_model::CONVENTION;

use crate::flaw::Flaw;
use crate::text::{number, quoted, text};

/// Returns the names of the channels: x, y and z if there are three, otherwise c0, c1 and so on.
pub(crate) fn channel_names(channels: usize) -> Vec<String> {
    match channels {
        3 => ["x", "y", "z"].map(str::to_owned).to_vec(),
        _ => (0..channels).map(|channel| format!("c{channel}")).collect(),
    }
}

pub(crate) fn write_csv(out: &mut dyn Write, a: &Coefficients) -> io::Result<()> {
    writeln!(out, "l,m,{}", channel_names(a.channels()).join(","))?;
    for (row, values) in a.values().rows().into_iter().enumerate() {
        let (l, m) = degree_order(row);
        write!(out, "{l},{m}")?;
        values.iter().try_for_each(|x| write!(out, ",{x:?}"))?;
        writeln!(out)?;
    }
    Ok(())
}

/// Returns whether the text of a file begins like a CSV table of coefficients.
pub(crate) fn is_csv(text: &str) -> bool {
    text.trim_start().starts_with("l,m,")
}

pub(crate) fn read_csv(bytes: &[u8]) -> Result<Coefficients, Flaw> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text(bytes)?.as_bytes());
    let header = reader.headers().map_err(|error| Flaw::new("a table", error))?.clone();
    let names: Vec<&str> = header.iter().skip(2).collect();
    if header.iter().take(2).ne(["l", "m"]) || names.is_empty() {
        return Err(Flaw::new("columns l, m and one column per channel", cells(&header)));
    }
    let complex = names.first().is_some_and(|name| name.ends_with("_re"));
    let alternates = |(i, name): (usize, &&str)| name.ends_with(if i % 2 == 0 { "_re" } else { "_im" });
    if complex && (names.len() % 2 == 1 || !names.iter().enumerate().all(alternates)) {
        return Err(Flaw::new("alternating columns NAME_re and NAME_im", cells(&header)));
    }
    let mut values = Vec::new();
    let mut rows = 0;
    for record in reader.records() {
        let record = record.map_err(|error| Flaw::new("a row as long as the header", error))?;
        let line = rows + 2;
        let (l, m) = degree_order(rows);
        let place = [record.get(0), record.get(1)].map(|cell| cell.and_then(|cell| cell.parse::<isize>().ok()));
        if place != [Some(l.cast_signed()), Some(m)] {
            return Err(Flaw::new(format!("degree {l}, order {m} on line {line}"), cells(&record)));
        }
        for cell in record.iter().skip(2) {
            values.push(number(cell, line)?);
        }
        rows += 1;
    }
    let found = if complex {
        let pairs: Vec<Complex64> = values.as_chunks().0.iter().map(|&[re, im]| Complex64::new(re, im)).collect();
        let array = Array2::from_shape_vec((rows, names.len() / 2), pairs);
        Coefficients::from_complex(&array.map_err(|error| Flaw::new("a table", error))?)
    } else {
        let array = Array2::from_shape_vec((rows, names.len()), values);
        Coefficients::new(array.map_err(|error| Flaw::new("a table", error))?)
    };
    found.map_err(|_| {
        Flaw::new("a row for each order of every degree", format!("{rows} rows with an incomplete last degree"))
    })
}

/// Returns the beginning of a row for error messages, in quotes and with commas between the cells.
fn cells(record: &csv::StringRecord) -> String {
    quoted(&record.iter().collect::<Vec<_>>().join(","))
}

pub(crate) fn write_json(out: &mut dyn Write, a: &Coefficients) -> io::Result<()> {
    writeln!(out, "{{\n  \"convention\": {},", Value::from(CONVENTION))?;
    writeln!(out, "  \"max_degree\": {},", a.max_degree())?;
    writeln!(out, "  \"channels\": {},", Value::from(channel_names(a.channels())))?;
    write!(out, "  \"coefficients\": [")?;
    for (row, values) in a.values().rows().into_iter().enumerate() {
        write!(out, "{}\n    [", if row > 0 { "," } else { "" })?;
        for (i, x) in values.iter().enumerate() {
            write!(out, "{}{x:?}", if i > 0 { ", " } else { "" })?;
        }
        write!(out, "]")?;
    }
    writeln!(out, "\n  ]\n}}")
}

pub(crate) fn read_json(bytes: &[u8]) -> Result<Coefficients, Flaw> {
    let value: Value = serde_json::from_str(text(bytes)?).map_err(|error| Flaw::new("JSON", error))?;
    match value.get("convention") {
        Some(convention) if convention != CONVENTION => {
            return Err(Flaw::new(format!("convention {CONVENTION:?}"), convention));
        }
        _ => {}
    }
    let rows = value.get("coefficients").and_then(Value::as_array);
    let rows = rows.ok_or_else(|| Flaw::new("an object with an array `coefficients`", "none"))?;
    let channels = rows.first().and_then(Value::as_array).map_or(0, Vec::len);
    let mut values = Vec::new();
    for (at, value) in rows.iter().enumerate() {
        let numbers = if channels == 1 { "number" } else { "numbers" };
        let expected = || format!("{channels} {numbers} in row {at} (counted from 0)");
        let row = value.as_array().ok_or_else(|| Flaw::new(expected(), "a value that isn't an array"))?;
        if row.len() != channels {
            return Err(Flaw::new(expected(), row.len()));
        }
        for x in row {
            values.push(x.as_f64().ok_or_else(|| Flaw::new(format!("numbers in row {at}"), x))?);
        }
    }
    let array = Array2::from_shape_vec((rows.len(), channels), values).map_err(|error| Flaw::new("rows", error))?;
    let found = format!("{} rows of {channels} numbers", rows.len());
    Coefficients::new(array).map_err(|_| Flaw::new("(L + 1)^2 rows with one number per channel", found))
}
