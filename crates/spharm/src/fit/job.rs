//! Data shared by all fitting methods: the sphere, the weights, the basis, and the points at which models are assessed.

use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};
use spharm_store::{Scalar, Scheme, SchemeKey};
use spharm_surface::{Kind, Sphere};

use super::planned::PlannedSphere;
use super::range::{smoothness_into_range, weights_into_range};
use crate::assess::{HoldOut, OffVertex};
use crate::{Error, FitParams, FitWarning, Method, Smoothness, Weights, defaults};

/// Settings and data of a call that fits targets over one sphere.
pub(crate) struct Job<'a> {
    pub(crate) sphere: &'a Sphere,
    /// The sphere with its transforms, if they were planned and this fit can use them.
    pub(crate) planned: Option<&'a PlannedSphere>,
    pub(crate) params: &'a FitParams,
    /// Weights of the n vertices, divided by 2^`weight_exponent`. Weights are 0 at held-out vertices.
    pub(crate) weights: Option<Vec<f64>>,
    pub(crate) weight_exponent: i32,
    /// A warning for fits of vertices, if the weights are too uneven for the degree.
    pub(crate) uneven_weights: Option<FitWarning>,
    /// Marks the vertices of weight 0, whose values are never read. `None` if all vertices are read. Held-out vertices
    /// aren't marked.
    pub(crate) unread: Option<Vec<bool>>,
    pub(crate) hold_out: Option<HoldOut>,
    pub(crate) off_vertex: Option<OffVertex>,
    /// The basis, for methods that read a store.
    pub(crate) scheme: Option<Scheme>,
    pub(crate) key: SchemeKey,
    pub(crate) scalar: Scalar,
    pub(crate) threads: usize,
    /// Memory budget in bytes.
    pub(crate) memory: usize,
}

impl<'a> Job<'a> {
    pub(crate) fn new(
        sphere: &'a Sphere,
        planned: Option<&'a PlannedSphere>,
        params: &'a FitParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, Error> {
        let n = sphere.directions.len();
        let hold_out = params.hold_out.map(|fraction| HoldOut::new(n, fraction)).transpose()?;
        let mut weights = weights(&params.weights, sphere)?;
        let unread = weights.as_ref().filter(|weights| weights.contains(&0.0));
        let unread: Option<Vec<bool>> = unread.map(|weights| weights.iter().map(|weight| *weight == 0.0).collect());
        let weight_exponent = weights_into_range(weights.as_mut());
        if let Some(hold_out) = &hold_out {
            monitor.note(Level::Info, format_args!("{} vertices are held out", hold_out.count()));
            weights = Some(hold_out.apply(weights));
        }
        let mut scheme = None;
        if let (Some(_), Some(store)) = (params.method.blocks(), &params.store) {
            let found = Scheme::open_at(store, &sphere.directions, params.scalar, params.max_degree)?;
            if params.verify {
                found.verify(monitor)?;
            }
            scheme = Some(found);
        }
        let scalar = scheme.as_ref().map_or(Scalar::F64, Scheme::scalar);
        let key = match (&scheme, planned) {
            (Some(scheme), _) => scheme.key(),
            (None, Some(planned)) => planned.key(),
            (None, None) => SchemeKey::of(&sphere.directions, scalar),
        };
        Ok(Self {
            sphere,
            planned: planned.filter(|planned| planned.serves(params.max_degree)),
            params,
            uneven_weights: weights.as_ref().and_then(|w| FitWarning::of_weights(w, params.max_degree)),
            weights,
            weight_exponent,
            off_vertex: OffVertex::new(sphere, unread.as_deref(), basis_size(params.max_degree))?,
            unread,
            hold_out,
            scheme,
            key,
            scalar,
            threads: params.threads.unwrap_or_else(rayon::current_num_threads),
            memory: params.memory_budget(),
        })
    }

    /// Returns the number of vertices with nonzero weight.
    pub(crate) fn vertices_with_weight(&self) -> usize {
        let count = |weights: &Vec<f64>| weights.iter().filter(|weight| **weight > 0.0).count();
        self.weights.as_ref().map_or(self.sphere.directions.len(), count)
    }

    /// Returns whether targets of the given kind are fitted as surfaces.
    pub(crate) fn fits_surface(&self, kind: Kind) -> bool {
        self.params.fits_surface(kind, !self.sphere.faces.is_empty())
    }

    /// Returns whether the smoothness penalty is the default of vertex fits over a parametrised sphere.
    pub(crate) fn smooth_by_default(&self) -> bool {
        let Self { params, sphere, .. } = self;
        let default = params.smoothness == Smoothness::Default && !params.denoise;
        default && sphere.parametrized && params.method == Method::Lsq
    }

    /// Returns a requested smoothness penalty, scaled in the same way as `weights`.
    pub(crate) fn fixed_smoothness(&self, lambda: f64) -> f64 {
        smoothness_into_range(lambda, self.weight_exponent)
    }

    /// Returns the smoothness penalty of targets that are fitted at their vertices, or 0 if a penalty is chosen for
    /// each target.
    pub(crate) fn smoothness(&self) -> f64 {
        let Self { params, sphere, weights, .. } = self;
        match params.smoothness {
            Smoothness::Fixed(lambda) => self.fixed_smoothness(lambda),
            Smoothness::Default if self.smooth_by_default() => {
                let total = weights.as_ref().map_or(sphere.directions.len() as f64, |weights| weights.iter().sum());
                defaults::parametrized_smoothness(params.max_degree, total)
            }
            Smoothness::Default | Smoothness::Auto => 0.0,
        }
    }

    /// Returns the memory in bytes held outside the solver while `together` targets are fitted together and further
    /// targets are read. At most `together` targets are read at a time, and at most one per thread.
    pub(crate) fn held(&self, together: usize, channels: usize) -> usize {
        held(self.sphere.directions.len(), self.sphere.faces.len(), together, channels, self.threads.min(together))
    }
}

/// Returns the memory in bytes held outside the solver: the program, the sphere, the targets in memory, and the
/// buffers of targets that are being read or written.
pub(crate) fn held(vertices: usize, faces: usize, together: usize, channels: usize, readers: usize) -> usize {
    /// Bytes of the program itself, with its stacks and its allocator, measured on a fit of a small mesh.
    const BASE: usize = 12 << 20;
    let sphere = 24 * vertices + 12 * faces;
    BASE + sphere + 8 * vertices * channels * together + readers * reading(vertices, faces, channels)
}

/// Returns the memory in bytes for reading or writing a surface. Its file is held as text and in decoded form, and the
/// surface as a mesh with its topology.
pub(crate) fn reading(vertices: usize, faces: usize, channels: usize) -> usize {
    5 * (24 * vertices + 12 * faces) + 16 * vertices * channels
}

fn weights(choice: &Weights, sphere: &Sphere) -> Result<Option<Vec<f64>>, Error> {
    match choice {
        Weights::Uniform => Ok(None),
        Weights::Area if sphere.faces.is_empty() => Err(Error::area_without_triangles(sphere)),
        Weights::Area => Ok(Some(sphere.areas())),
        Weights::Values { name, values } => {
            let (expected, found) = (sphere.directions.len(), values.len());
            if found != expected {
                return Err(Error::WeightCount { name: name.clone(), expected, found });
            }
            let bad = |weight: &f64| !weight.is_finite() || *weight < 0.0;
            let all_zero = values.iter().all(|&weight| weight == 0.0);
            if let Some(vertex) = values.iter().position(bad).or(all_zero.then_some(0)) {
                return Err(Error::Weight { name: name.clone(), vertex, found: values[vertex] });
            }
            Ok(Some(values.clone()))
        }
    }
}
