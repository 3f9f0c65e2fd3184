//! Reads the parts of an archive. The memory for all parts together is limited to the most that an archive of this size
//! can plausibly contain.

use std::io::Cursor;

use zip::ZipArchive;

use super::super::budget::Budget;
use super::super::flaw::{Flaw, shown};
use super::super::load::inflated;
use super::super::xml::{Step, local, walk};
use super::names::{MODEL, MODEL_TYPE, RELATIONSHIPS};

/// An open archive.
pub(super) struct Package<'a> {
    archive: ZipArchive<Cursor<&'a [u8]>>,
    pub(super) budget: Budget,
}

impl<'a> Package<'a> {
    pub(super) fn open(bytes: &'a [u8]) -> Result<Self, Flaw> {
        if !bytes.starts_with(b"PK") {
            return Err(Flaw::new("a zip archive", shown(bytes)));
        }
        let archive = ZipArchive::new(Cursor::new(bytes)).map_err(|e| Flaw::new("a zip archive", e.to_string()))?;
        Ok(Self { archive, budget: Budget::of_file(bytes.len()) })
    }

    /// Returns the text of a part. A path may begin with a slash, and its case doesn't matter.
    pub(super) fn part(&mut self, path: &str) -> Result<String, Flaw> {
        let number = self.number(path).ok_or_else(|| Flaw::new(format!("the part {path} in the archive"), "none"))?;
        let file = self.archive.by_index(number);
        let file = file.map_err(|e| Flaw::new(format!("the part {path} in the archive"), e.to_string()))?;
        // One byte more than the budget allows is read, so that `spend` rejects a part that is too large.
        let bytes = inflated(file, self.budget.left().saturating_add(1), "a part of a zip archive")?;
        self.budget.spend(bytes.len() as u64, "parts of")?;
        if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
            return Err(Flaw::unsupported("XML in UTF-16", "save it in UTF-8"));
        }
        // Invalid UTF-8 is replaced instead of rejected, because only names can contain it.
        Ok(String::from_utf8(bytes).unwrap_or_else(|e| String::from_utf8_lossy(e.as_bytes()).into_owned()))
    }

    fn number(&self, path: &str) -> Option<usize> {
        let path = path.trim_start_matches('/');
        self.archive
            .file_names()
            .position(|name| name.is_ok_and(|name| name.trim_start_matches('/').eq_ignore_ascii_case(path)))
    }

    /// Returns the path of the model as stated by the archive's relationships, or the usual path if the relationships
    /// state no path.
    pub(super) fn model_path(&mut self) -> Result<String, Flaw> {
        if self.number(RELATIONSHIPS).is_none() {
            return Ok(MODEL.to_owned());
        }
        let text = self.part(RELATIONSHIPS)?;
        let mut found = None;
        walk(&text, true, |step| {
            let Step::Start(tag) = step else { return Ok(()) };
            let (mut target, mut is_model) = (None, false);
            tag.attributes(|name, value| {
                match local(name) {
                    "Target" => target = Some(value.into_owned()),
                    "Type" => is_model = value == MODEL_TYPE,
                    _ => {}
                }
                Ok(())
            })?;
            if is_model && found.is_none() {
                found = target;
            }
            Ok(())
        })?;
        Ok(found.unwrap_or_else(|| MODEL.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_found_whatever_their_case_and_slash() {
        let mut bytes = Cursor::new(Vec::new());
        let mut zip = zip::ZipWriter::new(&mut bytes);
        zip.start_file("3D/3DModel.model", zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut zip, b"text").unwrap();
        zip.finish().unwrap();
        let bytes = bytes.into_inner();
        let mut package = Package::open(&bytes).unwrap();
        assert_eq!(package.model_path().unwrap(), MODEL);
        assert_eq!(package.part("/3d/3dmodel.model").unwrap(), "text");
        assert!(package.part("other").is_err());
    }
}
