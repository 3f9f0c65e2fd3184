//! Runs the group level of the BIDS app: writes an array with the coefficients of all models, the models' modes of
//! variation, and a page.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use ndarray::Array3;
use spharm::Model;
use spharm_cli::output::{counted, first_of, print_line};
use spharm_cli::paths::model_name;
use spharm_cli::paths::shown;
use spharm_cohort::Merged;
use spharm_model::arrays::{Entry, write_arrays};
use spharm_model::recorded_name;

use super::args::{Cli, Hemi, Surface};
use super::dataset::text;

/// Gathers the models made by the participant level, and writes the group's arrays, modes, status table and page.
pub(super) fn run(cli: &Cli, spharm: &dyn Fn(&[String]) -> Result<()>) -> Result<()> {
    let logs = cli.output.join("logs");
    if !logs.is_dir() {
        bail!(
            "{}: expected the output folder of the participant level, found no folder `logs` in it",
            cli.output.display()
        );
    }
    status(cli, &logs)?;
    let (mut modes, mut models) = (Vec::new(), 0);
    for &hemi in &cli.hemi {
        for &surface in &cli.surfaces {
            let group = gather(&cli.output, hemi, surface)?;
            if group.is_empty() {
                cli.common.console().warn(format!("found no model of hemi-{} {}", hemi.label(), surface.name()));
                continue;
            }
            models += group.len();
            write(cli, hemi, surface, &group)?;
            if group.len() > 2 {
                modes.push(variation(cli, hemi, surface, &group, spharm)?);
            } else {
                let (hemi, surface, found) = (hemi.label(), surface.name(), counted(group.len(), "model"));
                cli.common
                    .console()
                    .warn(format!("hemi-{hemi} {surface}: modes of variation need at least 3 models, found {found}"));
            }
        }
    }
    if models == 0 {
        bail!("{}: found no models; run the participant level first", cli.output.display());
    }
    if !cli.no_pages {
        let mut arguments = vec!["report".to_owned()];
        if !modes.is_empty() {
            arguments.push("--modes".to_owned());
            arguments.extend(modes);
        }
        let (table, page) = (cli.output.join("group_status.tsv"), cli.output.join("group.html"));
        arguments.extend(["--status", &shown(&table), "--title", "Group", "--force"].map(str::to_owned));
        arguments.extend(["--output", &shown(&page)].map(str::to_owned));
        spharm(&super::command(cli, arguments))?;
    }
    print_line(&format!("{}: {}", cli.output.display(), counted(models, "model")))
}

/// Writes one status table that merges those of all calls of the participant level: the outcome of each surface.
fn status(cli: &Cli, logs: &Path) -> Result<()> {
    let mut files: Vec<PathBuf> = listed(logs)?;
    files.retain(|path| path.to_string_lossy().ends_with("_status.tsv"));
    let merged = Merged::read(&files)?;
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
    writer.write_record(["id", "state", "msd", "xsd", "error"])?;
    for entry in merged.entries() {
        let number = |value: Option<f64>| value.map_or(String::new(), spharm_monitor::number);
        let (msd, xsd) = (number(entry.msd), number(entry.xsd));
        let state = if entry.state.is_there() { "done" } else { entry.state.name() };
        writer.write_record([&entry.id, state, &msd, &xsd, &entry.error])?;
    }
    let lost = merged.entries().iter().filter(|entry| !entry.state.is_there()).count();
    if lost > 0 {
        let (lost, table) = (counted(lost, "surface"), cli.output.join("group_status.tsv"));
        cli.common.console().warn(format!("{lost} without a model; see {} for the reasons", table.display()));
    }
    text(&cli.output.join("group_status.tsv"), &String::from_utf8(writer.into_inner()?)?)
}

/// Returns the sorted paths of the models of one surface (such as pial) of one hemisphere, over all subjects.
fn gather(output: &Path, hemi: Hemi, surface: Surface) -> Result<Vec<PathBuf>> {
    let ending = format!("_hemi-{}_desc-spharm_{}.npz", hemi.label(), surface.name());
    let mut models = Vec::new();
    for subject in listed(output)?.into_iter().filter(|path| named(path, "sub-") && path.is_dir()) {
        let sessions = listed(&subject)?.into_iter().filter(|path| named(path, "ses-"));
        for folder in
            sessions.chain([subject.clone()]).map(|folder| folder.join("anat")).filter(|folder| folder.is_dir())
        {
            models.extend(listed(&folder)?.into_iter().filter(|path| path.to_string_lossy().ends_with(&ending)));
        }
    }
    models.sort_unstable();
    Ok(models)
}

/// Writes the coefficients of a group's models as an array of shape (subjects, (L + 1)^2, 3), and a file with the
/// models' names, one per line. L is the lowest degree of the models.
fn write(cli: &Cli, hemi: Hemi, surface: Surface, group: &[PathBuf]) -> Result<()> {
    let models = group.iter().map(Model::read).collect::<Result<Vec<_>, _>>()?;
    if let Some(warning) = other_spaces(&models, group) {
        cli.common.console().warn(format!("hemi-{} {}: {warning}", hemi.label(), surface.name()));
    }
    let degree = models.iter().map(|model| model.coefficients.max_degree()).min().unwrap_or(0);
    let mut coefficients = Array3::zeros((models.len(), (degree + 1) * (degree + 1), 3));
    for (mut of, (model, path)) in coefficients.outer_iter_mut().zip(models.iter().zip(group)) {
        let values = model.coefficients.up_to(degree);
        if values.ncols() != 3 {
            bail!("{}: expected a model of a surface, found a model with {} channels", path.display(), values.ncols());
        }
        of.assign(&values);
    }
    let names: Vec<String> = group.iter().map(|path| model_name(path)).collect();
    let entries = [("coefficients", Entry::Cube(coefficients.view())), ("models", Entry::Text(&names.join("\n")))];
    write_arrays(&cli.output.join(format!("group_{}_models.npz", of(hemi, surface))), true, &entries)?;
    Ok(())
}

/// Returns a warning if the models' spheres aren't all registered to the same space.
fn other_spaces(models: &[Model], paths: &[PathBuf]) -> Option<String> {
    /// Maximum number of models named in the warning.
    const NAMED: usize = 6;
    let mut spaces: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (model, path) in models.iter().zip(paths) {
        if let Some(space) = space(model) {
            spaces.entry(space).or_default().push(model_name(path));
        }
    }
    let usual = spaces.iter().max_by_key(|(_, names)| names.len())?.0.clone();
    spaces.remove(&usual);
    let others = spaces.iter().map(|(space, names)| {
        let are = if names.len() == 1 { "uses" } else { "use" };
        format!("{} {are} a sphere registered to {space}", first_of(names.iter().map(String::as_str), NAMED))
    });
    let others: Vec<String> = others.collect();
    (!others.is_empty()).then(|| {
        format!(
            "{}, but the other models use spheres registered to {usual}, so equal directions don't correspond; fit the \
             named models over spheres registered to {usual}, or remove them",
            others.join("; ")
        )
    })
}

/// Returns the space to which the sphere of a model is registered, according to the name of the sphere's file. A name
/// without a space, such as FreeSurfer's `lh.sphere.reg`, means fsaverage. Returns `None` if the model doesn't record
/// the name of its sphere.
fn space(model: &Model) -> Option<String> {
    let name = recorded_name(model.provenance.sphere.as_deref()?);
    let space = name.split('_').find_map(|part| part.strip_prefix("space-"));
    Some(space.unwrap_or("fsaverage").to_owned())
}

/// Aligns the models in space, without rotating their spheres, and writes their modes of variation. Directions on the
/// spheres already correspond, because the spheres are registered.
fn variation(
    cli: &Cli,
    hemi: Hemi,
    surface: Surface,
    group: &[PathBuf],
    spharm: &dyn Fn(&[String]) -> Result<()>,
) -> Result<String> {
    let folder = cli.output.join("logs").join(format!("aligned_{}", of(hemi, surface)));
    let list = cli.output.join("logs").join(format!("models_{}.txt", of(hemi, surface)));
    let lines = group.iter().map(|path| -> Result<String> {
        let path = std::path::absolute(path).with_context(|| path.display().to_string())?;
        Ok(shown(&path) + "\n")
    });
    text(&list, &lines.collect::<Result<String>>()?)?;
    let at = |list: &Path| format!("@{}", shown(list));
    let run = |arguments: &[&str]| {
        let arguments = arguments.iter().map(|argument| (*argument).to_owned()).collect();
        spharm(&super::command(cli, arguments))
    };
    run(&["shape", "align", &at(&list), "--group", "--method", "fixed", "--force", "--output", &shown(&folder)])?;
    let names = group.iter().map(|path| format!("{}/{}.spharm.npz\n", of(hemi, surface), model_name(path)));
    let aligned = cli.output.join("logs").join(format!("aligned_{}.txt", of(hemi, surface)));
    text(&aligned, &names.map(|name| format!("aligned_{name}")).collect::<String>())?;
    let modes = shown(cli.output.join(format!("group_{}.shape-model.npz", of(hemi, surface))));
    run(&["shape", "pca", &at(&aligned), "--modes", "10", "--force", "--output", &modes])?;
    Ok(modes)
}

fn of(hemi: Hemi, surface: Surface) -> String {
    format!("hemi-{}_{}", hemi.label(), surface.name())
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>> {
    let read = || format!("{}: cannot read the folder", folder.display());
    let entries: Vec<_> = std::fs::read_dir(folder).with_context(read)?.collect::<Result<_, _>>().with_context(read)?;
    Ok(entries.iter().map(std::fs::DirEntry::path).collect())
}

fn named(path: &Path, start: &str) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(start))
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm::{Coefficients, Kind};

    #[test]
    fn spheres_of_another_space_are_warned_of() {
        let model = |sphere: &str| {
            let coefficients = Coefficients::new(ndarray::Array2::ones((4, 3))).unwrap();
            let mut model = Model::without_sphere(coefficients, Kind::Surface);
            model.provenance.sphere = Some(format!("anat/{sphere}"));
            model
        };
        let paths: Vec<PathBuf> = (1..=3).map(|subject| format!("sub-{subject}_pial.npz").into()).collect();
        let [freesurfer, average, other] = [
            "lh.sphere.reg",
            "sub-2_hemi-L_space-fsaverage_desc-reg_sphere.surf.gii",
            "sub-3_hemi-L_space-fsLR_desc-msmsulc_sphere.surf.gii",
        ]
        .map(model);
        assert_eq!(other_spaces(&[freesurfer.clone(), average.clone(), average.clone()], &paths), None);
        let warning = other_spaces(&[freesurfer, average, other], &paths).unwrap();
        assert!(warning.starts_with("sub-3_pial uses a sphere registered to fsLR, but the other"), "{warning}");
        assert!(warning.contains("registered to fsaverage, so"), "{warning}");
        let elsewhere = model(r"of_space-fsLR_data\lh.sphere.reg");
        assert_eq!(space(&elsewhere).as_deref(), Some("fsaverage"), "a folder of another operating system");
    }
}
