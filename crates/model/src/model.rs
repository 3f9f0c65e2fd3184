//! A fitted model.

use spharm_harmonics::Coefficients;
use spharm_surface::{Kind, Sphere};

use crate::provenance::Provenance;

/// Value of `convention` in every model.
pub const CONVENTION: &str = "real orthonormal, no Condon-Shortley phase, row l^2 + l + m, sin(m phi) for negative m";

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Canonical coefficients, (K, c), finite, in the input's unit.
    pub coefficients: Coefficients,
    /// The sampling over which the model was fitted; `None` for a model of coefficients alone.
    pub sphere: Option<Sphere>,
    /// Key of the sampling scheme in a basis store: 64 hexadecimal digits.
    pub scheme_key: Option<String>,
    /// Origin of the model.
    pub provenance: Provenance,
}

/// The contents of a model except its sphere: the result of a fit, or coefficients of unknown origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// Key of the sampling scheme in a basis store.
    pub scheme_key: Option<String>,
    /// Origin of the coefficients.
    pub provenance: Provenance,
}

impl From<Coefficients> for Fitted {
    fn from(coefficients: Coefficients) -> Self {
        Self { coefficients, scheme_key: None, provenance: Provenance::default() }
    }
}

impl Model {
    /// Returns the model of a fit over a sphere, or of coefficients with a sphere.
    #[must_use]
    pub fn new(sphere: Sphere, fitted: impl Into<Fitted>, kind: Kind) -> Self {
        let mut model = Self::without_sphere(fitted, kind);
        model.provenance.sphere = sphere.path.as_deref().map(|path| path.to_string_lossy().into_owned());
        model.provenance.parametrized = sphere.parametrized;
        model.sphere = Some(sphere);
        model
    }

    /// Returns a model without its own sampling, which can be evaluated on any sphere.
    #[must_use]
    pub fn without_sphere(fitted: impl Into<Fitted>, kind: Kind) -> Self {
        let Fitted { coefficients, scheme_key, provenance } = fitted.into();
        let provenance = Provenance { surface: Some(kind == Kind::Surface), ..provenance };
        Self { coefficients, sphere: None, scheme_key, provenance }
    }

    /// Returns the meaning of the channels: x, y and z if there are three, unless the provenance states otherwise.
    #[must_use]
    pub fn kind(&self) -> Kind {
        let surface = self.coefficients.channels() == 3 && self.provenance.surface.unwrap_or(true);
        if surface { Kind::Surface } else { Kind::Signal }
    }

    /// Returns row, channel and value of the first coefficient that isn't finite.
    pub(crate) fn not_finite(&self) -> Option<(usize, usize, f64)> {
        let mut values = self.coefficients.values().indexed_iter();
        values.find(|(_, value)| !value.is_finite()).map(|((row, channel), &value)| (row, channel, value))
    }
}
