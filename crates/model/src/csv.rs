//! Writes coefficients as a CSV table of complex coefficients, in the convention of Shen and Chung's paper.

use std::io::{self, Write};

use spharm_harmonics::Coefficients;
use spharm_harmonics::index::degree_order;

/// Writes complex coefficients as rows `l,m,x_re,x_im,y_re,y_im,z_re,z_im`, after a header. If the number of channels
/// isn't three, the channels are named `c0`, `c1`, ...
///
/// # Errors
///
/// The errors of `out`.
pub fn write_complex_csv(coefficients: &Coefficients, out: &mut dyn Write) -> io::Result<()> {
    let complex = coefficients.to_complex();
    let names: Vec<String> = match coefficients.channels() {
        3 => ["x", "y", "z"].map(str::to_owned).to_vec(),
        channels => (0..channels).map(|channel| format!("c{channel}")).collect(),
    };
    write!(out, "l,m")?;
    names.iter().try_for_each(|name| write!(out, ",{name}_re,{name}_im"))?;
    writeln!(out)?;
    for (row, values) in complex.rows().into_iter().enumerate() {
        let (degree, order) = degree_order(row);
        write!(out, "{degree},{order}")?;
        values.iter().try_for_each(|c| write!(out, ",{:?},{:?}", c.re, c.im))?;
        writeln!(out)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn complex_rows_have_the_published_columns() {
        let values = Array2::from_shape_fn((9, 3), |(k, c)| 0.1 * k as f64 - c as f64);
        let mut csv = Vec::new();
        write_complex_csv(&Coefficients::new(values).unwrap(), &mut csv).unwrap();
        let csv = String::from_utf8(csv).unwrap();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines[0], "l,m,x_re,x_im,y_re,y_im,z_re,z_im");
        assert!(lines[2].starts_with("1,-1,"));
        assert_eq!(lines.len(), 10);
    }
}
