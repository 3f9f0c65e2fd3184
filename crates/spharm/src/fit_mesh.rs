//! Fits surfaces that have no sphere, in memory: prepares, checks, maps and fits them.
//!
//! The program and the Python package call these functions, also for volumes and studies. Therefore the program and the
//! package compute the same coefficients.

use spharm_model::{Model, Provenance, VoxelRecord};
use spharm_monitor::{Monitor, Silent};
use spharm_surface::repair::{MeshRepair, Wrap};
use spharm_surface::{Mesh, Target};

use crate::fit::check_sizes;
use crate::parametrize::volume::{LabelSurface, Repair, VolumeReading, VoxelSteps};
use crate::parametrize::wrap::would_wrap;
use crate::parametrize::{
    HandlesReport, Input, ParametrizeError, Parametrized, Source, Warning, defects, parametrize_with,
};
use crate::{Error, Fit, FitParams, ManyReport, check_mapping, fit_target};

/// Changes to a surface before it is mapped to a sphere. A surface that is given with a sphere isn't changed.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Preparation {
    /// Settings for reading a volume's file.
    pub reading: VolumeReading,
    /// The kind of surface extracted from a label.
    pub label_surface: LabelSurface,
    /// Whether to repair labels and meshes.
    pub fix: bool,
    /// Largest share of the area that the repair of a mesh may drop or add. This value also limits the share of the
    /// mesh that a wrap may leave out, and the share of a wrap that may span holes. The usual limits are [`DROPPED`]
    /// and [`FILLED`]. If one of them is smaller than this value, this value replaces it.
    pub largest_repair: Option<f64>,
    /// Resolution of a wrap, in voxels along the longest side of a mesh; `None` by default. If set, the mesh is
    /// replaced by the closed surface around it ([`wrap()`](crate::parametrize::wrap())) instead of being repaired.
    pub wrap: Option<usize>,
    /// Whether to cut handles.
    pub cut_handles: bool,
}

/// Largest share of a mesh's area that a repair may drop as separate pieces or lose by welding. This is also the
/// largest share of the mesh's area, and of the wrap's voxels, that a wrap may leave out.
/// [`Preparation::largest_repair`] may allow more.
pub const DROPPED: f64 = 0.05;
/// Largest share of a mesh's area that a repair may add by filling holes. This is also the largest share of a wrap's
/// area that may span holes. [`Preparation::largest_repair`] may allow more.
pub const FILLED: f64 = 0.25;

/// Returns the shares of the area that a repair loses by welding, drops with small pieces, and adds by filling holes,
/// each with its usual limit.
fn shares(repair: &MeshRepair) -> [(f64, f64); 3] {
    [(repair.lost_area, DROPPED), (repair.dropped_area, DROPPED), (repair.filled_area, FILLED)]
}

/// Returns the smallest [`largest_repair`](Preparation::largest_repair) that allows a repair, rounded up to whole per
/// cent; `None` if the usual limits allow it.
#[must_use]
pub fn percent_to_allow(repair: &MeshRepair) -> Option<u32> {
    let large = shares(repair).into_iter().filter(|(share, usual)| share > usual).map(|(share, _)| share);
    large.reduce(f64::max).map(whole_percent)
}

/// Returns the smallest [`largest_repair`](Preparation::largest_repair) that allows a wrap, rounded up to whole per
/// cent.
#[must_use]
pub fn percent_to_wrap(wrap: &Wrap) -> u32 {
    let large = shares_of_wrap(wrap).into_iter().filter(|(share, usual)| share > usual);
    whole_percent(large.map(|(share, _)| share).fold(0.0, f64::max))
}

/// Returns the share of the mesh that a wrap leaves out, and the share of the wrap that spans holes. Each share is
/// returned with its usual limit.
fn shares_of_wrap(wrap: &Wrap) -> [(f64, f64); 2] {
    [(wrap.loss(), DROPPED), (wrap.bridged_area, FILLED)]
}

fn whole_percent(share: f64) -> u32 {
    (100.0 * share).ceil() as u32
}

impl Preparation {
    /// Returns the changes that apply to a surface. A surface with a sphere isn't changed. Otherwise, a surface without
    /// a label gets the default settings for reading volumes, and a surface extracted from a label isn't wrapped.
    #[must_use]
    pub fn of(self, on_sphere: bool, label: Option<i64>) -> Self {
        match (on_sphere, label) {
            (true, _) => Self::default(),
            (false, None) => Self { reading: VolumeReading::default(), ..self },
            (false, Some(_)) => Self { wrap: None, ..self },
        }
    }

    /// Wraps or repairs a mesh and cuts its handles, if requested. A label is repaired earlier, when its surface is
    /// extracted.
    ///
    /// # Errors
    ///
    /// [`Error::Parametrize`] if the repair would change too large a part of the surface; if a wrap encloses nothing,
    /// leaves out too large a part of the mesh, or spans too large holes; or if handles can't be cut.
    pub fn apply(self, surface: Input, monitor: &dyn Monitor) -> Result<Input, Error> {
        if let Some(voxels) = self.wrap {
            // A wrap has no handles.
            return self.checked_wrap(surface.wrapped(voxels, monitor)?);
        }
        let given = surface.mesh().filter(|_| self.fix).cloned();
        let surface = if self.fix { surface.mended(monitor)? } else { surface };
        if let Some(repair) = surface.mesh_repair() {
            let limits = shares(repair).map(|(share, usual)| (share, self.largest_repair.unwrap_or(0.0).max(usual)));
            if let Some((_, most)) = limits.into_iter().find(|(share, most)| share.is_nan() || share > most) {
                let succeeds = surface.mesh().is_some_and(|mesh| defects(mesh).0.is_empty());
                let wraps =
                    given.map_or(Ok(false), |mesh| would_wrap(&mesh, monitor)).map_err(ParametrizeError::from)?;
                return Err(ParametrizeError::LargeRepair { repair: Box::new(*repair), most, succeeds, wraps }.into());
            }
        }
        Ok(if self.cut_handles { surface.without_handles(monitor)? } else { surface })
    }

    /// Returns a wrapped surface unless the wrap leaves out too large a part of the mesh or spans too large holes.
    fn checked_wrap(self, surface: Input) -> Result<Input, Error> {
        let Some(wrap) = surface.mesh_repair().and_then(|repair| repair.wrap) else { return Ok(surface) };
        let limits = shares_of_wrap(&wrap).map(|(share, usual)| (share, self.largest_repair.unwrap_or(0.0).max(usual)));
        match limits.into_iter().find(|(share, most)| share > most) {
            Some((_, most)) => Err(ParametrizeError::LossyWrap { wrap: Box::new(wrap), most }.into()),
            None => Ok(surface),
        }
    }
}

/// A surface mapped to a sphere, and the changes made to the surface beforehand.
#[derive(Debug, Clone)]
pub struct MappedSurface {
    /// The map to the sphere.
    pub parametrized: Parametrized,
    /// Repair of a volume's label, if the surface was extracted from a label.
    pub repair: Option<Repair>,
    /// Repair of a mesh, if it was repaired.
    pub mesh_repair: Option<MeshRepair>,
    /// Report on handles that were cut.
    pub handles: Option<HandlesReport>,
    /// Voxels of the label, if the surface was extracted from a label.
    pub voxels: Option<VoxelRecord>,
    /// Whether a label's surface is smooth or follows the voxels.
    pub label_surface: Option<LabelSurface>,
    /// The staircase of the label's voxels, if a model of the fit's degree reproduces it.
    pub steps: Option<VoxelSteps>,
}

impl MappedSurface {
    /// Maps a surface to a sphere, after checking that memory suffices for mapping and fitting the surface.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`], with the memory that suffices for both steps, if memory doesn't suffice;
    /// [`Error::Parametrize`] if the surface can't be mapped.
    pub fn new(surface: &Input, params: &FitParams, monitor: &dyn Monitor) -> Result<Self, Error> {
        check_surface(surface, params)?;
        let mut parametrized = parametrize_with(surface, &params.map(), monitor)?;
        if let Some(cut) = surface.cut() {
            cut.mark(&mut parametrized.map.sphere);
            parametrized.sphere.seam.clone_from(&cut.seam);
        }
        Ok(Self::of(surface, parametrized, params))
    }

    /// Combines a surface with an existing map to the sphere. If the surface is a mesh whose triangles wind inwards, a
    /// warning is added to the map's report.
    #[must_use]
    pub fn of(surface: &Input, mut parametrized: Parametrized, params: &FitParams) -> Self {
        let report = &mut parametrized.map.report;
        if surface.label().is_none() && report.quality.winding_number < 0 {
            report.warnings.push(Warning::Inward);
        }
        Self {
            parametrized,
            repair: surface.label().and_then(|label| label.repair),
            mesh_repair: surface.mesh_repair().copied(),
            handles: surface.handles().cloned(),
            label_surface: surface.label().map(|label| label.surface),
            voxels: surface.label().map(|label| VoxelRecord {
                count: label.voxels,
                size: label.voxel_size,
                at_border: label.at_border,
            }),
            steps: surface.label().and_then(|label| label.steps(params.max_degree)),
        }
    }

    /// Fits the surface over its sphere.
    ///
    /// # Errors
    ///
    /// The errors of [`fit()`](crate::fit()).
    pub fn fit(&self, params: &FitParams, monitor: &dyn Monitor) -> Result<(Fit, ManyReport), Error> {
        let sphere = &self.parametrized.sphere;
        fit_target(sphere, Target::from_mesh(&self.parametrized.map.surface, sphere)?, params, monitor)
    }

    /// Records repairs, cuts, and the label's voxels and staircase in a model's provenance.
    pub fn record(&self, provenance: &mut Provenance) {
        let object = |value: Result<serde_json::Value, _>| value.ok()?.as_object().cloned();
        provenance.repair = self.repair.and_then(|repair| object(serde_json::to_value(repair)));
        if let Some(repair) = self.mesh_repair {
            let counts = repair.counts().map(|(name, count)| (name.to_owned(), count.into()));
            let wrap = repair.wrap.and_then(|wrap| Some(("wrap".to_owned(), serde_json::to_value(wrap).ok()?)));
            provenance.repair = Some(counts.into_iter().chain(wrap).collect());
        }
        provenance.handles = self.handles.as_ref().and_then(|handles| object(serde_json::to_value(handles)));
        provenance.voxels = self.voxels;
        provenance.label_surface = self.label_surface.map(|surface| surface.name().to_owned());
        provenance.smooth_radius = self.label_surface.and_then(LabelSurface::radius);
        if let Some(steps) = self.steps {
            provenance.other.insert(VOXEL_STEPS.to_owned(), serde_json::to_value(steps).unwrap_or_default());
        }
    }
}

/// Name of the provenance field with a model's [`VoxelSteps`].
const VOXEL_STEPS: &str = "voxel_steps";

/// Returns the staircase of voxels that a model reproduces, as recorded in its provenance.
#[must_use]
pub fn steps_of(provenance: &Provenance) -> Option<VoxelSteps> {
    serde_json::from_value(provenance.other.get(VOXEL_STEPS)?.clone()).ok()
}

/// Checks that memory suffices to map a surface to a sphere and to fit it there, before any work starts. The error
/// states the memory that suffices for both.
///
/// # Errors
///
/// [`Error::Memory`] if memory doesn't suffice.
pub fn check_surface(surface: &Input, params: &FitParams) -> Result<(), Error> {
    let of_mesh = surface.mesh().map(|mesh| (mesh.vertices.len(), mesh.faces.len()));
    let of_label = surface.label().map(|label| (label.quads.vertices.len(), 2 * label.quads.quads.len()));
    let fits = of_mesh.or(of_label).map_or(Ok(()), |(vertices, faces)| check_sizes(vertices, faces, params));
    match (fits, check_mapping(Source::from(surface).vertices(), params)) {
        (Err(Error::Memory { budget, needed }), Err(Error::Memory { needed: mapping, .. })) => {
            Err(Error::Memory { budget, needed: needed.max(mapping) })
        }
        (fits, maps) => fits.and(maps),
    }
}

/// The fit of a surface that was given without a sphere.
#[derive(Debug, Clone)]
pub struct MeshFit {
    /// The surface, its sphere, and the changes made to it.
    pub surface: MappedSurface,
    /// The coefficients, and a report on the fit.
    pub fit: Fit,
    /// Sampling scheme, solver reports and wall time of the fit.
    pub many: ManyReport,
}

impl From<MeshFit> for Model {
    fn from(fit: MeshFit) -> Self {
        let mut model = fit.fit.into_model(fit.surface.parametrized.sphere.clone());
        fit.surface.record(&mut model.provenance);
        model
    }
}

/// Maps a closed surface of genus zero to a sphere, and fits it over that sphere.
///
/// ```
/// use spharm::generate::{Cortex, cortex};
/// use spharm::{FitParams, Model, fit_mesh};
///
/// let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
/// let fit = fit_mesh(&surface, &FitParams::lsq(10))?;
/// let model = Model::from(fit);
/// assert_eq!(model.coefficients.values().dim(), (121, 3));
/// # Ok::<(), spharm::Error>(())
/// ```
///
/// # Errors
///
/// [`Error::Memory`], before any work, if memory doesn't suffice; [`Error::Parametrize`], with the reason, if the
/// surface can't be mapped; the errors of [`fit()`](crate::fit()).
pub fn fit_mesh(surface: &Mesh, params: &FitParams) -> Result<MeshFit, Error> {
    fit_mesh_with(Input::Mesh(surface.clone()), Preparation::default(), params, &Silent)
}

/// Maps and fits a surface as [`fit_mesh`] does, with progress and cancellation. First repairs the surface and cuts its
/// handles, if `preparation` requests this. The surface may also be extracted from a volume's label.
///
/// # Errors
///
/// The errors of [`fit_mesh`]; [`Error::is_interrupted`] if the monitor stopped the fit.
pub fn fit_mesh_with(
    surface: Input,
    preparation: Preparation,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<MeshFit, Error> {
    fit_mesh_masked(surface, preparation, None, params, monitor)
}

/// Maps and fits a surface like [`fit_mesh_with`], but ignores the vertices at which `keep` is false: the triangles at
/// these vertices aren't fitted. The mask has one element per vertex of the prepared surface. The mask applies to the
/// fit, not to the map.
///
/// # Errors
///
/// The errors of [`fit_mesh_with`] and of [`Weights::masked`](crate::Weights::masked).
pub fn fit_mesh_masked(
    surface: Input,
    preparation: Preparation,
    keep: Option<&[bool]>,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<MeshFit, Error> {
    params.check()?;
    check_surface(&surface, params)?;
    let surface = preparation.apply(surface, monitor)?;
    let surface = MappedSurface::new(&surface, params, monitor)?;
    let (fit, many) = match keep {
        None => surface.fit(params, monitor)?,
        Some(keep) => surface.fit(&params.masked(keep, &surface.parametrized.sphere)?, monitor)?,
    };
    Ok(MeshFit { surface, fit, many })
}
