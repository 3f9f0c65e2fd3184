//! Tests tables of all formats, and that errors for invalid tables name the file, the row and the expected value.

use std::path::{Path, PathBuf};

use spharm_moments::{Moments, MomentsError, Positions, Request, Shard, Warning, accumulate};
use spharm_monitor::{Monitor, Silent};

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// A monitor that deletes a file as soon as all rows have been read.
struct Delete(PathBuf);

impl Monitor for Delete {
    fn end(&self) {
        std::fs::remove_file(&self.0).unwrap();
    }
}

fn request(path: &Path, values: &[&str]) -> Request {
    let mut request = Request::new(vec![path.to_owned()], 3);
    request.columns.values = values.iter().map(|&name| name.to_owned()).collect();
    request
}

fn read(path: &Path, values: &[&str]) -> Moments {
    accumulate(&request(path, values), &Silent).unwrap().moments
}

fn refused(request: &Request, expected: &[&str]) {
    let error = accumulate(request, &Silent).unwrap_err().to_string();
    for word in expected {
        assert!(error.contains(word), "{word:?} is not in: {error}");
    }
}

fn same(a: &Moments, b: &Moments) {
    let pairs = a.sums.moments.iter().zip(&b.sums.moments).chain(a.sums.right_sides.iter().zip(&b.sums.right_sides));
    let off = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-12 * a.sums.moments[0], "{off:e}");
    assert_eq!((a.rows, &a.sums.squares), (b.rows, &b.sums.squares));
}

/// Directions of the samples in the tables of all formats, as (longitude, latitude) in degrees.
const PLACES: [[f64; 2]; 6] = [[0.0, 90.0], [10.0, 20.0], [200.0, -45.0], [359.0, 0.0], [90.0, 60.0], [-30.0, -80.0]];

fn vectors() -> Vec<[f64; 3]> {
    let of = |[lon, lat]: [f64; 2]| {
        let ((s, c), (sine, cosine)) = (lat.to_radians().sin_cos(), lon.to_radians().sin_cos());
        [c * cosine, c * sine, s]
    };
    PLACES.into_iter().map(of).collect()
}

fn npy(descr: &str, fortran: bool, shape: &str, values: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let header = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), values].concat()
}

#[test]
fn positions_of_all_kinds_are_the_same_places() {
    let folder = Folder::new();
    let table = |name: &str, head: &str, row: &dyn Fn(usize) -> String| {
        folder.file(name, (0..6).fold(format!("{head}\n"), |text, i| text + &row(i) + "\n"))
    };
    let lonlat = table("a.csv", "lon,lat,f", &|i| format!("{},{},{i}", PLACES[i][0], PLACES[i][1]));
    let angles = table("b.tsv", "phi\tf\ttheta", &|i| {
        format!("{}\t{i}\t{}", PLACES[i][0].to_radians(), (90.0 - PLACES[i][1]).to_radians())
    });
    let xyz = table("c.txt", "x y z f", &|i| {
        let [x, y, z] = vectors()[i];
        format!("{x:.17} {y:.17} {z:.17} {i}")
    });
    let saved =
        table("saved.txt", "# by a program\n# lon lat f", &|i| format!("{} {} {i}", PLACES[i][0], PLACES[i][1]));
    let expected = read(&lonlat, &["f"]);
    for path in [&angles, &xyz, &saved] {
        same(&expected, &read(path, &["f"]));
    }
    // Pandas writes the numbers of columns without names as a header.
    let places = table("places.csv", "0,1,2", &|i| format!("{},{},{i}", PLACES[i][0], PLACES[i][1]));
    let mut places = request(&places, &["2"]);
    places.columns.positions = Some(Positions::LonLat(["0", "1"].map(str::to_owned)));
    same(&expected, &accumulate(&places, &Silent).unwrap().moments);
    let own = table("own.csv", "x,y,z,radius", &|i| vectors()[i].map(|x| (3.0 * x).to_string()).join(",") + ",2");
    refused(&request(&own, &["radius"]), &["row 1", "the table's own column; rename it"]);
    // A table of the same directions, as vectors from another centre, with the lengths of the vectors as values.
    let moved = table("d.csv", "x,y,z", &|i| {
        let v = vectors()[i];
        let r = (i + 1) as f64;
        format!("{},{},{}", 5.0 + r * v[0], r * v[1] - 2.0, r * v[2])
    });
    let mut radius = request(&moved, &["radius"]);
    refused(&request(&moved, &["x"]), &["row 1", "a unit vector", "radius"]);
    radius.columns.centre = [5.0, -2.0, 0.0];
    let radius = accumulate(&radius, &Silent).unwrap().moments;
    assert!((radius.sums.squares[0] - 91.0).abs() < 1e-10);
}

#[test]
fn arrays_of_all_layouts() {
    let folder = Folder::new();
    let rows: Vec<[f64; 4]> = vectors().iter().enumerate().map(|(i, v)| [v[0], v[1], v[2], i as f64]).collect();
    let bytes = |values: Vec<f64>| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let by_rows = bytes(rows.concat());
    let by_columns = bytes((0..4).flat_map(|c| rows.iter().map(move |row| row[c])).collect());
    let big: Vec<u8> = rows.concat().iter().flat_map(|v| v.to_be_bytes()).collect();
    let fields = "[('x', '<f8'), ('y', '<f8'), ('z', '<f8'), ('f', '<f8')]";
    let named = folder.file("named.npy", npy(fields, false, "(6,)", &by_rows));
    let expected = read(&named, &["f"]);
    for (name, array) in [
        ("c.npy", npy("'<f8'", false, "(6, 4)", &by_rows)),
        ("f.npy", npy("'<f8'", true, "(6, 4)", &by_columns)),
        ("big.npy", npy("'>f8'", false, "(6, 4)", &big)),
    ] {
        let mut request = request(&folder.file(name, array), &["3"]);
        request.columns.positions = Some(Positions::Vectors(["0", "1", "2"].map(str::to_owned)));
        same(&expected, &accumulate(&request, &Silent).unwrap().moments);
        let shards = (0..4).map(|index| {
            request.shard = Shard { index, of: 4 };
            accumulate(&request, &Silent).map(|part| part.moments)
        });
        let all = spharm_moments::merge(shards.collect::<Result<_, _>>().unwrap(), false).unwrap();
        same(&expected, &all);
    }
    let short = folder.file("short.npy", npy("'<f8'", false, "(6, 4)", &by_rows[1..]));
    refused(&request(&short, &["3"]), &["short.npy", "6 rows of 32 bytes", "bytes in total"]);
    let text = folder.file("text.npy", npy("'<U4'", false, "(6,)", &by_rows));
    refused(&request(&text, &["0"]), &["text.npy", "numbers of 8 to 64 bits"]);
    refused(&request(&folder.file("noise.npy", b"noise noise noise"), &["0"]), &["noise.npy", "NumPy array"]);
}

#[test]
fn rows_that_cannot_be_used_are_named() {
    let folder = Folder::new();
    let mut number = 0;
    let mut bad = |head: &str, row: &str, expected: &[&str]| {
        number += 1;
        let good = if head == "lon,lat,f,w" { "1,2,3,1" } else { "1,2,3" };
        let name = format!("{number}.csv");
        let path = folder.file(&name, format!("{head}\n# a comment\n{good}\n\n{good}\n{row}\n{good}\n"));
        let mut request = request(&path, &["f"]);
        request.columns.weight = head.ends_with('w').then(|| "w".to_owned());
        refused(&request, &[&[&name, "row 3"], expected].concat());
        // Errors for shards count rows from the beginning of the entire table.
        for index in 0..5 {
            request.shard = Shard { index, of: 5 };
            if let Err(error) = accumulate(&request, &Silent) {
                assert!(error.to_string().contains("row 3"), "{error}");
            }
        }
    };
    bad("lon,lat,f", "nan,2,3", &["lon", "a finite number", "NaN"]);
    bad("lon,lat,f", "1,2,inf", &["f: ", "a finite number", "inf"]);
    bad("lon,lat,f", "1,91,3", &["lat", "-90 to 90", "91"]);
    bad("lon,lat,f", "1000,9,3", &["lon", "-360 to 360", "1000"]);
    bad("lon,lat,f", "1,2", &["as many fields as columns", "2 fields"]);
    bad("lon,lat,f", "1,2,3,4", &["as many fields as columns", "4 fields"]);
    bad("lon,lat,f", "1,2,x", &["f: ", "a number", "\"x\""]);
    bad("lon,lat,f", "1,,3", &["lat", "a number", "\"\""]);
    bad("theta,phi,f", "90,2,3", &["theta", "in radians", "90"]);
    bad("theta,phi,f", "1,180,3", &["phi", "in radians", "180"]);
    bad("lon,lat,f,w", "1,2,3,-1", &["w: ", "at least 0", "-1"]);
    let zero = folder.file("zero.csv", "x,y,z,f\n0,0,1,5\n0,0,0,5\n");
    refused(&request(&zero, &["f"]), &["zero.csv", "row 2", "isn't zero"]);
}

#[test]
fn columns_that_are_missing_are_named_with_those_there() {
    let folder = Folder::new();
    let path = folder.file("a.csv", "lon,lat,height\n1,2,3\n");
    refused(&request(&path, &["altitude"]), &["a.csv", "no column altitude", "lon, lat, height"]);
    refused(&request(&path, &[]), &["a.csv", "the values", "lon, lat, height"]);
    refused(&request(&path, &["radius"]), &["a.csv", "radius"]);
    let mut twice = request(&path, &["height"]);
    twice.columns.positions = Some(Positions::LonLat(["lon", "lon"].map(str::to_owned)));
    refused(&twice, &["a.csv", "twice"]);
    let path = folder.file("b.csv", "1,2,3\n");
    refused(&request(&path, &["2"]), &["b.csv", "positions", "0, 1, 2"]);
}

#[test]
fn files_that_hold_no_samples() {
    let folder = Folder::new();
    for (name, bytes) in [("empty.csv", ""), ("names.csv", "lon,lat,f\n"), ("empty.npy", "")] {
        refused(&request(&folder.file(name, bytes), &["f"]), &[name, "expected samples, found none"]);
    }
    refused(&request(&folder.file("a.xyz", "1 2 3"), &["f"]), &["a.xyz", ".npy", ".csv"]);
    refused(&request(&folder.0.path().join("none.csv"), &["f"]), &["none.csv"]);
    refused(&request(folder.0.path(), &["f"]), &["expected a regular file"]);
    let mut little = request(&folder.file("a.csv", "lon,lat,f\n1,2,3\n"), &["f"]);
    little.memory = Some(1 << 20);
    assert!(matches!(accumulate(&little, &Silent), Err(MomentsError::Memory { .. })));
    little.shard = Shard { index: 2, of: 2 };
    assert!(matches!(accumulate(&little, &Silent), Err(MomentsError::Shard { .. })));
}

#[test]
fn doubtful_samples_are_warned_of() {
    let folder = Folder::new();
    let rows = (0..20).fold("lon,lat,f,w\n".to_owned(), |text, i| {
        text + &format!("{},{},1,{}\n", 0.3 * f64::from(i), 0.05 * f64::from(i), i % 2)
    });
    let mut request = request(&folder.file("radians.csv", rows), &["f"]);
    request.columns.weight = Some("w".to_owned());
    let found = accumulate(&request, &Silent).unwrap();
    assert_eq!(found.moments.sums.count, 10);
    assert!(matches!(
        found.warnings[..],
        [Warning::ZeroWeights { zeros: 10, rows: 20 }, Warning::LooksLikeRadians { .. }]
    ));
}

#[test]
fn columns_of_equal_names_are_refused_only_if_requested() {
    let folder = Folder::new();
    let path = folder.file("twice.csv", "lon,lat,h,g,h\n1,2,3,4,5\n1,3,3,4,5\n");
    refused(&request(&path, &["h"]), &["twice.csv", "columns 3 and 5 both have the name h", "rename"]);
    assert_eq!(read(&path, &["g"]).sums.squares, [32.0]);
}

#[test]
fn cells_in_quotation_marks() {
    let folder = Folder::new();
    let plain = folder.file("plain.csv", "lon,lat,f\n10,20,1\n30,40,2\n");
    let expected = read(&plain, &["f"]);
    for (name, text) in [
        ("names.csv", "who,lon,lat,f\n\"Smith, J\",10,20,1\n\"the \"\"other\"\"\",30,40,2\n"),
        ("all.csv", "\"lon\",\"lat\",\"f\"\r\n\"10\",\"20\",\"1\"\r\n\"30\", \"40\" ,\"2\"\r\n"),
        ("tabs.tsv", "who\tlon\tnote\tlat\tf\n\"a\tb\"\t10\t\t20\t1\n\"\"\t30\t5\"\t40\t2\n"),
        ("header.csv", "\"a,b\";lon;lat;f\n1;10;20;1\n2;30;40;2\n"),
        ("blanks.txt", "lon lat who f\n10 20 \"a b\" 1\n30 40 c 2\n"),
    ] {
        same(&expected, &read(&folder.file(name, text), &["f"]));
    }
    let open = folder.file("open.csv", "lon,lat,f\n\"10,20,1\n");
    refused(&request(&open, &["f"]), &["open.csv", "row 1", "as many fields as columns", "1 fields"]);
}

#[test]
fn text_of_other_encodings_is_named_and_messages_stay_short() {
    let folder = Folder::new();
    let table = "lon,lat,f\n".to_owned() + &"1,2,3\n".repeat(1000);
    let wide: Vec<u8> = table.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let wide = folder.file("wide.csv", [b"\xff\xfe", &wide[..]].concat());
    refused(&request(&wide, &["f"]), &["wide.csv", "UTF-16; save the table as UTF-8"]);
    let old = folder.file("old.csv", table.replace('\n', "\r"));
    refused(&request(&old, &["f"]), &["old.csv", "carriage returns alone"]);
    let long = folder.file("long.csv", format!("lon,lat,f\n1,2,{}\n", "x".repeat(5000)));
    let many = folder.file("many.csv", (0..500).map(|i| format!("name{i},")).collect::<String>() + "f\n");
    for path in [wide, old, long, many] {
        let message = accumulate(&request(&path, &["f"]), &Silent).unwrap_err().to_string();
        assert!(message.len() < 800, "{message}");
    }
}

#[test]
fn fields_that_are_not_requested_may_have_any_type() {
    let folder = Folder::new();
    let row = |v: &[f64; 3], i: usize| {
        let place: Vec<u8> = v.iter().flat_map(|x| x.to_le_bytes()).collect();
        // The half-precision numbers 0, 1, 2, 3, 4 and 5.
        let half = [0x0000u16, 0x3c00, 0x4000, 0x4200, 0x4400, 0x4500][i];
        [b"name", &place[..], &half.to_le_bytes(), &[0; 5]].concat()
    };
    let values: Vec<u8> = vectors().iter().enumerate().flat_map(|(i, v)| row(v, i)).collect();
    let fields =
        "[('id', '|S4'), ('x', '<f8'), ('y', '<f8'), ('z', '<f8'), ('f', '<f2'), ('', '<i2', (2,)), ('ok', '|b1')]";
    let path = folder.file("fields.npy", npy(fields, false, "(6,)", &values));
    let found = read(&path, &["f"]);
    assert_eq!((found.rows, found.sums.squares[0]), (6, 55.0));
    refused(&request(&path, &["id"]), &["fields.npy", "the column id of type S4"]);
    refused(&request(&path, &["g"]), &["the columns id, x, y, z, f, ok"]);
}

#[test]
fn tables_that_count_twice_are_warned_of() {
    let folder = Folder::new();
    let text = "lon,lat,f\n10,20,1\n30,40,2\n";
    let (path, copy) = (folder.file("a.csv", text), folder.file("b.csv", text));
    let other = folder.file("c.csv", text.replace('2', "3"));
    let mut request = request(&path, &["f"]);
    let again = folder.0.path().join(".").join("a.csv");
    for (second, warns) in [(&path, true), (&copy, true), (&again, true), (&other, false)] {
        request.files = vec![path.clone(), second.clone()];
        let warnings = accumulate(&request, &Silent).unwrap().warnings;
        let told = matches!(&warnings[..], [Warning::EqualTables { first, .. }] if *first == path);
        assert_eq!((told, warnings.is_empty()), (warns, !warns), "{warnings:?}");
    }
    request.files = vec![path.clone(), copy.clone()];
    let warnings = accumulate(&request, &Delete(copy)).unwrap().warnings;
    assert!(matches!(&warnings[..], [Warning::EqualTables { .. }]), "{warnings:?}");
    request.files = vec![path, folder.0.path().join("missing.csv")];
    let error = accumulate(&request, &Silent).unwrap_err();
    assert!(matches!(&error, MomentsError::Io { action: "open", .. }), "{error}");
}
