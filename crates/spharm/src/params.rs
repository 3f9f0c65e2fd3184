//! Settings of fits: [`FitParams`] and its parts.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use derive_setters::Setters;
use spharm_harmonics::MAX_DEGREE;
use spharm_store::Scalar;
use spharm_surface::Sphere;

use crate::machine::available_memory;
use crate::parametrize::CaldParams;
use crate::{Error, Objective, Weights, defaults};

/// The method that computes the coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Full least squares by fast transforms, without a basis on disk: the paper's NLSF at any degree.
    Lsq,
    /// Iterative residual fitting over a basis store.
    Irf {
        /// Number of passes, p, at least 1.
        passes: usize,
        /// Largest number of basis functions that are solved together, g, at least 1.
        granularity: usize,
        /// Whether to accelerate pairs of passes, one forward and one backward, by conjugate gradients. `passes` is
        /// then the maximum number of passes.
        accelerate: bool,
    },
    /// Stepwise fitting over a store: degrees 0 to `start_degree` together, then degree by degree, in one pass.
    Sirf {
        /// Last degree of the first block, s.
        start_degree: usize,
    },
    /// Stepwise fitting (SIRF) over a store, repeated on the residual.
    Mirf {
        /// Number of passes, p, at least 1.
        passes: usize,
        /// Last degree of the first block, s.
        start_degree: usize,
        /// Whether to accelerate pairs of passes by conjugate gradients, as for [`Method::Irf`].
        accelerate: bool,
    },
    /// The full least squares over a store, all degrees in one block.
    Nlsf,
    /// Quadrature on a Gauss-Legendre grid, to which the surface is interpolated.
    Quadrature,
}

impl Method {
    /// Returns iterative residual fitting with the paper's granularity and one pass.
    pub fn irf() -> Self {
        Self::Irf { passes: 1, granularity: defaults::GRANULARITY, accelerate: false }
    }

    /// Returns repeated stepwise fitting with its default of four passes.
    pub fn mirf() -> Self {
        Self::Mirf { passes: 4, start_degree: 0, accelerate: false }
    }

    /// Returns the method's name in lower case, as in reports and models.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Lsq => "lsq",
            Self::Quadrature => "quadrature",
            Self::Irf { .. } => "irf",
            Self::Sirf { .. } => "sirf",
            Self::Mirf { .. } => "mirf",
            Self::Nlsf => "nlsf",
        }
    }

    /// Returns the number of passes over the basis, p.
    pub fn passes(&self) -> usize {
        match *self {
            Self::Irf { passes, .. } | Self::Mirf { passes, .. } => passes,
            Self::Lsq | Self::Quadrature | Self::Sirf { .. } | Self::Nlsf => 1,
        }
    }

    /// Returns the granularity, g, if the method has one and it is finite.
    pub fn granularity(&self) -> Option<usize> {
        match *self {
            Self::Irf { granularity, .. } if granularity < usize::MAX => Some(granularity),
            _ => None,
        }
    }

    /// Returns the last degree of the first block, s, if the method has one.
    pub fn start_degree(&self) -> Option<usize> {
        match *self {
            Self::Sirf { start_degree } | Self::Mirf { start_degree, .. } => Some(start_degree),
            _ => None,
        }
    }

    /// Returns whether pairs of passes are accelerated by conjugate gradients.
    pub fn accelerated(&self) -> bool {
        matches!(*self, Self::Irf { accelerate: true, .. } | Self::Mirf { accelerate: true, .. })
    }

    /// Returns the solver's schedule of blocks, or `None` for a method that doesn't read a store.
    pub(crate) fn blocks(&self) -> Option<spharm_solver::Method> {
        use spharm_solver::Method as Blocks;
        match *self {
            Self::Lsq | Self::Quadrature => None,
            Self::Irf { passes, granularity, .. } => Some(Blocks::Irf { passes, granularity }),
            Self::Sirf { start_degree } => Some(Blocks::Sirf { start_degree }),
            Self::Mirf { passes, start_degree, .. } => Some(Blocks::Mirf { passes, start_degree }),
            Self::Nlsf => Some(Blocks::Nlsf),
        }
    }
}

/// The smoothness penalty of the full least squares: `lambda sum (l (l + 1))^2 a_lm^2` over the coefficients a_lm,
/// added to the squared distances.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Smoothness {
    /// Applies no penalty to fits of surfaces or to fits of vertices over a given sphere. Applies
    /// [`defaults::parametrized_smoothness`] to fits of vertices over a sphere made by parametrisation.
    #[default]
    Default,
    /// Applies the given lambda, which must be finite and not negative.
    Fixed(f64),
    /// Applies, for each surface or each channel of a signal, the lambda that minimises the score of generalised
    /// cross-validation.
    Auto,
}

impl Smoothness {
    /// Returns the name of the choice, as models record it: `default`, `fixed` or `auto`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Fixed(_) => "fixed",
            Self::Auto => "auto",
        }
    }
}

impl FromStr for Smoothness {
    type Err = String;

    /// Parses `auto` or a number of at least 0.
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let lambda = text.parse().ok().filter(|lambda: &f64| *lambda >= 0.0 && lambda.is_finite());
        lambda.map(Self::Fixed).ok_or_else(|| "expected a number of at least 0, or auto".to_owned())
    }
}

/// Preconditioner for the iterations of the full least squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preconditioner {
    /// Chooses automatically: uses the density of uneven samples if computing their moments pays off, and changes to a
    /// Cholesky factor of the normal equations if iterations are slow and memory allows.
    #[default]
    Auto,
    /// Uses no preconditioner.
    None,
    /// Uses the density of uneven samples, computed from their moments. The density isn't used if the samples are even,
    /// if there is a smoothness penalty, or, with a warning, if memory doesn't suffice.
    Density,
    /// Uses a Cholesky factor of the normal equations from the start, without iterations. With fewer vertices than
    /// coefficients and no penalty, iterates instead, with a warning.
    Factor,
}

impl fmt::Display for Preconditioner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::None => "none",
            Self::Density => "density",
            Self::Factor => "factor",
        })
    }
}

impl FromStr for Preconditioner {
    type Err = String;

    /// Parses the names of the preconditioners in lower case.
    fn from_str(text: &str) -> Result<Self, String> {
        Ok(match text {
            "auto" => Self::Auto,
            "none" => Self::None,
            "density" => Self::Density,
            "factor" => Self::Factor,
            _ => return Err("expected auto, none, density or factor".to_owned()),
        })
    }
}

/// Settings of a fit, created by [`lsq`](Self::lsq) or [`irf`](Self::irf). Each setter returns the changed settings.
///
/// ```
/// use spharm::{FitParams, Objective, Smoothness};
///
/// let params = FitParams::lsq(60)
///     .with_objective(Objective::Vertices)
///     .with_smoothness(Smoothness::Auto)
///     .with_hold_out(0.1);
/// assert_eq!(params.max_degree, 60);
/// ```
#[derive(Debug, Clone, PartialEq, Setters)]
#[setters(prefix = "with_")]
#[non_exhaustive]
pub struct FitParams {
    /// Highest degree L, inclusive; at most [`MAX_DEGREE`].
    pub max_degree: usize,
    /// Method that computes the coefficients.
    pub method: Method,
    /// Whether meshes are fitted as surfaces or at their vertices, for [`Method::Lsq`].
    pub objective: Objective,
    /// Allowed area distortion, from 0 to 1, of the map of a mesh without a sphere (see
    /// [`CaldParams::area`](crate::parametrize::CaldParams::area)). The default is 0.8. The map uses only as much of
    /// the allowed distortion as improves the fit.
    #[setters(into)]
    pub area: Option<f64>,
    /// Smoothness penalty, for [`Method::Lsq`].
    pub smoothness: Smoothness,
    /// Whether to remove noise within the fit, by a penalty on each degree that is estimated from the target. Requires
    /// [`Method::Lsq`] without a smoothness penalty. See [`spharm_solver::lsq::denoise`].
    pub denoise: bool,
    /// Weight of each vertex.
    pub weights: Weights,
    /// Fraction of the vertices, between 0 and 1, that is held out of the fit and assessed separately.
    #[setters(into)]
    pub hold_out: Option<f64>,
    /// Whether to measure the distances from model to surface and from surface to model, if a surface is fitted.
    pub surface_distance: bool,
    /// Whether to compute each coefficient's standard error; for [`Method::Lsq`].
    pub standard_errors: bool,
    /// Optimality to reach, between 0 and 1: the gradient relative to the gradient at zero coefficients; for
    /// [`Method::Lsq`].
    pub tolerance: f64,
    /// Maximum number of iterations; for [`Method::Lsq`].
    pub max_iterations: usize,
    /// Preconditioner; for [`Method::Lsq`].
    pub preconditioner: Preconditioner,
    /// Whether a fit that misses the tolerance is an error rather than a warning.
    pub strict: bool,
    /// Folder of the basis store, with the basis for methods over a store, or an optional factor for [`Method::Lsq`].
    #[setters(into)]
    pub store: Option<PathBuf>,
    /// Scalar type of the basis. By default it is the type found in the store, or f64 if the store has both types.
    #[setters(into)]
    pub scalar: Option<Scalar>,
    /// Whether to verify the whole basis against its hash before fitting.
    pub verify: bool,
    /// Memory budget in bytes, including mapped files. See [`memory_budget`](Self::memory_budget) for the default.
    #[setters(into)]
    pub memory: Option<usize>,
    /// Number of threads. By default it is the number of threads of the caller's rayon pool.
    #[setters(into)]
    pub threads: Option<usize>,
}

impl FitParams {
    /// Returns the recommended settings: the full least squares to degree `max_degree`.
    pub fn lsq(max_degree: usize) -> Self {
        Self {
            max_degree,
            method: Method::Lsq,
            objective: Objective::Default,
            area: None,
            smoothness: Smoothness::Default,
            denoise: false,
            weights: Weights::Uniform,
            hold_out: None,
            surface_distance: true,
            standard_errors: false,
            tolerance: defaults::TOLERANCE,
            max_iterations: defaults::MAX_ITERATIONS,
            preconditioner: Preconditioner::Auto,
            strict: false,
            store: None,
            scalar: None,
            verify: false,
            memory: None,
            threads: None,
        }
    }

    /// Returns the settings with weight 0 at the sphere's vertices for which `keep` is false. In the provenance, the
    /// new weights are named `mask` if the previous weights are uniform, else `NAME, mask` with the previous name.
    ///
    /// # Errors
    ///
    /// The errors of [`Weights::masked`].
    pub fn masked(&self, keep: &[bool], sphere: &Sphere) -> Result<Self, Error> {
        let name = match &self.weights {
            Weights::Uniform => "mask".to_owned(),
            weights => format!("{}, mask", weights.name()),
        };
        Ok(Self { weights: self.weights.masked(keep, name, sphere)?, ..self.clone() })
    }

    /// Returns the settings of iterative residual fitting over a store, with one pass and the paper's granularity.
    pub fn irf(max_degree: usize, store: impl Into<PathBuf>) -> Self {
        Self { method: Method::irf(), store: Some(store.into()), ..Self::lsq(max_degree) }
    }

    /// Returns the memory budget of a fit in bytes: [`memory`](Self::memory) if it is set. Otherwise it is
    /// [`MEMORY_OVER_A_STORE`](defaults::MEMORY_OVER_A_STORE) for the methods that read a store, and half of the free
    /// memory for the other methods.
    pub fn memory_budget(&self) -> usize {
        match (self.memory, self.method.blocks()) {
            (Some(bytes), _) => bytes,
            (None, Some(_)) => defaults::MEMORY_OVER_A_STORE,
            (None, None) => available_memory() / 2,
        }
    }

    /// Returns the settings for mapping a mesh without a sphere.
    #[must_use]
    pub fn map(&self) -> CaldParams {
        let usual = CaldParams::for_degree(self.max_degree);
        CaldParams { area: self.area.unwrap_or(usual.area), ..usual }
    }

    /// Checks all settings that don't depend on a sphere.
    ///
    /// # Errors
    ///
    /// [`Error::Degree`] if the degree is too high; [`Error::Setting`] if a setting is invalid or conflicts with
    /// another; [`Error::NeedsStore`] if the method needs a store and none is set.
    pub fn check(&self) -> Result<(), Error> {
        let refuse = |what, expected, found: String| Err(Error::Setting { what, expected, found });
        if self.max_degree > MAX_DEGREE {
            return Err(Error::Degree { found: self.max_degree, most: MAX_DEGREE });
        }
        if let Some(fraction) = self.hold_out.filter(|&fraction| !(fraction > 0.0 && fraction < 1.0)) {
            return refuse("hold_out", "a fraction between 0 and 1", fraction.to_string());
        }
        if let Some(area) = self.area.filter(|area| !(0.0..=1.0).contains(area)) {
            return refuse("area", "a number from 0 to 1", area.to_string());
        }
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return refuse("tolerance", "a number between 0 and 1", self.tolerance.to_string());
        }
        if self.threads == Some(0) {
            return refuse("threads", "a value of at least 1", "0".to_owned());
        }
        if self.method.blocks().is_some() && self.store.is_none() {
            return Err(Error::NeedsStore { method: self.method.name() });
        }
        self.check_denoise()?;
        let name = self.method.name();
        let for_lsq_only = [
            (self.smoothness != Smoothness::Default, "smoothness"),
            (self.standard_errors, "standard_errors"),
            (self.preconditioner != Preconditioner::Auto, "preconditioner"),
            (self.objective == Objective::Surface, "objective surface"),
            (self.tolerance != defaults::TOLERANCE, "tolerance"),
            (self.max_iterations != defaults::MAX_ITERATIONS, "max_iterations"),
        ];
        if let (true, Some((_, what))) = (self.method != Method::Lsq, for_lsq_only.iter().find(|(given, _)| *given)) {
            return refuse(what, "the method lsq", name.to_owned());
        }
        if self.objective == Objective::Surface && self.store.is_some() {
            return refuse("store", "objective vertices", "objective surface".to_owned());
        }
        let for_least_squares = [(self.weights != Weights::Uniform, "weights"), (self.hold_out.is_some(), "hold_out")];
        match for_least_squares.iter().find(|(given, _)| *given && self.method == Method::Quadrature) {
            Some((_, what)) => refuse(what, "a least-squares method", name.to_owned()),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_as_set_or_by_method() {
        let lsq = FitParams::lsq(10);
        assert!(lsq.memory_budget() > 0 && lsq.clone().with_memory(5).memory_budget() == 5);
        assert_eq!(lsq.with_method(Method::Nlsf).memory_budget(), defaults::MEMORY_OVER_A_STORE);
    }

    #[test]
    fn settings_of_the_iterations_need_the_method_lsq() {
        let irf = FitParams::irf(10, "store");
        irf.check().unwrap();
        for method in [Method::irf(), Method::Nlsf, Method::Quadrature] {
            let given = irf.clone().with_method(method);
            let other = given.clone().with_tolerance(1e-6);
            for (params, name) in [(other, "tolerance"), (given.with_max_iterations(7), "max_iterations")] {
                let error = params.check().unwrap_err().to_string();
                assert_eq!(error, format!("{name} needs the method lsq, found {}", method.name()));
            }
        }
    }
}
