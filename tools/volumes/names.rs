//! Makes the names of models, which may contain the channel number and the time number of the image.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Result, anyhow};
use spharm::FileRecord;
use spharm::parametrize::volume::ImageChoice;
use spharm_cli::Usage;
use spharm_cli::names::NameTemplate;

/// Placeholders of the channel and of the time.
const IMAGE: [&str; 2] = ["{channel}", "{time}"];

/// A template for names, in which `{channel}` and `{time}` are replaced by the numbers of the chosen image.
#[derive(Debug, Clone)]
pub(super) struct ImageTemplate(String);

impl FromStr for ImageTemplate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        IMAGE
            .iter()
            .fold(text.to_owned(), |text, placeholder| text.replace(placeholder, "1"))
            .parse::<NameTemplate>()?;
        Ok(Self(text.to_owned()))
    }
}

impl ImageTemplate {
    /// Returns the template for the names of the models made from an image.
    ///
    /// # Errors
    ///
    /// [`Usage`] if the template has a placeholder whose number isn't given.
    pub(super) fn of(&self, image: ImageChoice) -> Result<NameTemplate, Usage> {
        let mut text = self.0.clone();
        for (placeholder, number) in IMAGE.into_iter().zip([image.channel, image.time]) {
            if !text.contains(placeholder) {
                continue;
            }
            let Some(number) = number else {
                let flag = placeholder.trim_matches(['{', '}']);
                let message = format!("--name-template '{}' has {placeholder}, so --{flag} must be given", self.0);
                return Err(Usage::missing(message));
            };
            text = text.replace(placeholder, &number.to_string());
        }
        text.parse().map_err(Usage::invalid)
    }
}

/// Returns the part of a message that advises how to write the models of several images of one file to one folder;
/// empty if no image is chosen.
pub(super) fn advice_on_images(image: ImageChoice) -> String {
    let template = match (image.channel, image.time) {
        (None, None) => return String::new(),
        (Some(_), None) => "{stem}.c{channel}",
        (None, Some(_)) => "{stem}.t{time}",
        (Some(_), Some(_)) => "{stem}.c{channel}.t{time}",
    };
    format!("; to write several channels or times to one folder, give --skip-existing --name-template '{template}'")
}

/// Returns the error for a label whose model would have the same path as a model made from the volume `first`.
pub(super) fn same_name(record: &FileRecord, model: &Path, first: &Path, volume: &Path) -> anyhow::Error {
    let files: [PathBuf; 2] = [first.to_owned(), volume.to_owned()];
    let remedy = match NameTemplate::distinguishing(&files) {
        Some(template) => format!("give --name-template '{template}'"),
        None => "rename one of the files, or process the files in separate calls".to_owned(),
    };
    anyhow!("{record}: {} is the model of another file, {}; {remedy}", model.display(), first.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_the_numbers_of_the_image() {
        let image = ImageChoice { channel: Some(2), time: Some(14) };
        let name = |template: &str, image| {
            let template = template.parse::<ImageTemplate>()?.of(image).map_err(|error| error.to_string())?;
            Ok::<_, String>(template.name(Path::new("/data/cells.tif"), Some(7)))
        };
        assert_eq!(name("{stem}.c{channel}.t{time}", image).unwrap(), "cells.c2.t14.7");
        assert_eq!(name("{stem}", image).unwrap(), "cells.7");
        let missing = name("{stem}.t{time}", ImageChoice::default()).unwrap_err();
        assert!(missing.contains("has {time}, so --time must be given"), "{missing}");
        assert!(name("t{time}", image).unwrap_err().contains("expected a placeholder"));
        assert!(name("{stem}{times}", image).unwrap_err().contains("{times}"));
    }
}
