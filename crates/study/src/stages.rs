//! The stages of a study, each a command of spharm.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use spharm::parametrize::volume::is_volume;
use spharm_cohort::{Row, Shard};

use super::config::Method;
use super::fits::{Fits, SURFACES};
use super::lists::{MIRRORED, MIRRORED_SIGNALS};
use super::methods;
use super::plan::{PLAIN, Plan, Subject, text};
use super::provenance;
use super::stage::Stage;
use super::surfaces::signal_column;
use super::test::Test;
use spharm_analysis::Poses;
use spharm_analysis::With;

/// Name of the stage of the quality control.
pub(super) const CHECK: &str = "check";

impl Plan {
    /// Returns the stage that runs the fits. It has no inputs or outputs, because `fit` itself determines which models
    /// are up to date.
    pub(super) fn fit(&self, fits: &Fits<'_>, shard: Option<Shard>, force: bool) -> Stage {
        let mut arguments = words(&["fit", "--manifest", &text(&fits.manifest.path), "--output", &text(&fits.models)]);
        arguments.extend(words(&["--max-degree", &self.study.fit.max_degree.to_string(), "--keep-going"]));
        arguments.extend(words(&["--status", &text(&fits.status_file(shard))]));
        arguments.extend(words(&[if force { "--force" } else { "--update" }]));
        arguments.extend(shard.iter().flat_map(|shard| words(&["--shard", &shard.to_string()])));
        match fits.name {
            SURFACES => {
                arguments.extend(self.fit_arguments());
                let is_labelled = self.manifest.rows.iter().any(|row| row.label.is_some());
                let of_table = self.study.subjects.surface.is_none() && self.study.fit.sphere().is_none();
                let of_all = self.study.subjects.label.filter(|_| is_labelled && of_table);
                arguments.extend(of_all.iter().flat_map(|label| words(&["--label", &label.to_string()])));
            }
            // Fits of signals get only the sphere, because the other arguments apply to surfaces.
            _ => arguments.extend(self.study.fit.sphere().iter().flat_map(|sphere| words(&["--sphere", sphere]))),
        }
        let (folder, name) = (self.folder.clone(), fits.name.to_owned());
        Stage { folder, name, arguments, inputs: Vec::new(), outputs: Vec::new() }
    }

    /// Returns the arguments for fitting the surfaces: the arguments in the study's file, and the arguments that the
    /// study chooses.
    pub(super) fn fit_arguments(&self) -> Vec<String> {
        let chosen = self.maps_equal_areas().then_some(["--area", "0"]).into_iter().flatten().map(str::to_owned);
        self.study.fit.arguments.iter().cloned().chain(chosen).collect()
    }

    /// Returns the value of `--area` for fitting the surfaces, if it is given or chosen.
    pub(super) fn area(&self) -> Option<f64> {
        if self.maps_equal_areas() { Some(0.0) } else { self.study.fit.value("--area")?.parse().ok() }
    }

    /// Returns whether the fits map surfaces to the sphere with areas as equal as possible (`--area 0`). Meshes that
    /// are mapped individually and aligned by `joint` correspond better with such maps (docs/shape.md).
    fn maps_equal_areas(&self) -> bool {
        let is_mesh = |row: &Row| row.sphere.is_none() && !is_volume(&row.surface);
        self.method == Method::Joint
            && !self.has_one_sphere()
            && self.study.fit.value("--area").is_none()
            && self.manifest.rows.iter().all(is_mesh)
    }

    /// Returns the stages after the fits, for the subjects that have models.
    pub(super) fn stages(&self, subjects: &[Subject<'_>]) -> Vec<Stage> {
        let (study, at) = (&self.study, |name: &str| self.output.join(name));
        let models: Vec<PathBuf> = subjects.iter().map(|subject| subject.model.clone()).collect();
        let modes = at("group.shape-model.npz");
        let of_models = |verb: &str, file: &str| {
            let arguments = ["shape", verb, &self.list("models.txt"), "--names", "-o", &text(&at(file))];
            self.stage(verb, words(&arguments), &models, [at(file)])
        };
        let mut stages = vec![of_models("measure", "measures.csv"), of_models("describe", "descriptors.csv")];
        stages.push(self.together(subjects, &models));
        stages.extend(self.mirror_signals(subjects));
        let aligned = self.aligned(subjects);
        let count = study.modes.count.to_string();
        let scores = at("scores.csv");
        let mut arguments = words(&["shape", "pca", &self.list("aligned.txt"), "--modes", &count]);
        arguments.extend(words(&["--scores", &text(&scores), "-o", &text(&modes)]));
        stages.push(self.stage("modes", arguments, &aligned, [modes, scores]));
        stages.push(self.check(&models, &aligned));
        for test in &study.test {
            stages.extend(self.test(test, subjects));
        }
        stages.extend(self.quality(subjects, &models, &aligned));
        stages.push(self.report(subjects));
        stages
    }

    /// Returns the stage that brings the subjects into correspondence and computes their mean.
    fn together(&self, subjects: &[Subject<'_>], models: &[PathBuf]) -> Stage {
        let mean = self.mean();
        match self.method {
            Method::Correspond => self.correspond(subjects),
            Method::Joint | Method::Fixed => {
                let (transforms, warnings) = (self.output.join("transforms.json"), self.alignment_warnings());
                let mut arguments = self.align(subjects, "--method", self.method.name(), &self.aligned_folder());
                arguments.extend(words(&["--mean", &text(&mean), "--transforms", &text(&transforms)]));
                arguments.extend(words(&["--warnings", &text(&warnings)]));
                self.stage("align", arguments, models, [self.aligned_folder(), mean, transforms, warnings])
            }
            Method::None => {
                let arguments = words(&["shape", "mean", &self.list("aligned.txt"), "-o", &text(&mean)]);
                self.stage("mean", arguments, models, [mean])
            }
        }
    }

    /// Returns the stage that mirrors the signals of mirrored subjects, if the study has such signals.
    fn mirror_signals(&self, subjects: &[Subject<'_>]) -> Option<Stage> {
        let fits = self.signal_fits()?;
        let mirrored = subjects.iter().filter(|subject| subject.mirrored);
        let models: Vec<PathBuf> = mirrored.map(|subject| fits.model(subject.id)).collect();
        let folder = self.mirrored_signals();
        let list = self.list(MIRRORED_SIGNALS);
        let arguments = words(&["shape", "rotate", &list, "--mirror", "-o", &text(&folder)]);
        (!models.is_empty()).then(|| self.stage("mirror.signal", arguments, &models, [folder]))
    }

    fn correspond(&self, subjects: &[Subject<'_>]) -> Stage {
        let (folder, report, warnings) = (self.aligned_folder(), self.correspondence(), self.alignment_warnings());
        let (table, degree) = (self.records().join("surfaces.tsv"), self.study.fit.max_degree.to_string());
        let mut arguments = words(&["shape", "correspond", "--table", &text(&table), "--max-degree", &degree]);
        arguments.extend(words(&["-o", &text(&folder), "--report", &text(&report), "--warnings", &text(&warnings)]));
        let pose = self.study.align.pose;
        if let Some(value) = pose.to_possible_value().filter(|_| pose != Poses::Any) {
            arguments.extend(words(&["--pose", value.get_name()]));
        }
        arguments.extend(self.moved());
        if self.study.align.guide {
            arguments.push("--guide".to_owned());
        }
        for (index, With { weight, .. }) in self.study.align.signals.iter().enumerate() {
            arguments.extend(["--with".to_owned(), format!("{}:{weight}", signal_column(index))]);
        }
        if subjects.iter().any(|subject| is_volume(&subject.surface)) {
            arguments.extend(self.study.fit.of_volumes());
        }
        let files = subjects
            .iter()
            .flat_map(|subject| std::iter::once(&subject.surface).chain(&subject.landmarks).chain(subject.guides));
        let inputs: Vec<PathBuf> = std::iter::once(&table).chain(files).cloned().collect();
        self.stage("correspond", arguments, &inputs, [folder, report, warnings])
    }

    /// Returns the arguments for aligning the fitted models.
    fn align(&self, subjects: &[Subject<'_>], how: &str, name: &str, folder: &Path) -> Vec<String> {
        let mut arguments =
            words(&["shape", "align", &self.list("models.txt"), "--group", how, name, "-o", &text(folder)]);
        if subjects.iter().any(|subject| subject.mirrored) {
            arguments.extend(words(&["--mirrored", &self.list(MIRRORED)]));
        }
        arguments.extend(self.moved());
        arguments
    }

    /// Returns the flags that allow scaling and mirroring in addition to rotations.
    fn moved(&self) -> impl Iterator<Item = String> {
        let flags = [(self.study.align.scale, "--scale"), (self.study.align.mirror, "--mirror")];
        flags.into_iter().filter(|(given, _)| *given).map(|(_, flag)| flag.to_owned())
    }

    /// Returns the stage of the quality control.
    fn check(&self, models: &[PathBuf], aligned: &[PathBuf]) -> Stage {
        let (mean, scores, status) = (self.mean(), self.output.join("scores.csv"), self.records().join("subjects.tsv"));
        let (table, pictures, report) = (self.checked(), self.thumbnails(), self.check_report());
        let mut arguments =
            words(&["shape", "check", &self.list("models.txt"), "--aligned", &self.list("aligned.txt")]);
        arguments.extend(words(&["--mean", &text(&mean), "--scores", &text(&scores), "--status", &text(&status)]));
        let mut inputs: Vec<PathBuf> = models.iter().chain(aligned).cloned().chain([mean, scores, status]).collect();
        let frames = match self.method {
            Method::Correspond => Some(self.correspondence()),
            Method::Joint | Method::Fixed => Some(self.output.join("transforms.json")),
            Method::None => None,
        };
        if let Some(frames) = frames {
            let warnings = self.alignment_warnings();
            arguments.extend(words(&["--frames", &text(&frames), "--warnings", &text(&warnings)]));
            inputs.extend([frames, warnings]);
        }
        arguments.extend(words(&["-o", &text(&table), "--thumbnails", &text(&pictures), "--report", &text(&report)]));
        self.stage(CHECK, arguments, &inputs, [table, pictures, report])
    }

    /// Returns the stages that measure the quality of the correspondence and, if requested, of the plain alignment.
    fn quality(&self, subjects: &[Subject<'_>], models: &[PathBuf], aligned: &[PathBuf]) -> Vec<Stage> {
        if self.method != Method::Correspond {
            return Vec::new();
        }
        let marks: Vec<PathBuf> = subjects.iter().filter_map(|subject| subject.landmarks.clone()).collect();
        let measure = |name: &str, list: &str, models: &[PathBuf], frames: &Path, [table, curves]: [PathBuf; 2]| {
            let mut arguments = words(&["shape", "quality", &self.list(list), "-o", &text(&table)]);
            arguments.extend(words(&["--curves", &text(&curves)]));
            if !self.study.quality.surfaces {
                arguments.push("--no-surfaces".to_owned());
            }
            let mut inputs = models.to_vec();
            if models == aligned {
                arguments.extend(words(&["--mask", &text(&self.group_file())]));
                inputs.push(self.group_file());
            }
            if !marks.is_empty() {
                arguments.extend(words(&["--landmarks", &self.list("landmarks.txt"), "--frames", &text(frames)]));
                inputs.extend(marks.iter().cloned().chain([frames.to_owned()]));
            }
            self.stage(name, arguments, &inputs, [table, curves])
        };
        let (report, files) = (self.correspondence(), self.quality_files(Method::Correspond));
        let mut stages = vec![measure("quality", "aligned.txt", aligned, &report, files)];
        if self.study.quality.plain {
            let folder = self.output.join(PLAIN);
            let transforms = folder.join("transforms.json");
            let mut arguments = self.align(subjects, "--pose", "joint", &folder);
            arguments.extend(words(&["--transforms", &text(&transforms), "--for-comparison"]));
            stages.push(self.stage("plain", arguments, models, [folder.clone()]));
            let plain: Vec<PathBuf> = models.iter().filter_map(|model| Some(folder.join(model.file_name()?))).collect();
            let files = self.quality_files(Method::Joint);
            stages.push(measure("quality.plain", "plain.txt", &plain, &transforms, files));
        }
        stages
    }

    /// Returns the path of the group's file. This file lists the places that have no counterpart on the members.
    fn group_file(&self) -> PathBuf {
        self.aligned_folder().join("group.json")
    }

    /// Returns the paths of a group's quality measures and of their picture.
    fn quality_files(&self, method: Method) -> [PathBuf; 2] {
        let name = if method == Method::Correspond { "correspond" } else { PLAIN };
        ["json", "png"].map(|ending| self.output.join("quality").join(format!("{name}.{ending}")))
    }

    /// Returns the stages of a test, of its picture as PNG, and of its picture as SVG.
    fn test(&self, test: &Test, subjects: &[Subject<'_>]) -> [Stage; 3] {
        let (name, folder) = (format!("test.{}", test.name), self.test_folder(test));
        let table = self.tested_table(test);
        let mut arguments = words(&["shape", "test", "--table", &text(&table), "-o", &text(&folder)]);
        arguments.extend(test.question());
        let tested = self.tested(test, subjects);
        let models = tested.into_iter().flat_map(|(_, model, other)| std::iter::once(model).chain(other));
        let mut inputs: Vec<PathBuf> = std::iter::once(table).chain(models).collect();
        if test.is_of_differences() {
            let [first, second] = self.model_columns(test);
            arguments.extend(words(&["--model-column", first, "--minus", second]));
        }
        if test.is_of_values() {
            arguments.extend(words(&["--surface", &text(&self.mean())]));
            inputs.push(self.mean());
        }
        let (measures, scores) = (self.output.join("measures.csv"), self.output.join("scores.csv"));
        arguments.extend(words(&[
            "--measures",
            &format!("{}:area,volume,sphericity", text(&measures)),
            &text(&scores),
        ]));
        inputs.extend([measures, scores]);
        // The group file serves as a mask: the test leaves out vertices without a counterpart on the members of the
        // group.
        let group = (self.method == Method::Correspond).then(|| self.group_file());
        let mask = test.mask.as_ref().map(|mask| self.folder.join(mask));
        let sphere = test.sphere.as_ref().map(|sphere| self.folder.join(sphere));
        let annotation = test.annotation.as_ref().map(|annotation| self.folder.join(annotation));
        for (flag, path) in [("--mask", group), ("--mask", mask), ("--sphere", sphere), ("--annotation", annotation)] {
            arguments.extend(path.iter().flat_map(|path| words(&[flag, &text(path)])));
            inputs.extend(path);
        }
        let tested = self.stage(&name, arguments, &inputs, [folder.clone()]);
        let [statistic, p] = ["statistic", test.map()].map(|name| folder.join(format!("{name}.shape.gii")));
        let shown = [folder.join("test.json"), folder.join("mean.surf.gii"), statistic, p];
        let [png, svg] = ["png", "svg"].map(|ending| {
            let picture = self.output.join("figures").join(format!("{}.{ending}", test.name));
            let mut drawing = words(&["picture", "--test", &text(&folder), "--view"]);
            drawing.extend(words(&["left", "right", "top", "bottom", "front", "back"]));
            // Six panels of 354 pixels are 180 mm wide, the width of a page in most journals.
            drawing.extend(words(&["--size", "354", "--dpi", "300", "-o", &text(&picture)]));
            self.stage(&format!("picture.{}.{ending}", test.name), drawing, &shown, [picture])
        });
        [tested, png, svg]
    }

    /// Returns the stage of the page: modes, tests, the status of each subject and, with `[page] subjects`, their
    /// models.
    fn report(&self, subjects: &[Subject<'_>]) -> Stage {
        let (modes, status) = (self.output.join("group.shape-model.npz"), self.records().join("subjects.tsv"));
        let folders: Vec<PathBuf> = self.study.test.iter().map(|test| self.test_folder(test)).collect();
        let list = self.list("models.txt");
        let mut arguments = vec!["report".to_owned()];
        arguments.extend(self.study.page.subjects.then_some(list));
        let warnings = self.warnings();
        arguments.extend(words(&["--modes", &text(&modes), "--status", &text(&status)]));
        let (check, pictures) = (self.check_report(), self.thumbnails());
        arguments.extend(words(&["--warnings", &text(&warnings), "--check", &text(&check)]));
        arguments.extend(words(&["--thumbnails", &text(&pictures)]));
        let (methods, made) = (self.output.join(methods::FILE), self.output.join(provenance::FILE));
        arguments.extend(words(&["--methods", &text(&methods), "--provenance", &text(&made)]));
        if !folders.is_empty() {
            arguments.push("--test".to_owned());
            arguments.extend(folders.iter().map(|folder| text(folder)));
        }
        arguments.extend(words(&["--title", &self.study.title, "-o", &text(&self.page()), "--force"]));
        let mut inputs = vec![modes, status, warnings, check, methods, made];
        inputs.extend(subjects.iter().map(|subject| pictures.join(format!("{}.png", subject.id))));
        if self.method == Method::Correspond {
            let measured = [Some(Method::Correspond), self.study.quality.plain.then_some(Method::Joint)];
            let measured = measured.into_iter().flatten().map(|method| self.quality_files(method)[0].clone());
            let measured: Vec<PathBuf> = measured.collect();
            arguments.extend(words(&["--correspondence", &text(&self.correspondence()), "--quality"]));
            arguments.extend(measured.iter().map(|path| text(path)));
            inputs.extend(measured);
            inputs.push(self.correspondence());
        }
        inputs.extend(
            folders.iter().flat_map(|folder| ["test.csv", "test.json", "summary.csv"].map(|name| folder.join(name))),
        );
        inputs.extend(subjects.iter().filter(|_| self.study.page.subjects).map(|subject| subject.model.clone()));
        let (folder, name) = (self.folder.clone(), "report".to_owned());
        Stage { folder, name, arguments, inputs, outputs: vec![self.page()] }
    }

    /// Returns the argument `@FILE` for a list in the folder of records.
    fn list(&self, name: &str) -> String {
        format!("@{}", text(&self.records().join(name)))
    }

    fn stage<const N: usize>(
        &self,
        name: &str,
        mut arguments: Vec<String>,
        inputs: &[PathBuf],
        outputs: [PathBuf; N],
    ) -> Stage {
        arguments.push("--force".to_owned());
        let (folder, name) = (self.folder.clone(), name.to_owned());
        Stage { folder, name, arguments, inputs: inputs.to_vec(), outputs: outputs.to_vec() }
    }
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}
