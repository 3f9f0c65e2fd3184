//! Computes paths that don't depend on the current folder.

use std::path::{Component, Path, PathBuf};

/// Returns an absolute path, without resolving links.
pub(super) fn absolute(path: &Path) -> std::io::Result<PathBuf> {
    // The empty path means the current folder.
    std::path::absolute(if path.as_os_str().is_empty() { Path::new(".") } else { path })
}

/// Resolves the relative path `way` from the folder `place`. If the path resolved so far ends with a name, a `..` of
/// `way` removes this name instead of being appended. Therefore, no `..` of `way` follows a name in the result, and a
/// repeated run uses the same paths as the first run.
pub(super) fn ascend(place: &Path, way: &Path) -> PathBuf {
    let mut path = place.to_owned();
    for part in way.components() {
        let named = matches!(path.components().next_back(), Some(Component::Normal(_)));
        if part == Component::ParentDir && named {
            path.pop();
        } else {
            path.push(part);
        }
    }
    path
}

/// Removes a folder's path from the beginning of each path in a message. The folder's path ends with a separator.
pub(super) fn without_folder(message: &str, folder: &str) -> String {
    let (mut found, mut at) = (String::new(), 0);
    let is_inner = |c: char| c.is_alphanumeric() || "._-/\\".contains(c);
    // Paths may contain spaces, so an occurrence of `folder` after a space may be in the middle of a path. It is
    // assumed to be so if the word before the space looks like a part of a path.
    let is_in_path = |before: &str| {
        let word = before.strip_suffix(' ').and_then(|before| before.rsplit(' ').next()).unwrap_or_default();
        word.contains(['/', '\\']) && word.ends_with(is_inner)
    };
    // Skip the empty path, which means the current folder, and the root, which contains all files.
    for (start, _) in message.match_indices(folder).filter(|_| folder.len() > 1) {
        let before = &message[..start];
        if !before.ends_with(is_inner) && !is_in_path(before) {
            found += &message[at..start];
            at = start + folder.len();
        }
    }
    found + &message[at..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_in_messages_lose_the_folder_once() {
        for (message, folder, expected) in [
            ("a/in/x.ply: no such file", "a/", "in/x.ply: no such file"),
            ("a/a/x.ply and a/y.ply", "a/", "a/x.ply and y.ply"),
            ("data/x.ply (a/y.ply)", "a/", "data/x.ply (y.ply)"),
            ("../../in/x.ply: 3 vertices", "../", "../in/x.ply: 3 vertices"),
            ("/site/x.ply differs from '/site/y.ply'", "/site/", "x.ply differs from 'y.ply'"),
            ("/mnt/shared study/x.ply: no such file", "study/", "/mnt/shared study/x.ply: no such file"),
            ("x.ply: found 1/2", "", "x.ply: found 1/2"),
            ("/in/x.ply: found 1 / 2", "/", "/in/x.ply: found 1 / 2"),
        ] {
            assert_eq!(without_folder(message, folder), expected);
        }
    }
}
