//! Previews a run: counts rows, existing models and spheres, checks the memory, and finds rows that would fail, as far
//! as this is known before the run.

use std::path::{Path, PathBuf};

use spharm::parametrize::volume::is_volume;
use spharm::{Method, Monitor, Sphere, SurfaceError, check_surface};
use spharm_surface::io::declared_vertices;

use super::error::RunError;
use super::event::Observer;
use super::groups::{Group, groups};
use super::ledger::Ledger;
use super::params::{Cohort, RunParams};
use super::work::Work;
use crate::Row;
use crate::files::ModelFiles;
use crate::reader::SurfaceReader;
use crate::rerun::IfExists;

/// To check how much memory is needed, a preview reads only the first spheres and the first surfaces without a sphere,
/// at most this number of each. A further file is read only if outputs of its rows exist. If the fits need a basis
/// store, all further spheres are read as well.
const READ: usize = 3;

/// Result of a preview.
#[derive(Debug)]
#[non_exhaustive]
pub struct Preview {
    /// Number of rows.
    pub rows: usize,
    /// Number of rows whose model exists.
    pub exist: usize,
    /// Number of rows whose existing model would be kept.
    pub kept: usize,
    /// Number of rows whose surface file is missing.
    pub missing: usize,
    /// Number of different given spheres over which rows would be fitted.
    pub spheres: usize,
    /// The spheres that the preview has read.
    pub first_spheres: Vec<PreviewedSphere>,
    /// Number of surfaces that would be mapped to separate spheres.
    pub mapped: usize,
    /// Indices of the rows that would fail, with their errors.
    pub failed: Vec<(usize, RunError)>,
}

/// A sphere that was read for a preview.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PreviewedSphere {
    /// Path of the sphere.
    pub path: PathBuf,
    /// Number of rows over the sphere.
    pub rows: usize,
    /// Number of vertices of the sphere.
    pub vertices: usize,
}

/// Previews [`run`](super::run) without fitting: checks all existing models, a few spheres, and whether the surface
/// files exist.
///
/// # Errors
///
/// [`RunError`] only if `monitor` cancels the preview (see [`RunError::is_interrupted`]).
pub fn preview(
    cohort: &Cohort,
    params: &RunParams,
    observer: &dyn Observer,
    monitor: &dyn Monitor,
) -> Result<Preview, RunError> {
    let all = cohort.rows.len();
    let numbers: Vec<usize> = (0..all).collect();
    let groups = groups(&cohort.rows, &numbers);
    let ledger = Ledger::new(observer, all, None)?;
    let reader = SurfaceReader::new(params.preparation);
    let work = Work::new(cohort, params, &reader, monitor, &ledger);
    let mut look = Look { work: &work, spheres: Vec::new(), own: 0, kept: 0, failed: Vec::new() };
    for group in &groups {
        monitor.check()?;
        look.at_group(group)?;
    }
    let Look { spheres: first_spheres, kept, failed, .. } = look;
    Ok(Preview {
        rows: all,
        exist: cohort.rows.iter().filter(|row| row.model(&cohort.folder).exists()).count(),
        kept,
        missing: cohort.rows.iter().filter(|row| !row.surface.exists()).count(),
        spheres: groups.iter().filter(|group| group.sphere.is_some()).count(),
        first_spheres,
        mapped: groups.iter().filter(|group| group.sphere.is_none()).map(|group| group.rows.len()).sum(),
        failed,
    })
}

/// State of a preview: the results for the rows and spheres checked so far.
struct Look<'a> {
    work: &'a Work<'a>,
    spheres: Vec<PreviewedSphere>,
    /// Number of surfaces without a sphere that have been read.
    own: usize,
    kept: usize,
    failed: Vec<(usize, RunError)>,
}

impl Look<'_> {
    /// Checks the rows of one group. Returns an error only if the preview is cancelled; other errors are recorded for
    /// the rows.
    fn at_group(&mut self, group: &Group) -> Result<(), RunError> {
        let before = self.failed.len();
        let Err(error) = self.at_sphere(group) else { return Ok(()) };
        if error.is_interrupted() {
            return Err(error);
        }
        // An error with the sphere applies to all of its rows, and replaces the errors of single rows.
        self.failed.truncate(before);
        let error = match &group.sphere {
            Some(path) if self.work.params.keep_going => error.of(path.display()),
            _ => error,
        };
        let line = self.work.ledger.observer.line(&error);
        self.failed.extend(group.rows.iter().map(|&number| (number, RunError::Sphere(line.clone()))));
        Ok(())
    }

    fn at_sphere(&mut self, group: &Group) -> Result<(), RunError> {
        let Work { cohort, monitor, .. } = *self.work;
        let any_there = group.rows.iter().any(|&number| self.any_output(number));
        let read;
        let sphere = match (&group.sphere, &cohort.sphere) {
            (Some(_), Some(sphere)) => Some(sphere),
            (Some(path), None) if any_there || self.spheres.len() < READ || self.over_a_store() => {
                read = self.work.sphere(path)?;
                Some(&read)
            }
            (Some(path), None) => {
                check_exists(path)?;
                None
            }
            (None, _) => None,
        };
        let params = self.work.params_at(self.work.weighted(&cohort.rows[group.rows[0]])?, sphere)?;
        if let (Some(path), Some(sphere)) = (&group.sphere, sphere) {
            params.check_over(sphere, group.rows.len())?;
            let (rows, vertices) = (group.rows.len(), sphere.directions.len());
            self.spheres.push(PreviewedSphere { path: path.clone(), rows, vertices });
        }
        for &number in &group.rows {
            monitor.check()?;
            let row = &cohort.rows[number];
            let mut look = || -> Result<bool, RunError> {
                check_exists(&row.surface)?;
                row.region.as_deref().map_or(Ok(()), check_exists)?;
                self.check_vertices(row, sphere)?;
                if self.any_output(number) && self.work.decide(number, sphere, &params)?.is_none() {
                    return Ok(true);
                }
                if group.sphere.is_none() && !is_volume(&row.surface) && self.own < READ {
                    self.own += 1;
                    check_surface(&self.work.reader.read(&row.surface, None, monitor)?, &params)?;
                }
                Ok(false)
            };
            match look() {
                Ok(kept) => self.kept += usize::from(kept),
                Err(error) if error.is_interrupted() => return Err(error),
                Err(error) => self.failed.push((number, error)),
            }
        }
        Ok(())
    }

    /// Returns whether the fit's method reads a basis store, which must then contain the basis at each sphere's
    /// directions.
    fn over_a_store(&self) -> bool {
        !matches!(self.work.params.fit.method, Method::Lsq | Method::Quadrature)
    }

    /// Checks that a surface and its sphere have the same number of vertices, if the headers of both files state it.
    fn check_vertices(&self, row: &Row, sphere: Option<&Sphere>) -> Result<(), RunError> {
        let Some(found) = declared_vertices(&row.surface)? else { return Ok(()) };
        let of_sphere = match (sphere, &row.sphere) {
            (Some(sphere), _) => Some(sphere.directions.len() as u64),
            (None, Some(path)) => declared_vertices(path)?,
            (None, None) => None,
        };
        match of_sphere.filter(|expected| *expected != found) {
            None => Ok(()),
            Some(expected) => {
                let (path, sphere) = (row.surface.clone(), row.sphere.clone());
                let (expected, found) = (expected as usize, found as usize);
                Err(SurfaceError::VertexCount { path, sphere, expected, found }.into())
            }
        }
    }

    /// Returns whether any output of a row exists, so that the row has to be compared with its existing model.
    fn any_output(&self, number: usize) -> bool {
        let Work { cohort, params, .. } = *self.work;
        if params.if_exists == IfExists::Replace {
            return false;
        }
        let files = ModelFiles { model: cohort.rows[number].model(&cohort.folder) };
        files.all().iter().any(|path| path.exists())
    }
}

fn check_exists(path: &Path) -> Result<(), RunError> {
    if path.exists() { Ok(()) } else { Err(RunError::Missing { path: path.to_owned() }) }
}
