//! Reads the subjects of a study, with their landmarks and signals. The study's table is either a manifest, or a table
//! of ids and covariates with patterns that name the files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cohort::Manifest;

use super::config::Subjects;
use super::sides::{COLUMNS, NO_MASK, SIDE, filled, id_of};
use spharm_analysis::With;
use spharm_analysis::table::{LANDMARKS, files_of};
use spharm_cli::cells::check_cells;
use spharm_cli::freesurfer::cortex_label;

/// Placeholder of the id in a pattern.
pub(super) const ID: &str = "{id}";
/// Maximum size of a table in bytes; the tables of studies are far smaller.
const LARGEST: u64 = 64 << 20;

/// Returns the manifest of a study's subjects. If the table isn't itself a manifest, also returns the text of the
/// manifest that is to be written to the path `made`. Patterns are relative to `folder`, the folder of the study file.
///
/// # Errors
///
/// If the table can't be read or is malformed, or a pattern has no `{id}`.
pub(super) fn manifest(
    subjects: &Subjects,
    folder: &Path,
    table: &Path,
    made: &Path,
) -> Result<(Manifest, Option<Vec<u8>>)> {
    let Some(surface) = &subjects.surface else {
        if subjects.sphere.is_some() {
            bail!("`sphere` in [subjects] is a pattern, so it also needs a `surface` pattern");
        }
        let mut manifest = Manifest::read(table)?;
        // The fit gets the label as an argument, because its manifest is the table itself.
        if let Some(label) = subjects.label {
            manifest.label_volumes(label);
        }
        return Ok((manifest, None));
    };
    has_id("surface", surface)?;
    subjects.sphere.as_deref().map_or(Ok(()), |pattern| has_id("sphere", pattern))?;
    let text = text(subjects, folder, table, surface).with_context(|| table.display().to_string())?;
    // Errors in the manifest `made` state the path of the user's table, because only ids can be wrong, and the ids come
    // from the table. The line numbers are those of `made`, which differ from those of the table.
    let manifest = Manifest::parse(made, &text).with_context(|| table.display().to_string())?;
    Ok((manifest, Some(text)))
}

/// Returns the landmark file of each subject: from the pattern, relative to `folder`, or else from the table's column,
/// relative to the table. Returns `None` if the study has no landmarks.
///
/// # Errors
///
/// If the pattern has no `{id}`, or a cell is empty.
pub(super) fn landmarks(
    subjects: &Subjects,
    folder: &Path,
    table: &Path,
    manifest: &Manifest,
) -> Result<Option<Vec<PathBuf>>> {
    if let Some(pattern) = &subjects.landmarks {
        has_id(LANDMARKS, pattern)?;
        let of = |row| folder.join(filled(pattern, subjects, manifest, row));
        return Ok(Some(manifest.rows.iter().map(of).collect()));
    }
    files_of(manifest, LANDMARKS, table)
}

/// Returns the files of the signals that guide the correspondence, one list per subject. Each signal is a column of the
/// table or a pattern.
///
/// # Errors
///
/// If a signal is neither a pattern with `{id}` nor a column of the table, or a cell is empty.
pub(super) fn guides(
    signals: &[With],
    subjects: &Subjects,
    folder: &Path,
    table: &Path,
    manifest: &Manifest,
) -> Result<Vec<Vec<PathBuf>>> {
    let mut files = vec![Vec::new(); manifest.rows.len()];
    for With { name, .. } in signals {
        let found = of_name("`signals` in [align]", name, subjects, (folder, table), manifest)?;
        files.iter_mut().zip(found).for_each(|(files, file)| files.push(file));
    }
    Ok(files)
}

/// Returns the file of each subject for a key whose value is a pattern, relative to `folder`, or a column of the
/// table.
fn of_name(
    key: &str,
    name: &str,
    subjects: &Subjects,
    (folder, table): (&Path, &Path),
    manifest: &Manifest,
) -> Result<Vec<PathBuf>> {
    if name.contains(ID) {
        return Ok(manifest.rows.iter().map(|row| folder.join(filled(name, subjects, manifest, row))).collect());
    }
    files_of(manifest, name, table)?.with_context(|| {
        format!("{key}: expected a column of {} or a pattern with {ID}, found {name:?}", table.display())
    })
}

/// Returns the manifest of the subjects' signals, which is to be written to the path `made`, and its text. Returns
/// `None` if the study has no signal. The default mask is FreeSurfer's label of the cortex.
///
/// # Errors
///
/// If a file is given neither by a pattern with `{id}` nor by a column of the table, or a cell is empty.
pub(super) fn signals(
    subjects: &Subjects,
    folder: &Path,
    table: &Path,
    manifest: &Manifest,
    made: &Path,
) -> Result<Option<(Manifest, Vec<u8>)>> {
    let Some(signal) = &subjects.signal else {
        if subjects.mask.is_some() {
            bail!("`mask` in [subjects] selects vertices of `signal`, but no `signal` is given");
        }
        return Ok(None);
    };
    let signals = of_name("`signal` in [subjects]", signal, subjects, (folder, table), manifest)?;
    let masks: Vec<Option<PathBuf>> = match subjects.mask.as_deref() {
        Some(NO_MASK) => vec![None; signals.len()],
        Some(mask) => {
            let masks = of_name("`mask` in [subjects]", mask, subjects, (folder, table), manifest)?;
            masks.into_iter().map(Some).collect()
        }
        None => {
            let masks: Vec<Option<PathBuf>> = signals.iter().map(|signal| cortex_label(signal)).collect();
            // Refuse a study in which only some subjects have a mask, because the mask changes the values.
            let without = masks.iter().zip(&manifest.rows).find(|(mask, _)| mask.is_none());
            if let Some((_, row)) = without.filter(|_| masks.iter().any(Option::is_some)) {
                bail!(
                    "{} has no cortex label for its signal, but other subjects have one; give `mask` in [subjects], \
                     or mask = \"none\" to use all vertices",
                    row.id
                );
            }
            masks
        }
    };
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
    writer.write_record(["id", "surface", "sphere", "signal_mask"])?;
    let path = |path: &Path| -> Result<String> { Ok(std::path::absolute(path)?.display().to_string()) };
    for ((row, signal), mask) in manifest.rows.iter().zip(&signals).zip(&masks) {
        let given = |file: Option<&PathBuf>| file.map_or(Ok(String::new()), |file| path(file));
        writer.write_record([row.id.clone(), path(signal)?, given(row.sphere.as_ref())?, given(mask.as_ref())?])?;
    }
    let text = writer.into_inner()?;
    Ok(Some((Manifest::parse(made, &text)?, text)))
}

fn has_id(key: &str, pattern: &str) -> Result<()> {
    if !pattern.contains(ID) {
        bail!("`{key}` in [subjects]: expected a pattern with {ID}, found {pattern:?}");
    }
    Ok(())
}

fn text(subjects: &Subjects, folder: &Path, table: &Path, surface: &str) -> Result<Vec<u8>> {
    let given = spharm_files::read_text(table, LARGEST)?;
    let commas = table.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(if commas { b',' } else { b'\t' })
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(given.as_bytes());
    let header = reader.headers()?.clone();
    let Some(id) = header.iter().position(|name| name == subjects.id) else {
        bail!("expected a column {:?}, found {}", subjects.id, header.iter().collect::<Vec<_>>().join(", "));
    };
    let two = !subjects.sides.is_empty();
    let reserved = ["id", "surface", "sphere", "weights", "output", "label", "signal_mask"].into_iter();
    let of_sides: Vec<&str> = COLUMNS.into_iter().chain(subjects.sides.iter().map(String::as_str)).collect();
    let reserved: Vec<&str> = reserved.chain(of_sides.iter().copied().filter(|_| two)).collect();
    if let Some(taken) = header.iter().enumerate().find(|(at, name)| *at != id && reserved.contains(name)) {
        let with = if of_sides.contains(&taken.1) { "`sides`" } else { "a `surface` pattern" };
        bail!("column {:?} cannot be used with {with} in [subjects]", taken.1);
    }
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
    let others = |record: &csv::StringRecord| -> Vec<String> {
        record.iter().enumerate().filter(|(at, _)| *at != id).map(|(_, cell)| cell.to_owned()).collect()
    };
    let own = ["id", "surface", "sphere", "label"].map(str::to_owned);
    let of_sides = COLUMNS.map(str::to_owned).into_iter().filter(|_| two);
    writer.write_record(own.into_iter().chain(others(&header)).chain(of_sides))?;
    // Without sides, a subject has a single row.
    let sides: Vec<Option<&String>> = if two { subjects.sides.iter().map(Some).collect() } else { vec![None] };
    for record in reader.records() {
        let record = record?;
        check_cells(&given, &record, header.len(), true)?;
        let name = record.get(id).unwrap_or_default();
        for (index, side) in sides.iter().enumerate() {
            let file = |pattern: &str| -> Result<String> {
                let path = pattern.replace(ID, name).replace(SIDE, side.map_or(SIDE, String::as_str));
                Ok(std::path::absolute(folder.join(path))?.display().to_string())
            };
            let row = side.map_or_else(|| name.to_owned(), |side| id_of(name, side));
            let sphere = subjects.sphere.as_deref().map_or(Ok(String::new()), file)?;
            let label = subjects.labels.get(index).or(subjects.label.as_ref()).map(i64::to_string).unwrap_or_default();
            let of_side = side.map(|side| [name.to_owned(), side.clone()]);
            let cells = [row, file(surface)?, sphere, label].into_iter().chain(others(&record));
            writer.write_record(cells.chain(of_side.into_iter().flatten()))?;
        }
    }
    Ok(writer.into_inner()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_name_the_files_of_ids() {
        let site = tempfile::tempdir().unwrap();
        let table = site.path().join("participants.tsv");
        std::fs::write(&table, "participant_id\tgroup\nsub-01\ta\nsub-02\tb\n").unwrap();
        let subjects = Subjects {
            surface: Some("fs/{id}/surf/lh.pial".to_owned()),
            sphere: Some("fs/{id}/surf/lh.sphere.reg".to_owned()),
            id: "participant_id".to_owned(),
            ..Subjects::default()
        };
        let of = |subjects: &Subjects| manifest(subjects, site.path(), &table, &site.path().join("made.tsv"));
        let (found, text) = of(&subjects).unwrap();
        assert!(text.is_some());
        assert_eq!((found.rows.len(), &found.columns), (2, &vec!["group".to_owned()]));
        assert_eq!(found.rows[1].surface, site.path().join("fs/sub-02/surf/lh.pial"));
        assert_eq!(found.rows[1].sphere, Some(site.path().join("fs/sub-02/surf/lh.sphere.reg")));
        for (subjects, expected) in [
            (Subjects { surface: Some("lh.pial".to_owned()), ..subjects.clone() }, "{id}"),
            (Subjects { surface: None, ..subjects.clone() }, "needs a `surface` pattern"),
            (Subjects { id: "id".to_owned(), ..subjects.clone() }, "participant_id"),
        ] {
            let error = format!("{:#}", of(&subjects).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
        std::fs::write(&table, "participant_id\tgroup\nsub-01\ta\n../x\tb\n").unwrap();
        assert!(format!("{:#}", of(&subjects).unwrap_err()).contains("separators"));
        std::fs::write(&table, "participant_id\tgroup\r\nsub-01\ta\r\nsub-02\r\n").unwrap();
        let error = format!("{:#}", of(&subjects).unwrap_err());
        assert!(error.contains("line 3: expected 2 cells as in the header, found 1"), "{error}");
    }
}
