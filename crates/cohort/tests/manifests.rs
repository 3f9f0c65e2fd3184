//! Tests that valid manifests are read and invalid manifests are refused.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use spharm_cohort::{Manifest, Row};

fn parse(text: &str) -> Result<Manifest, String> {
    Manifest::parse("study/subjects.tsv", text.as_bytes()).map_err(|error| error.to_string())
}

fn refusal(text: &str) -> String {
    let error = parse(text).expect_err(text);
    assert!(error.starts_with("study/subjects.tsv: ") && !error.contains(char::is_control), "{error:?}");
    error
}

#[test]
fn paths_are_relative_to_the_manifest_and_other_columns_are_kept() {
    let text = "\u{feff}# of the second scan\r\nid\tgroup\tsurface\tsphere\tweights\toutput\tlabel\r\n\r\n\
                a\tpatient\tsurf/a b.ply\t../s.ply\tarea\t\t\r\nb\t\t/d/b.nii\t\tw.csv\tx/b\t17\r\n";
    let manifest = parse(text).expect("a manifest");
    assert_eq!(manifest.columns, ["group"]);
    let masked = parse("id\tsurface\tsignal_mask\na\tlh.thickness\t../lh.cortex.label\nb\tc\t\n").expect("a manifest");
    let regions: Vec<_> = masked.rows.iter().map(|row| row.region.clone()).collect();
    assert_eq!(regions, [Some("study/../lh.cortex.label".into()), None]);
    let weight = parse("id\tsurface\tweight\tsite\na\tb\t71\tx\n").expect("a body's weight is a covariate");
    assert_eq!(weight.columns, ["weight", "site"]);
    let [a, b] = &manifest.rows[..] else { panic!("{:?}", manifest.rows) };
    assert_eq!((a.id.as_str(), a.line, &a.extra[..]), ("a", 4, &["patient".to_owned()][..]));
    assert_eq!(a.surface, Path::new("study/surf/a b.ply"));
    assert_eq!((a.sphere.clone(), a.weights.clone()), (Some("study/../s.ply".into()), Some("area".into())));
    assert_eq!(a.model(Path::new("out")), Path::new("out/a.spharm.npz"));
    assert_eq!((b.surface.clone(), b.label, b.line), ("/d/b.nii".into(), Some(17), 5));
    assert_eq!((b.sphere.clone(), b.weights.clone()), (None, Some("study/w.csv".into())));
    assert_eq!(b.model(Path::new("out")), Path::new("out/x/b.spharm.npz"));
}

#[test]
fn commas_are_for_csv() {
    let text = b"id,surface\n\"a, b\",\"x,y.ply\"\n";
    let manifest = Manifest::parse("s.CSV", text).expect("a manifest");
    assert_eq!((manifest.rows[0].id.as_str(), &manifest.rows[0].surface), ("a, b", &PathBuf::from("x,y.ply")));
    let error = Manifest::parse("s.tsv", text).unwrap_err().to_string();
    assert!(error.contains("missing column id") && error.contains(".csv"), "{error}");
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    for (text, line, why) in [
        ("", "", "no row"),
        ("id\tsurface\n", "", "no row"),
        ("# only\n\n", "", "no row"),
        ("id\tfile\na\tb\n", "line 1", "missing column surface; found id, file"),
        ("ID\tsurface\na\tb\n", "line 1", "missing column id"),
        ("id\tsurface\tsurface\na\tb\tc\n", "line 1", "duplicate column surface"),
        ("id\tsurface\tSphere\na\tb\tc\n", "line 1", "unknown column \"Sphere\"; rename the column to sphere"),
        ("id\tsurface\tlabels\na\tb\t17\n", "line 1", "unknown column \"labels\"; rename the column to label"),
        ("id\tsurface\toutptu\na\tb\tc\n", "line 1", "rename the column to output"),
        ("id\tsurface\na\tb\n\n# c\na\tc\n", "line 5", "duplicate id a, first used on line 2"),
        ("id\tsurface\na\tb\nb\n", "line 3", "expected 2 cells as in the header, found 1"),
        ("id\tsurface\na\tb\tc\n", "line 2", "found 3 (decimal comma or missing quotes?)"),
        ("id\tsurface\n\tb\n", "line 2", "column id: expected an id, found nothing"),
        ("id\tsurface\na\t\n", "line 2", "column surface: expected a file, found nothing"),
        ("id\tsurface\n../a\tb\n", "line 2", "without path separators, found \"../a\""),
        ("id\tsurface\na\\b\tb\n", "line 2", "without path separators"),
        ("id\tsurface\n..\tb\n", "line 2", "that can name a file"),
        ("id\tsurface\n\"a\nb\"\tb\n", "line 2", "without control characters, found \"a\\nb\""),
        ("id\tsurface\na\u{1b}[31m\tb\n", "line 2", "without control characters"),
        ("id\tsurface\na\tb\0c\n", "line 2", "column surface: expected text without control characters"),
        ("id\tsurface\tlabel\na\tb\tx\n", "line 2", "column label: expected a whole number, found \"x\""),
        ("id\tsurface\toutput\na\tb\tx/\n", "line 2", "column output: expected a file"),
        ("id\tsurface\toutput\na\tb\tc\nb\td\t./x/../c.npz\n", "line 3", "first used on line 2"),
        ("id\tsurface\toutput\na\tb\t\nb\td\ta.spharm.npz\n", "line 3", "first used on line 2"),
        ("id\tsurface\toutput\na\tb\tx/c.npz\nb\td\tx/c.SPHARM.NPZ\n", "line 3", "first used on line 2"),
    ] {
        let error = refusal(text);
        assert!(error.contains(line) && error.contains(why), "{text:?}: {error}");
    }
    let long = format!("id\tsurface\n{}\tb\n", "x".repeat(201));
    assert!(refusal(&long).contains("and 141 more characters"), "{}", refusal(&long));
    let latin = Manifest::parse("s.tsv", b"id\tsurface\na\tb\nM\xfcller\tc\n").unwrap_err().to_string();
    assert!(latin.contains("line 3") && latin.contains("0xfc"), "{latin}");
}

#[test]
fn the_rest_of_a_manifest_is_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("all.tsv");
    std::fs::write(&path, "id\tsurface\tsphere\tage\n# first\na\ta.ply\t\t3\nb\tsub/b.ply\ts.ply\t4\n")
        .expect("written");
    let manifest = Manifest::read(&path).expect("a manifest");
    let rest = |to: &Path| manifest.rest(to, |row: &Row| row.id == "b").expect("a text");
    assert_eq!(rest(&folder.path().join("rest.tsv")), b"id\tsurface\tsphere\tage\nb\tsub/b.ply\ts.ply\t4\n");
    // In a manifest in another folder, the paths still refer to the same input files.
    let other = folder.path().join("deep/rest.csv");
    let again = Manifest::parse(&other, &rest(&other)).expect("a manifest");
    assert_eq!(again.rows[0].surface, folder.path().join("sub/b.ply"));
    assert_eq!(
        (again.rows[0].sphere.clone(), &again.rows[0].extra[0]),
        (Some(folder.path().join("s.ply")), &"4".to_owned())
    );
}

fn cell() -> impl Strategy<Value = String> {
    // The characters include separators and quotation marks.
    "[a-zA-Z0-9 ,;\"'äß#-][a-zA-Z0-9 ,;\"'äß#.-]{0,12}"
        .prop_map(|text| text.trim().to_owned())
        .prop_filter("text", |text| !text.is_empty() && text != "." && text != "..")
}

proptest! {
    #[test]
    fn what_a_program_writes_is_read_back(
        ids in prop::collection::btree_set(cell(), 1..20),
        surface in cell(),
        commas in any::<bool>(),
        crlf in any::<bool>(),
    ) {
        let separator = if commas { b',' } else { b'\t' };
        let mut writer = csv::WriterBuilder::new()
            .delimiter(separator)
            .comment(Some(b'#'))
            .terminator(if crlf { csv::Terminator::CRLF } else { csv::Terminator::Any(b'\n') })
            .from_writer(Vec::new());
        writer.write_record(["surface", "extra", "id"]).unwrap();
        for id in &ids {
            writer.write_record([&surface, "x", id]).unwrap();
        }
        let path = if commas { "m.csv" } else { "m.tsv" };
        let manifest = Manifest::parse(path, &writer.into_inner().unwrap()).unwrap();
        prop_assert!(manifest.rows.iter().map(|row| &row.id).eq(&ids));
        prop_assert!(manifest.rows.iter().zip(2..).all(|(row, line)| row.line == line && row.surface == Path::new(&surface)));
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), tail in "[\t\n\r\"#ab,]{0,60}") {
        for path in ["m.tsv", "m.csv"] {
            let _ = Manifest::parse(path, &bytes);
            let mut text = b"id\tsurface\n".to_vec();
            text.extend(tail.bytes());
            let _ = Manifest::parse(path, &text);
        }
    }
}

#[test]
fn a_label_for_all_is_that_of_volumes_without_a_label_and_a_sphere() {
    let text = "id\tsurface\tsphere\tlabel\na\ta.nii.gz\t\t\nb\tb.nii.gz\t\t53\nc\tc.ply\t\t\nd\td.nii.gz\td.ply\t\n";
    let mut manifest = parse(text).expect("a manifest");
    manifest.label_volumes(17);
    assert_eq!(manifest.rows.iter().map(|row| row.label).collect::<Vec<_>>(), [Some(17), Some(53), None, None]);
}
