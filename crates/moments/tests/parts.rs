//! Tests that moments of parts add up to the moments of the whole, and that parts that don't belong together are
//! rejected.

use std::path::{Path, PathBuf};

use spharm_moments::{Moments, MomentsError, Request, Shard, Warning, accumulate, equal_sums, merge};
use spharm_monitor::Silent;

/// Writes a table of 5,000 scattered samples with two channels and weights.
fn table(folder: &Path) -> PathBuf {
    let mut text = "lon,lat,a,b,w\n".to_owned();
    for i in 0..5_000 {
        let x = f64::from(i);
        let (lon, lat) = ((x * 77.7) % 360.0, (2.0 * ((x * 0.618_034) % 1.0) - 1.0).asin().to_degrees());
        text += &format!("{lon},{lat},{},{},{}\n", (3.0 * x).sin(), x.cos() + 2.0, 1 + i % 3);
    }
    let path = folder.join("samples.csv");
    std::fs::write(&path, text).unwrap();
    path
}

fn request(path: &Path, shard: Shard) -> Request {
    let mut request = Request::new(vec![path.to_owned()], 20);
    request.columns.values = vec!["a".to_owned(), "b".to_owned()];
    request.columns.weight = Some("w".to_owned());
    request.shard = shard;
    request
}

fn part(path: &Path, index: u32, of: u32) -> Moments {
    accumulate(&request(path, Shard { index, of }), &Silent).unwrap().moments
}

#[test]
fn shards_add_up_in_any_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let whole = part(&path, 0, 1);
    assert_eq!((whole.rows, whole.sources[0].rows), (5_000, 5_000));
    for of in [2, 7] {
        let mut parts: Vec<Moments> = (0..of).map(|index| part(&path, index, of)).collect();
        assert!(parts.iter().all(|part| part.rows > 0));
        parts.reverse();
        parts.swap(0, 1);
        let all = merge(parts, false).unwrap();
        assert_eq!(all.sources, whole.sources, "shards that make a whole are one");
        assert_eq!((all.rows, all.sums.count), (whole.rows, whole.sums.count));
        assert_eq!(all.occupied, whole.occupied);
        let largest = whole.sums.moments[0].abs();
        let pairs = all
            .sums
            .moments
            .iter()
            .zip(&whole.sums.moments)
            .chain(all.sums.right_sides.iter().zip(&whole.sums.right_sides));
        for (a, b) in pairs {
            assert!((a - b).abs() < 1e-13 * largest, "{a} {b}");
        }
    }
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let (first, second) = (part(&path, 0, 2), part(&path, 1, 2));
    assert!(matches!(merge(Vec::new(), false), Err(MomentsError::NoParts)));
    let twice = merge(vec![first.clone(), first.clone()], true).unwrap_err();
    assert!(matches!(&twice, MomentsError::Overlap { .. }), "{twice}");
    let overlapping = merge(vec![second.clone(), part(&path, 2, 3)], true).unwrap_err();
    assert_eq!(overlapping.to_string(), "part 1 and part 2: both contain samples of shard 2/3; omit one of the two");
    assert_eq!(first.missing_shards(), ["shard 1/2"]);
    let both = merge(vec![first.clone(), second.clone()], false).unwrap();
    assert_eq!(both.missing_shards(), [""; 0]);
    let some = merge(vec![part(&path, 3, 7), part(&path, 1, 7)], true).unwrap();
    assert_eq!(some.missing_shards(), ["shard 0/7", "shard 2/7", "shards 4/7 to 6/7"]);
    let missing = merge(vec![part(&path, 1, 7), part(&path, 3, 7)], false).unwrap_err();
    assert_eq!(missing.to_string(), "3 ranges of shards are missing: shard 0/7, shard 2/7, shards 4/7 to 6/7");
    assert_eq!(merge(vec![part(&path, 1, 7), part(&path, 3, 7)], true).unwrap().sources.len(), 2);
    let mut other = request(&path, Shard { index: 1, of: 2 });
    other.max_degree = 19;
    let other = accumulate(&other, &Silent).unwrap().moments;
    let error = merge(vec![first.clone(), other], false).unwrap_err();
    assert_eq!(
        error.to_string(),
        "part 2 and part 1: degrees differ: 19 and 20; only parts of the same degree and channels can be added"
    );
    let mut other = request(&path, Shard { index: 1, of: 2 });
    other.columns.values.pop();
    let other = accumulate(&other, &Silent).unwrap().moments;
    assert!(matches!(merge(vec![first, other], false), Err(MomentsError::Differ { what: "channels", .. })));
}

#[test]
fn parts_of_different_tables_add_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    // A table with the same file name and size, but other values.
    let copy = folder.path().join("more").join("samples.csv");
    std::fs::create_dir(copy.parent().unwrap()).unwrap();
    std::fs::write(&copy, std::fs::read_to_string(&path).unwrap().replace(",3\n", ",2\n")).unwrap();
    let all = merge(vec![part(&path, 0, 1), part(&copy, 0, 1)], false).unwrap();
    assert_eq!((all.sources.len(), all.rows), (2, 10_000));
    let mut both = request(&path, Shard::WHOLE);
    both.files.push(copy);
    let both = accumulate(&both, &Silent).unwrap().moments;
    assert_eq!(both.rows, 10_000);
    assert!((both.sums.squares[0] / all.sums.squares[0] - 1.0).abs() < 1e-14);
    assert!(merge(vec![part(&path, 0, 1), part(&path, 0, 1)], false).is_err());
}

#[test]
fn shards_of_a_file_that_changed_are_refused_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let first = part(&path, 0, 2);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.trim_end().trim_end_matches(|c: char| c != '\n')).unwrap();
    let second = part(&path, 1, 2);
    let error = merge(vec![first.clone(), second.clone()], false).unwrap_err();
    assert!(matches!(&error, MomentsError::Versions { .. }), "{error}");
    assert!(error.to_string().contains("part 1 and part 2") && error.to_string().contains("changed"), "{error}");
    assert_eq!(merge(vec![first, second], true).unwrap().sources.len(), 2);
}

#[test]
fn parts_with_equal_sums_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = table(folder.path());
    let copy = folder.path().join("copy.csv");
    std::fs::copy(&path, &copy).unwrap();
    let hashes = [part(&path, 0, 2), part(&copy, 0, 1), part(&copy, 0, 2)].map(|part| part.sums_hash());
    let names = ["a", "b", "c"].map(str::to_owned);
    let expected = Warning::EqualSums { first: "a".to_owned(), second: "c".to_owned() };
    assert_eq!(equal_sums(&hashes, &names), [expected]);
}
