//! Checks the keys of a study's file: reports unknown keys, with the most similar known key, and missing keys.

use anyhow::{Result, bail};
use toml::{Table, Value};

use super::exclusion::check_list;
use super::test::KEYS;

/// Keys of each section: the section's name, the number of required keys, and all keys, the required ones first.
const SECTIONS: [(&str, usize, &[&str]); 8] = [
    ("", 0, &["title", "output", "subjects", "fit", "align", "modes", "quality", "test", "page"]),
    (
        "subjects",
        1,
        &[
            "table",
            "id",
            "surface",
            "sphere",
            "landmarks",
            "signal",
            "mask",
            "label",
            "sides",
            "labels",
            "exclude",
            "accept",
        ],
    ),
    ("fit", 1, &["max_degree", "arguments"]),
    ("align", 0, &["method", "pose", "scale", "mirror", "guide", "signals"]),
    ("modes", 0, &["count"]),
    ("quality", 0, &["plain", "surfaces"]),
    ("page", 0, &["subjects"]),
    ("test", 1, &KEYS),
];

/// Checks that all keys are known, and that none is missing.
pub(super) fn check(table: &Table) -> Result<()> {
    for (section, needed, keys) in SECTIONS {
        let parts: Vec<&Table> = match table.get(section) {
            _ if section.is_empty() => vec![table],
            None if needed == 0 || section == "test" => continue,
            None => bail!("expected a section [{section}], found none"),
            Some(Value::Table(part)) if section != "test" => vec![part],
            Some(Value::Array(parts)) if section == "test" => match parts.iter().map(Value::as_table).collect() {
                Some(parts) => parts,
                None => bail!("expected [[test]], a table for each test; found another value"),
            },
            Some(_) if section == "test" => {
                bail!("expected [[test]], with double brackets, for each test; found `test` in another form")
            }
            Some(_) => bail!("expected a section [{section}], found a value"),
        };
        let place = match section {
            "" => String::new(),
            "test" => " in [[test]]".to_owned(),
            _ => format!(" in [{section}]"),
        };
        for part in parts {
            if let Some(unknown) = part.keys().find(|key| !keys.contains(&key.as_str())) {
                let nearest = keys
                    .iter()
                    .map(|key| (strsim::damerau_levenshtein(unknown, key), key))
                    .min()
                    .filter(|(distance, key)| *distance <= 2.max(key.len() / 3));
                match nearest {
                    Some((_, nearest)) => bail!("unknown key `{unknown}`{place}: did you mean `{nearest}`?"),
                    None if section == "fit" => bail!(
                        "unknown key `{unknown}`{place}: to pass an option to spharm fit, write `arguments = [\"--{}\"]`",
                        unknown.replace('_', "-")
                    ),
                    None => bail!("unknown key `{unknown}`{place}: expected one of {}", keys.join(", ")),
                }
            }
            for key in ["exclude", "accept"] {
                part.get(key).filter(|_| section == "subjects").map_or(Ok(()), |list| check_list(key, list))?;
            }
            if let Some(missing) = keys[..needed].iter().find(|key| !part.contains_key(**key)) {
                bail!("expected a key `{missing}`{place}, found none");
            }
        }
    }
    Ok(())
}
