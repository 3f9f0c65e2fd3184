//! Defines the model of a surface or signal, and the parts from which a model is made.

use spharm_harmonics::Coefficients;
use spharm_surface::{Kind, Sphere};

use crate::provenance::Provenance;

/// Value of the array `convention` in every model file.
pub const CONVENTION: &str = "real orthonormal, no Condon-Shortley phase, row l^2 + l + m, sin(m phi) for negative m";

/// A fitted model, or coefficients of unknown origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Canonical coefficients (K, c), in the unit of the input. All are finite.
    pub coefficients: Coefficients,
    /// Sphere over which the model was fitted; `None` for a model of coefficients only.
    pub sphere: Option<Sphere>,
    /// Key of the sampling scheme in a basis store, as 64 hexadecimal digits.
    pub scheme_key: Option<String>,
    /// Origin of the model: input, sphere and settings.
    pub provenance: Provenance,
}

/// The contents of a model except its sphere: either the result of a fit or coefficients of unknown origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Canonical coefficients (K, c).
    pub coefficients: Coefficients,
    /// Key of the sampling scheme in a basis store, as 64 hexadecimal digits.
    pub scheme_key: Option<String>,
    /// Origin of the coefficients: input, sphere and settings.
    pub provenance: Provenance,
}

impl From<Coefficients> for Fitted {
    fn from(coefficients: Coefficients) -> Self {
        Self { coefficients, scheme_key: None, provenance: Provenance::default() }
    }
}

impl Model {
    /// Creates a model from a sphere and either a fit or coefficients of unknown origin.
    #[must_use]
    pub fn new(sphere: Sphere, fitted: impl Into<Fitted>, kind: Kind) -> Self {
        let mut model = Self::without_sphere(fitted, kind);
        model.provenance.sphere = sphere.path.as_deref().map(|path| path.to_string_lossy().into_owned());
        model.provenance.parametrized = sphere.parametrized;
        model.sphere = Some(sphere);
        model
    }

    /// Creates a model without a sphere, which can be evaluated on any sphere.
    #[must_use]
    pub fn without_sphere(fitted: impl Into<Fitted>, kind: Kind) -> Self {
        let Fitted { coefficients, scheme_key, provenance } = fitted.into();
        let provenance = Provenance { surface: Some(kind == Kind::Surface), ..provenance };
        Self { coefficients, sphere: None, scheme_key, provenance }
    }

    /// Returns the meaning of the channels. Three channels are the positions x, y and z, unless the provenance says
    /// that they are a signal.
    #[must_use]
    pub fn kind(&self) -> Kind {
        let surface = self.coefficients.channels() == 3 && self.provenance.surface.unwrap_or(true);
        if surface { Kind::Surface } else { Kind::Signal }
    }

    /// Returns whether the two models were fitted over different maps of their own surfaces to the sphere, so that
    /// equal directions don't correspond. Directions of the same map may differ by rounding, as after an alignment.
    /// Returns `false` if a sphere was given by the user, because given spheres may be registered with each other. Also
    /// returns `false` for a model without a sphere.
    #[must_use]
    pub fn mapped_apart(&self, other: &Self) -> bool {
        /// Two lists of directions belong to the same map if all their coordinates differ by less than this value.
        const ROUNDING: f64 = 1e-3;
        match (&self.sphere, &other.sphere) {
            (Some(own), Some(other)) => {
                let (first, second) = (own.directions.as_slice(), other.directions.as_slice());
                let near = |(a, b): (&f64, &f64)| (a - b).abs() < ROUNDING;
                let same =
                    first.len() == second.len() && first.as_flattened().iter().zip(second.as_flattened()).all(near);
                own.parametrized && other.parametrized && !same
            }
            _ => false,
        }
    }

    /// Returns whether both models are members of a group that `shape correspond` made, over the same sphere, so that
    /// equal directions correspond. Models of other origins may have the same sphere without corresponding, such as
    /// models of meshes that were resampled on the same icosphere.
    #[must_use]
    pub fn is_in_group_of(&self, other: &Self) -> bool {
        let of_group = |model: &Self| model.provenance.tool.as_deref() == Some("shape correspond");
        match (&self.sphere, &other.sphere) {
            (Some(own), Some(its)) => of_group(self) && of_group(other) && own.directions == its.directions,
            _ => false,
        }
    }

    /// Returns the row, channel and value of the first coefficient that is NaN or infinite; `None` if all are finite.
    pub(crate) fn not_finite(&self) -> Option<(usize, usize, f64)> {
        let mut values = self.coefficients.values().indexed_iter();
        values.find(|(_, value)| !value.is_finite()).map(|((row, channel), &value)| (row, channel, value))
    }
}
