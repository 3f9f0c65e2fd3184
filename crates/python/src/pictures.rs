//! Draws surfaces as PNG.

use numpy::PyReadonlyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use spharm_render::{Paint, Panel, Settings, View, encode_png, render};

use crate::arrays::{Faces, Positions, mesh};
use crate::errors::Failure;
use crate::run::run;

/// Allowed width and height of a picture, in pixels.
const SIZES: std::ops::RangeInclusive<usize> = 64..=4096;

/// Draws a surface as a square PNG. If values at the vertices, (n), are given, they are shown as colours, with a colour
/// bar that has the given limits and label.
#[pyfunction]
#[pyo3(signature = (vertices, faces, *, values, limits, label, caption, size, view))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
pub(crate) fn picture<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    values: Option<PyReadonlyArray1<'py, f64>>,
    limits: (f64, f64),
    label: &str,
    caption: &str,
    size: usize,
    view: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let mesh = mesh("surface", &vertices, &faces)?;
    let values = values.map(|values| values.as_array().to_vec());
    if !SIZES.contains(&size) {
        let (least, most) = SIZES.into_inner();
        return Err(PyValueError::new_err(format!("size: expected {least} to {most} pixels, found {size}")));
    }
    let view = match view {
        "left" => View::LEFT,
        "right" => View::RIGHT,
        "front" => View::FRONT,
        "back" => View::BACK,
        "top" => View::TOP,
        "bottom" => View::BOTTOM,
        "corner" => View::CORNER,
        found => {
            let expected = "expected left, right, front, back, top, bottom or corner";
            return Err(PyValueError::new_err(format!("view: {expected}; found {found}")));
        }
    };
    let png = run(py, Some(1), None, |_| {
        let paint = values.as_deref().map(|values| Paint::Scalar { values, range: limits, label });
        let panel = Panel::new(&mesh, caption);
        let panel = Panel { paint: paint.unwrap_or(panel.paint), ..panel };
        let settings = Settings { width: size, height: size, view, ..Settings::default() };
        let failed = |error: String| Failure::Argument(format!("surface: {error}"));
        let image = render(&[panel], &settings).map_err(|error| failed(error.to_string()))?;
        let mut png = Vec::new();
        encode_png(&image, &mut png).map_err(|error| failed(error.to_string()))?;
        Ok(png)
    })?;
    Ok(PyBytes::new(py, &png))
}
