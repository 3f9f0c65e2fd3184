//! Reads directions from tables of two angles.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::path::Path;

use spharm_harmonics::Directions;

use crate::error::SurfaceError;
use crate::io::{read_columns, signal_of};

/// The kind of angle that a column of a table contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Angle {
    /// Angle from the north pole.
    Colatitude,
    /// Angle from the equator.
    Latitude,
    Azimuth,
}

/// Accepted column names, in lower case. With each name: the kind of angle it denotes, and whether the angle is in
/// degrees if neither `_deg` nor `_rad` is appended to the name.
const NAMES: [(&str, Angle, bool); 9] = [
    ("theta", Angle::Colatitude, false),
    ("colatitude", Angle::Colatitude, false),
    ("colat", Angle::Colatitude, false),
    ("phi", Angle::Azimuth, false),
    ("azimuth", Angle::Azimuth, false),
    ("lat", Angle::Latitude, true),
    ("latitude", Angle::Latitude, true),
    ("lon", Angle::Azimuth, true),
    ("longitude", Angle::Azimuth, true),
];

/// A column of angles.
#[derive(Debug, Clone)]
struct Column {
    /// Index of the column.
    at: usize,
    name: String,
    angle: Angle,
    degrees: bool,
    /// Whether the column's name has no suffix for the unit (such as `_deg`), so that the unit is the usual one for
    /// this name.
    usual: bool,
}

impl Column {
    fn of(at: usize, name: &str) -> Option<Self> {
        let lower = name.to_lowercase();
        let units = [("_degrees", true), ("_deg", true), ("_radians", false), ("_rad", false)];
        let ending = units.into_iter().find_map(|(ending, degrees)| Some((lower.strip_suffix(ending)?, Some(degrees))));
        let (stem, given) = ending.unwrap_or((lower.as_str(), None));
        let (_, angle, usual) = NAMES.into_iter().find(|(known, ..)| *known == stem)?;
        let degrees = given.unwrap_or(usual);
        Some(Self { at, name: name.to_owned(), angle, degrees, usual: given.is_none() })
    }

    /// Returns the valid range of the column's angles, in the column's unit, and a description of this range. Every
    /// finite azimuth is valid.
    fn range(&self) -> ([f64; 2], &'static str) {
        match (self.angle, self.degrees) {
            (Angle::Colatitude, false) => ([0.0, PI], "from 0 to pi radians (measured from the pole)"),
            (Angle::Colatitude, true) => ([0.0, 180.0], "from 0 to 180 degrees (measured from the pole)"),
            (Angle::Latitude, false) => {
                ([-FRAC_PI_2, FRAC_PI_2], "from -pi/2 to pi/2 radians (measured from the equator)")
            }
            (Angle::Latitude, true) => ([-90.0, 90.0], "from -90 to 90 degrees (measured from the equator)"),
            (Angle::Azimuth, _) => ([f64::NEG_INFINITY, f64::INFINITY], "finite"),
        }
    }

    /// Returns the colatitude or the azimuth of a row, in radians.
    fn radians(&self, row: &[f64; 2]) -> f64 {
        let angle = if self.degrees { row[self.at].to_radians() } else { row[self.at] };
        if self.angle == Angle::Latitude { FRAC_PI_2 - angle } else { angle }
    }
}

/// Finds the column with the polar angle and the column with the azimuth by the names in a table's header. In a table
/// without a header, the columns are colatitude and azimuth in radians.
fn columns(path: &Path, names: &[String]) -> Result<[Column; 2], SurfaceError> {
    let usual = ["theta".to_owned(), "phi".to_owned()];
    let names = if names.is_empty() { &usual[..] } else { names };
    let found: Vec<Column> = names.iter().enumerate().filter_map(|(at, name)| Column::of(at, name)).collect();
    let (azimuths, polar): (Vec<Column>, Vec<Column>) =
        found.into_iter().partition(|column| column.angle == Angle::Azimuth);
    match (&polar[..], &azimuths[..]) {
        ([polar], [azimuth]) if polar.degrees == azimuth.degrees => Ok([polar.clone(), azimuth.clone()]),
        _ => Err(SurfaceError::Unsupported {
            path: path.to_owned(),
            format: "a table of angles",
            found: format!("columns {}", names.join(", ")),
            remedy: "name the columns theta and phi (in radians) or lat and lon (in degrees); for the other unit, \
                     append _deg or _rad to both names",
        }),
    }
}

/// Returns whether directions seem to be in radians, given their number and the largest magnitudes of their latitudes
/// and longitudes. Returns `false` for fewer than 10 directions, because so few directions may well be in degrees and
/// all lie within a few degrees of latitude 0 and longitude 0.
#[must_use]
pub fn look_like_radians(count: usize, latitude: f64, longitude: f64) -> bool {
    count >= 10 && latitude <= FRAC_PI_2 && longitude > 0.0 && longitude <= TAU
}

/// Returns an error if angles look like radians although the names of their columns, which have no suffix, imply
/// degrees.
fn check_unit(path: &Path, columns: [&Column; 2], rows: &[[f64; 2]]) -> Result<(), SurfaceError> {
    let largest = |column: &Column| rows.iter().map(|row| row[column.at].abs()).fold(0.0, f64::max);
    let [polar, azimuth] = columns.map(largest);
    let are_usual = columns.iter().all(|column| column.degrees && column.usual);
    if !are_usual || !look_like_radians(rows.len(), polar, azimuth) {
        return Ok(());
    }
    let [polar_name, azimuth_name] = columns.map(|column| &column.name);
    Err(SurfaceError::Unsupported {
        path: path.to_owned(),
        format: "a table of angles",
        found: format!(
            "columns {polar_name} (up to {polar:.3}) and {azimuth_name} (up to {azimuth:.3}), whose names imply \
             degrees but whose values look like radians,"
        ),
        remedy: "name the columns lat_rad and lon_rad, or lat_deg and lon_deg",
    })
}

/// Reads directions from a table with two columns of angles. The names in the header determine which column is which.
/// Without a header, the columns are colatitude and azimuth in radians.
pub(crate) fn read_angles(path: &Path) -> Result<Directions, SurfaceError> {
    let (input, facts) = read_columns(path)?;
    let signal = signal_of(path, input)?;
    if signal.channels != 2 {
        return Err(SurfaceError::NotAngles { path: path.to_owned(), columns: signal.channels });
    }
    let [polar, azimuth] = columns(path, &facts.names)?;
    let rows = signal.values.as_chunks::<2>().0;
    let ([low, high], expected) = polar.range();
    // The margin allows for rounding by the program that wrote the table.
    let margin = 1e-9 * (high - low);
    let allowed = low - margin..=high + margin;
    let outside = rows.iter().map(|row| row[polar.at]).enumerate().find(|(_, angle)| !allowed.contains(angle));
    if let Some((row, found)) = outside {
        return Err(SurfaceError::Colatitude { path: path.to_owned(), row, column: polar.name, expected, found });
    }
    check_unit(path, [&polar, &azimuth], rows)?;
    let angles: Vec<[f64; 2]> = rows.iter().map(|row| [polar.radians(row), azimuth.radians(row)]).collect();
    Directions::from_angles(&angles).map_err(|cause| SurfaceError::NoDirection { path: path.to_owned(), cause })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Directions, SurfaceError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("angles.csv");
        std::fs::write(&path, text).unwrap();
        read_angles(&path)
    }

    #[test]
    fn columns_are_found_by_their_names() {
        let expected = Directions::from_angles(&[[0.5, 2.0], [1.5, -1.0]]).unwrap();
        let degrees = |radians: f64| radians.to_degrees();
        let table = |head: &str, of: &dyn Fn([f64; 2]) -> [f64; 2]| {
            let rows = [[0.5, 2.0], [1.5, -1.0]].map(of).map(|[a, b]| format!("{a:?},{b:?}\n"));
            format!("{head}{}", rows.concat())
        };
        for text in [
            table("", &|angles| angles),
            table("# Theta, Phi\n", &|angles| angles),
            table("phi,theta\n", &|[theta, phi]| [phi, theta]),
            table("theta_deg,phi_deg\n", &|angles| angles.map(degrees)),
            table("azimuth_deg,colatitude_deg\n", &|[theta, phi]| [phi, theta].map(degrees)),
            table("lon,lat\n", &|[theta, phi]| [phi, FRAC_PI_2 - theta].map(degrees)),
            table("latitude,longitude\n", &|[theta, phi]| [FRAC_PI_2 - theta, phi].map(degrees)),
            table("lat_rad,lon_rad\n", &|[theta, phi]| [FRAC_PI_2 - theta, phi]),
        ] {
            let found = read(&text).unwrap();
            let far = found.as_slice().as_flattened().iter().zip(expected.as_slice().as_flattened());
            assert!(far.into_iter().all(|(a, b)| (a - b).abs() < 1e-12), "{text}");
        }
        let numbered = read("vertex,theta,phi\n0,0.5,2.0\n1,1.5,-1.0\n").unwrap();
        assert_eq!(numbered.as_slice(), expected.as_slice());
    }

    #[test]
    fn unknown_and_unsuitable_names_are_refused() {
        for head in ["x,y", "theta,theta", "lon,phi", "colatitude,longitude", "theta_deg,phi"] {
            let error = read(&format!("{head}\n0.5,1\n")).unwrap_err();
            assert!(matches!(error, SurfaceError::Unsupported { .. }), "{head}: {error}");
            assert!(error.to_string().contains(&head.replace(',', ", ")), "{error}");
        }
    }

    #[test]
    fn latitudes_and_longitudes_that_look_like_radians_are_refused() {
        let table = |head: &str, rows: usize, scale: f64| {
            let row = |i: usize| format!("{:?},{:?}\n", scale * (0.3 * i as f64 - 1.5), scale * 0.6 * i as f64);
            read(&format!("{head}\n{}", (0..rows).map(row).collect::<String>()))
        };
        for head in ["lat,lon", "Latitude,longitude"] {
            let error = table(head, 10, 1.0).unwrap_err().to_string();
            assert!(error.contains("angles.csv") && error.contains("(up to 1.500)"), "{error}");
            assert!(error.ends_with("name the columns lat_rad and lon_rad, or lat_deg and lon_deg"), "{error}");
        }
        for (head, rows, scale) in
            [("lat,lon", 9, 1.0), ("lat,lon", 10, 50.0), ("lat_rad,lon_rad", 10, 1.0), ("lat_deg,lon_deg", 10, 1.0)]
        {
            assert!(table(head, rows, scale).is_ok(), "{head} {rows} {scale}");
        }
    }

    #[test]
    fn angles_out_of_range_are_refused_in_their_unit() {
        for (text, expected) in [
            ("phi,theta\n1,3.2\n", "row 0 (counted from 0): theta must be from 0 to pi radians"),
            ("lon,lat\n1,2\n1,91\n", "row 1 (counted from 0): lat must be from -90 to 90 degrees"),
            ("theta_deg,phi_deg\n181,1\n", "theta_deg must be from 0 to 180 degrees"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
