//! Tests that an output appears completely or not at all.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;

use spharm_surface::SurfaceError;
use spharm_surface::generate::icosphere;
use spharm_surface::io::{WriteOptions, write_mesh, write_new};

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn a_file_that_is_there_stays_unless_told_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    write_new(&path, false, |out| out.write_all(b"first")).unwrap();
    let mut ran = false;
    let error = write_new(&path, false, |_| {
        ran = true;
        Ok(())
    })
    .unwrap_err();
    assert!(
        matches!(error, SurfaceError::OutputExists { .. }) && error.to_string().ends_with("the file exists"),
        "{error}"
    );
    assert!(!ran, "no work is done for nothing");
    assert_eq!(fs::read(&path).unwrap(), b"first");
    write_new(&path, true, |out| out.write_all(b"second")).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"second");
    assert_eq!(files(folder.path()), ["out"]);
}

#[test]
fn a_file_that_appears_meanwhile_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    let error = write_new(&path, false, |out| {
        fs::write(&path, "another's")?;
        out.write_all(b"ours")
    })
    .unwrap_err();
    assert!(matches!(error, SurfaceError::OutputExists { .. }), "{error}");
    assert_eq!(fs::read(&path).unwrap(), b"another's");
    assert_eq!(files(folder.path()), ["out"]);
}

/// The temporary file is in the same folder as the output and hence on the same file system, so a rename is a single
/// step.
#[test]
fn what_is_being_written_lies_in_the_folder_of_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    write_new(&path, false, |out| {
        out.write_all(b"half")?;
        let there = files(folder.path());
        assert!(there.len() == 1 && there[0] != "out", "{there:?}");
        Ok(())
    })
    .unwrap();
    assert_eq!(files(folder.path()), ["out"]);
}

#[test]
fn an_error_midway_leaves_things_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    let fail = |out: &mut dyn io::Write| {
        out.write_all(&[7; 1 << 20])?;
        Err(io::Error::new(ErrorKind::StorageFull, "disk full"))
    };
    let error = write_new(&path, false, fail).unwrap_err();
    assert!(error.to_string().contains("disk full"), "{error}");
    assert!(files(folder.path()).is_empty());
    fs::write(&path, "old").unwrap();
    write_new(&path, true, fail).unwrap_err();
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(files(folder.path()), ["out"]);
}

#[test]
fn directories_and_missing_folders_are_told() {
    let folder = tempfile::tempdir().unwrap();
    for path in [folder.path().to_owned(), folder.path().join("."), "/".into(), "".into()] {
        let error = write_new(&path, true, |_| Ok(())).unwrap_err();
        assert!(matches!(error, SurfaceError::NotAFile { .. }), "{path:?}: {error}");
    }
    let error = write_new(folder.path().join("no/such/out"), true, |_| Ok(())).unwrap_err();
    assert!(matches!(error, SurfaceError::Io { .. }), "{error}");
}

#[cfg(unix)]
#[test]
fn results_get_ordinary_permissions_links_are_followed_devices_refused() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = tempfile::tempdir().unwrap();
    let plain = folder.path().join("plain");
    fs::write(&plain, "x").unwrap();
    let ours = folder.path().join("ours");
    write_new(&ours, false, |_| Ok(())).unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&ours), mode(&plain));

    let link = folder.path().join("link");
    symlink(&plain, &link).unwrap();
    write_new(&link, true, |out| out.write_all(b"through")).unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(fs::read(&plain).unwrap(), b"through");

    let error = write_new("/dev/null", true, |_| Ok(())).unwrap_err();
    assert!(matches!(error, SurfaceError::NotAFile { found: "a device", .. }), "{error}");
}

#[test]
fn a_name_that_asks_for_no_format_is_refused_with_the_list() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["out", "out.npz", "out.csv", "out.gii.txt"] {
        let error = write_mesh(folder.path().join(name), &icosphere(0), &WriteOptions::default()).unwrap_err();
        assert!(matches!(error, SurfaceError::UnknownFormat { .. }), "{error}");
        assert!(error.to_string().contains(".surf.gii"), "{error}");
    }
    assert!(files(folder.path()).is_empty());
}
